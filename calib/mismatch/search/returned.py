"""A bias that steps, and steps back: something was there for a while."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.estimate import Estimate
from calib.types import FloatArray

STEP = "_bias_step"

THERE = "bias in a window"


def returned(fit: Estimate, accepted: Sequence[Accepted]) -> Mapping[int, tuple[float, float]]:
    """Return which accepted explanations are a step and its way back, with when they were there.

    A bias that goes back to what it was did not change: one disturbance in a window has been fitted
    by its two ends.
    """
    out: dict[int, tuple[float, float]] = {}
    steps = sorted(
        (i for i, a in enumerate(accepted) if a.candidate.name.endswith(STEP)),
        key=lambda i: accepted[i].candidate.shape["moment"],
    )
    for k, i in enumerate(steps):
        for j in steps[k + 1 :]:
            alike = accepted[i].candidate.name == accepted[j].candidate.name
            if i in out or j in out or not alike or not _cancel(fit, accepted, i, j):
                continue
            start, stop = (accepted[n].candidate.shape["moment"] for n in (i, j))
            out[i] = out[j] = (float(start), float(stop))
    return out


def _cancel(fit: Estimate, accepted: Sequence[Accepted], i: int, j: int) -> bool:
    """Whether it is more likely that two steps add up to nothing than to some step of their size.

    The sum of their fitted sizes has the covariance of its error alone if they cancel; else that of
    two independent steps comes to it, as large as these are.
    """
    names = sorted({*accepted[i].candidate.parameters, *accepted[j].candidate.parameters})
    total = np.zeros((len(names), len(fit.step)))
    size = np.zeros(len(names))
    for n in (i, j):
        for k, name in enumerate(accepted[n].candidate.parameters):
            own = names.index(name)
            total[own, fit.at[n] + k] = accepted[n].typical[k]
            size[own] += (accepted[n].typical[k] * fit.step[fit.at[n] + k]) ** 2
    left, spread = total @ fit.step, total @ fit.covariance @ total.T
    return _log_density(left, spread) > _log_density(left, spread + np.diag(size))


def _log_density(value: FloatArray, covariance: FloatArray) -> float:
    """Return the logarithm of a normal density about zero, but for a constant."""
    log_det = float(np.linalg.slogdet(covariance)[1])
    return -0.5 * (float(value @ np.linalg.solve(covariance, value)) + log_det)
