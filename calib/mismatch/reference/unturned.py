"""The angle that no motion tells: how a sensor is turned about the only axis that it turned about.

On a table whose axis is vertical neither rates nor gravity change with it; and where the point
that was seen is not the axis, an arm makes up for any angle, as it turns along. What keeps the
angle near where it began is then the fit, which steps no further than a fifth of a radian, and no
knowledge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.mismatch.reference.setup import LOOSE
from calib.mismatch.search.estimate import Estimate
from calib.types import FloatArray

ANY = float(np.pi / np.sqrt(3.0))
"""Standard deviation of an angle that may be any, rad."""

TOLD = 4.0
"""Times what noise and the fit alone seem to tell of an angle, from which motion tells of it."""

UNTURNED = (
    "turns about another axis: how the sensor is turned about the only one there was is not known, "
    "and may be any angle"
)
"""What a recording lacks that leaves the angle open."""


def with_any_angle(
    fit: Estimate, turns: slice, noise: Callable[[FloatArray], float]
) -> tuple[Estimate, bool]:
    """Return the fit with angles as uncertain as they are, and whether one of them may be any.

    With the variance s of an angle, and the covariance c of all coefficients with it, these follow
    it by c / s; a variance of S instead adds ``c c' (S - s) / s²``.

    Parameters
    ----------
    fit : Estimate
    turns : slice
        Where its coefficients are the three angles of `reference_misalignment`.
    noise : function
        What noise alone seems to tell of an angle about an axis (3,), 1/rad².
    """
    variance, axes = np.linalg.eigh(fit.covariance[turns, turns])
    alone = np.array([noise(axis) for axis in axes.T]) + 1.0 / LOOSE["rx"] ** 2
    open_ = variance * alone > 1.0 / TOLD
    if not open_.any():
        return fit, False
    moves = fit.covariance[:, turns] @ axes[:, open_] / variance[open_]
    more = np.maximum(ANY**2 - variance[open_], 0.0)
    return replace(fit, covariance=fit.covariance + (moves * more) @ moves.T), True
