"""Captured orientations at rest: one for each rest instead of the noise of each sample.

The mean rate of a window is what the angles at its ends differ by. Seen by markers both are as
noisy as one sample, however long the body rests there. At rest all of its samples tell::

    angle(t) = a + b t + noise,        seen instead of it: a, or a + b t

A rest has a slope where it clearly turns (a table that sags, a sensor that leans), and all have one
where together they turn by more than their noise: less than that is left to the drift of the
gyroscope, as in a recording by itself. The rest errs by these coefficients only. Where a body
sways by more than noise, as one that is held does, its rest is seen as it is; what is less is
beside the lines, and counts as noise.

A force goes with an angle as it was captured, a rate with what rates add up to: noise turns about
itself as it comes and goes, and of that a sum keeps all that ever was.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from calib.rotation import nearest_rotation, rotvec_from_mat
from calib.types import BoolArray, FloatArray, IntArray

LONGEST = 30.0
"""s that one line follows."""

BLOCK = 4.0
"""Periods of the cut-off over which angles are averaged: so slow their noise is white."""

FEWEST = 3
"""Blocks that tell how well a line follows them."""

CHANCE = 2.0
"""Standard deviations by which what is beside the lines, or all slopes, are more than noise by
chance."""

RARE = 3.09
"""Standard deviations that a thousandth of rests exceeds by chance."""

UNSURE = 1.5
"""Factor up to which the variance of the noise is not known from its spectrum."""

CLEARLY = 16.3
"""Square of a slope about three axes, in units of its noise, that a thousandth of rests exceeds."""


class Steady(NamedTuple):
    """What orientations are taken as in rests.

    Parameters
    ----------
    inside : (n,) array of bool
        Points of rests that have a line.
    lines : sparse (n, q) matrix
        Orthonormal: the constant of each, and slopes.
    noise, sway : float, rad/√Hz
        Density of the noise of each angle there, and of what of it is left beside the lines.
    moved, tilted : (n, 3) arrays, rad
        From what was seen to the lines: what rates feel, and what forces do.
    """

    inside: BoolArray
    lines: sparse.csr_matrix
    noise: float
    sway: float
    moved: FloatArray
    tilted: FloatArray


def steadied(
    time: FloatArray,
    rate: FloatArray,
    rests: IntArray,
    mat: FloatArray | None = None,
    *,
    angle: float,
    interval: float,
    band: float,
) -> Steady | None:
    """Return what captured orientations are taken as in (k, 2) rests; None if no rest is steady.

    Parameters
    ----------
    time : (n,) array, s
    rate : (n, 3) array, rad/s
        By what was captured, through a low-pass.
    rests : (k, 2) array of int
        Points ``[first, last)`` that feel nothing of any turn.
    mat : (n, 3, 3) array, optional
        Orientations as they were captured, in the frame of the rates: ``mat_ns``.
    angle : float, rad/√Hz
        Density of the noise of each angle, as its spectrum shows it.
    interval : float, s
        Between points.
    band : float, Hz
        Cut-off of that low-pass.
    """
    each = max(2, round(BLOCK / (band * interval)))
    seen = np.zeros((2, len(time), 3))
    expected = UNSURE * angle**2 / (2.0 * interval * each)
    parts, bases, slopes, squares = [], [], [], []
    for part in _parts(time, rests, interval):
        many = len(part) // each
        if many < FEWEST:
            continue
        summed = np.cumsum(0.5 * (rate[part] + rate[part - 1]), axis=0) * interval
        summed -= summed.mean(axis=0)
        turned = summed if mat is None else _about_mean(mat[part])
        line = _slope(len(part))
        along = line @ turned
        means = turned[: many * each].reshape(many, each, 3).mean(axis=1)
        means -= means.mean(axis=0) + np.outer(_slope(many), _slope(many) @ means)
        # A line takes two degrees of freedom of three angles; of white blocks' steps it takes this.
        left, free = float(np.square(means).sum()), 3.0 * (many - 2)
        steps = 0.5 * float(np.square(np.diff(means, axis=0)).sum())
        if not 0.0 < left < free * expected * _limit(free):
            continue
        seen[:, part] = summed, turned
        parts.append(part)
        bases.append(np.stack((np.full(len(part), 1.0 / np.sqrt(len(part))), line), axis=1))
        slopes.append(along @ along)
        own = many - 1.0 - 6.0 / (many * (many + 1.0))
        squares.append((left * many / (many - 2), steps * many / own, 3.0 * many))
    if not parts:
        return None
    left, steps, blocks = np.sum(squares, axis=0)
    variance = each * left / blocks
    beyond = np.clip(left / steps - 1.0 - CHANCE / np.sqrt(blocks), 0.0, 1.0)
    slope = np.array(slopes) / variance
    turns = slope > CLEARLY
    quiet = slope[~turns]
    if quiet.sum() > 3.0 * len(quiet) + CHANCE * np.sqrt(6.0 * len(quiet)):
        turns[:] = True
    moved, inside = np.zeros_like(seen), np.zeros(len(time), bool)
    bases = [basis[:, : 1 + turned] for basis, turned in zip(bases, turns, strict=True)]
    for part, basis in zip(parts, bases, strict=True):
        moved[:, part] = basis @ (basis.T @ seen[:, part]) - seen[:, part]
        inside[part] = True
    index = np.concatenate(parts)
    placed = sparse.csr_matrix(
        (np.ones(len(index)), (index, np.arange(len(index)))), shape=(len(time), len(index))
    )
    lines = (placed @ sparse.block_diag(bases)).tocsr()
    noise = float(np.sqrt(2.0 * interval * variance))
    return Steady(inside, lines, noise, noise * float(np.sqrt(beyond)), *moved)


def _about_mean(mat: FloatArray) -> FloatArray:
    """Return the small angles of (k, 3, 3) orientations about their mean, (k, 3) rad."""
    turned = rotvec_from_mat(nearest_rotation(mat.mean(axis=0)).T @ mat)
    return np.asarray(turned - turned.mean(axis=0))


def _slope(n: int) -> FloatArray:
    """Return a straight line through n points, orthogonal to a constant and of unit length."""
    line = np.arange(n) - 0.5 * (n - 1)
    return line / np.linalg.norm(line)


def _limit(free: float) -> float:
    """Return the mean square that a thousandth exceeds (Wilson and Hilferty's approximation)."""
    share = 2.0 / (9.0 * free)
    return float((1.0 - share + RARE * np.sqrt(share)) ** 3)


def _parts(time: FloatArray, rests: IntArray, interval: float) -> list[IntArray]:
    """Return the points of rests in even parts of at most `LONGEST`, without those with gaps."""
    out: list[IntArray] = []
    for a, b in rests:
        if b - a > 1 and a and (np.diff(time[a - 1 : b]) < 1.5 * interval).all():
            number = int(np.ceil((b - a) * interval / LONGEST))
            out += np.array_split(np.arange(a, b), number)
    return out
