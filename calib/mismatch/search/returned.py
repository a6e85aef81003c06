"""A bias that steps, and steps back: something was there for a while."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtri

from calib.mismatch.search.estimate import Estimate
from calib.mismatch.search.ranking import Accepted

STEP = "_bias_step"

THERE = "bias in a window"

CHANCE = 1e-3
"""Probability that noise makes a bias that went back look as if it had not. Two steps that have
nothing to do with each other cancel only by chance, the less often the better they are known."""


def returned(fit: Estimate, accepted: Sequence[Accepted]) -> Mapping[int, tuple[float, float]]:
    """Return which accepted explanations are a step and its way back, with when they were there.

    A bias that goes back to what it was, to within the standard error of the sum of both steps, did
    not change: one disturbance in a window has been fitted by its two ends.
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
    """Whether two steps add up to what noise would leave of nothing."""
    names = sorted({*accepted[i].candidate.parameters, *accepted[j].candidate.parameters})
    total = np.zeros((len(names), len(fit.step)))
    for n in (i, j):
        for k, name in enumerate(accepted[n].candidate.parameters):
            total[names.index(name), fit.at[n] + k] = accepted[n].typical[k]
    left = total @ fit.step
    spread = total @ fit.covariance @ total.T
    return float(left @ np.linalg.solve(spread, left)) < float(chdtri(len(names), CHANCE))
