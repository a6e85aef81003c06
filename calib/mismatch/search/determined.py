"""Which parameters of what was found a recording determines, and which it leaves open.

A sensor that never turned about z shows nothing of how its x axis lies to that: what a finding has
of it is what noise, and the priors, leave there. In a model it would be put on streams that turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.effects import get_effect
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, with_parameters
from calib.mismatch.search.estimate import Estimate, solved
from calib.types import FloatArray

LOOSE = 3.0
"""Standard error, times the typical size, from which on a parameter is open: parts have less."""

OPEN = {"bias": 0.1, "scale_factor_error": 0.02, "misalignment": 0.02}
"""Standard errors (SI) of the baseline beyond which a recording cannot tell much."""

CLEAR = 5.0
"""Standard errors from which on it is there, however large they are."""


def determined(
    rows: Rows, accepted: list[Accepted], levels: FloatArray, contrast: FloatArray
) -> tuple[list[Accepted], tuple[str, ...]]:
    """Return findings without the parameters that are open, and the names of these.

    One after another: of two that only go together the other one may be determined then, and what
    goes with the baseline is open however small its standard error looks. The rows have the part of
    every finding in them, as `settle` returns them. What is there or not, or refines others, stays,
    and so does the last parameter of a finding.
    """
    accepted = list(accepted)
    gone: list[str] = []
    while True:
        step, covariance, unique = solved(rows, tuple(accepted), levels, contrast)
        sigma = np.where(unique, np.sqrt(np.diag(covariance)), np.inf)
        at = rows.baseline.shape[1] + rows.nuisance.shape[1]
        worst: tuple[float, int, int] = (LOOSE, 0, 0)
        for i, a in enumerate(accepted):
            own = slice(at, at + len(a.values))
            at = own.stop
            if not _droppable(a):
                continue
            refining = {p.name for p in get_effect(a.candidate.name).parameters if p.refining}
            for k, name in enumerate(a.candidate.parameters):
                size, error = abs(step[own][k]), float(sigma[own][k])
                if error > worst[0] and size < CLEAR * error and name not in refining:
                    worst = (error, i, k)
        if worst[0] <= LOOSE:
            return accepted, tuple(gone)
        _, i, k = worst
        gone.append(f"{accepted[i].candidate.name}.{accepted[i].candidate.parameters[k]}")
        accepted[i] = _without(accepted[i], k)


def open_baseline(names: Sequence[str], fit: Estimate) -> list[str]:
    """Return which parameters of the baseline, which come first in a fit, it says too little of."""
    sigma = np.where(fit.determined, np.sqrt(np.diag(fit.covariance)), np.inf)
    return [n for n, s in zip(names, sigma, strict=False) if s > OPEN[n.split(".")[1]]]


def to_determine(names: Sequence[str]) -> str:
    """Return what is missing where parameters of these names are open."""
    return f"motion that determines {', '.join(names)}"


def _droppable(a: Accepted) -> bool:
    """Whether a finding has parameters each of which is a size of its own."""
    if not a.candidate.physical or a.candidate.present or len(a.candidate.parameters) < 2:
        return False
    return get_effect(a.candidate.name).kind == "sensor"


def _without(a: Accepted, which: int) -> Accepted:
    keep = [k for k in range(len(a.values)) if k != which]
    names = tuple(a.candidate.parameters[k] for k in keep)
    return replace(
        a,
        candidate=with_parameters(a.candidate, names),
        columns=a.columns[:, keep],
        typical=a.typical[keep],
        values=a.values[keep],
    )
