"""Captured orientations at rest: the straight line through them instead of the noise of each.

The mean rate of a window is what the angles at its ends differ by. Seen by markers both are as
noisy as one sample, however long the body rests there. A body at rest turns evenly if it turns at
all (a table that sags, a sensor that leans), and that takes all samples of the rest to tell::

    angle(t) = a + b t + noise,        seen instead of it: a + b t

The line errs by two coefficients only. What a body that is held sways by is beside the line, and
counts as noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from calib.types import BoolArray, FloatArray, IntArray

LONGEST = 10.0
"""s that one line follows."""

BLOCK = 3.0
"""Periods of the cut-off over which angles are averaged: so slow their noise is white."""

FEWEST = 4
"""Blocks that tell how well a line follows them."""

CHANCE = 2.0
"""Standard deviations by which what is beside the lines is more than noise by chance."""


class Steady(NamedTuple):
    """What orientations are taken as in rests.

    Parameters
    ----------
    inside : (n,) array of bool
        Points of rests that have a line.
    lines : sparse (n, q) matrix
        Orthonormal: constants and slopes.
    noise, sway : float, rad/√Hz
        Density of the noise of each angle there, and of what of it is left beside the lines.
    moved : (n, 3) array, rad
        From what was seen to the lines.
    """

    inside: BoolArray
    lines: sparse.csr_matrix
    noise: float
    sway: float
    moved: FloatArray


def steadied(
    time: FloatArray, rate: FloatArray, rests: IntArray, *, interval: float, band: float
) -> Steady | None:
    """Return what captured orientations are taken as in (k, 2) rests; None if these are too short.

    Parameters
    ----------
    time : (n,) array, s
    rate : (n, 3) array, rad/s
        By what was captured, through a low-pass.
    rests : (k, 2) array of int
        Points ``[first, last)`` that feel nothing of any turn.
    interval : float, s
        Between points.
    band : float, Hz
        Cut-off of that low-pass.
    """
    each = max(2, round(BLOCK / (band * interval)))
    parts = [part for part in _parts(time, rests, interval) if len(part) >= FEWEST * each]
    if not parts:
        return None
    moved, values = np.zeros((len(time), 3)), []
    # Squares of what is left of blocks, and of steps between neighbouring ones.
    left = steps = blocks = 0.0
    for part in parts:
        seen = np.cumsum(0.5 * (rate[part] + rate[part - 1]), axis=0) * interval
        line = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(part)), 2))[0]
        moved[part] = line @ (line.T @ seen) - seen
        values.append(line.ravel())
        many = len(part) // each
        means = moved[part[: many * each]].reshape(many, each, 3).mean(axis=1)
        left += float(np.square(means).sum()) * many / (many - 2)
        steps += 0.5 * float(np.square(np.diff(means, axis=0)).sum()) * many / (many - 1)
        blocks += 3.0 * many
    if not left:
        return None
    noise = float(np.sqrt(2.0 * each * interval * left / blocks))
    beyond = np.clip(left / steps - 1.0 - CHANCE / np.sqrt(blocks), 0.0, 1.0)
    points = np.concatenate(parts)
    inside = np.zeros(len(time), bool)
    inside[points] = True
    column = 2 * np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    lines = sparse.csr_matrix(
        (
            np.concatenate(values),
            (np.repeat(points, 2), (column[:, None] + np.arange(2)).ravel()),
        ),
        shape=(len(time), 2 * len(parts)),
    )
    return Steady(inside, lines, noise, noise * float(np.sqrt(beyond)), moved)


def _parts(time: FloatArray, rests: IntArray, interval: float) -> list[IntArray]:
    """Return the points of rests in even parts of at most `LONGEST`, without those with gaps."""
    out: list[IntArray] = []
    for a, b in rests:
        if b - a > 1 and a and (np.diff(time[a - 1 : b]) < 1.5 * interval).all():
            number = int(np.ceil((b - a) * interval / LONGEST))
            out += np.array_split(np.arange(a, b), number)
    return out
