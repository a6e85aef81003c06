"""The noise of contrasts within rests and windows."""

from __future__ import annotations

from itertools import product

import numpy as np

from calib.mismatch.rows.rows import Rows
from calib.types import BoolArray, FloatArray, IntArray

FEW = 5
"""Contrasts of one kind and channel from which on what repeats in them is taken out."""

STRAY = 3.0
"""Standard deviations beyond which a contrast is that of something else."""

MOSTLY_WHITE = 2.0
"""Variance, relative to white noise, up to which that is most of it."""


def contrast_variance(rows: Rows, *, apart: BoolArray | None = None) -> FloatArray:
    """Return the variance of the contrast rows: white noise times one robust factor a channel.

    Restless segments have a factor of their own, each. Rows that are marked in ``apart``, by number
    of contrast, hold more than noise: their channel's factor is that of the others.

    Drift within a rest and correlated noise lift it above white noise. What repeats in every rest
    or goes with time (an effect) is taken out first.
    """
    variance = rows.white_diagonal.copy()
    start = rows.n_dense
    y, channel = rows.residual[start:], rows.channel[start:]
    time = rows.interval[rows.segment[start:]].mean(axis=1)
    order = (
        np.tile(np.repeat([0, 1], 6), len(y) // 12) if len(y) % 12 == 0 else np.zeros(len(y), int)
    )
    restless = rows.restless[start:] if rows.restless.size else np.zeros(len(y), bool)
    for c, moved in product(range(6), (False, True)):
        mine = (channel == c) & (restless == moved)
        squares = []
        for k in (0, 1):
            own = np.flatnonzero(mine & (order == k))
            if apart is not None and (~apart[own]).sum() >= FEW:
                own = own[~apart[own]]
            if len(own) < FEW:
                continue
            scaled = y[own] / np.sqrt(variance[own])
            design = np.stack((np.ones(len(own)), (time[own] - time[own].mean())), axis=1)
            left = scaled - design @ np.linalg.lstsq(design, scaled, rcond=None)[0]
            squares.append(np.square(left) * len(own) / (len(own) - 2))
        if squares:
            values = np.concatenate(squares)
            level = typical(values)
            level = max(level, float(np.minimum(values, 9.0 * max(level, 1e-12)).mean()))
        elif mine.any() and not moved:
            # Of so few nobody can tell what an effect is, and what the sensor or its holder does.
            triad = (channel // 3 == c // 3) & ~restless
            values = np.square(y[triad]) / rows.white_diagonal[triad]
            level = float(values.mean())
        else:
            continue
        variance[mine] *= _inflation(len(values) * level, len(values))
        if not moved:
            continue
        # A knock or a slip errs by far more than shaking does elsewhere.
        for s in np.unique(rows.segment[start:][mine]):
            own = mine & (rows.segment[start:] == s)
            variance[own] *= _inflation(float(np.square(y[own]) @ (1 / variance[own])), own.sum())
    return variance


def telling(rows: Rows) -> IntArray:
    """Return the numbers of those contrasts that tell how far biases drift, beside means at rest.

    None where drift is most of what those of a channel hold: there means tell as much, and once
    more would be too much. Nor of so few rests that nobody can tell what the sensor does in them
    from what its holder does. And a knock or a slip in one does not say what happens in all others.
    """
    square = np.square(rows.residual[rows.n_dense :]) / rows.white_diagonal
    channel = rows.channel[rows.n_dense :]
    limit = np.zeros(len(square))
    for c in np.unique(channel):
        own = channel == c
        usual = typical(square[own])
        if usual > MOSTLY_WHITE or own.sum() < 2 * FEW:
            return np.zeros(0, np.int64)
        limit[own] = STRAY**2 * max(usual, 1.0)
    return np.flatnonzero(square < limit)


def contrast_likelihood(rows: Rows, variance: FloatArray) -> float:
    """Return the log-likelihood of the contrast rows as noise of this variance."""
    y = rows.residual[rows.n_dense :]
    return float(-0.5 * (np.log(variance) + np.square(y) / variance).sum())


def _inflation(total: float, count: int) -> float:
    """Return a factor on variance from a sum of squares, shrunk to 1 as by six more; at least 1."""
    return max(1.0, (total + 6.0) / (count + 6.0))


def typical(squares: FloatArray) -> float:
    """Return the variance of normal errors by the median of their squares."""
    # The median of chi-squared with one degree of freedom is 0.4549.
    return float(np.median(squares)) / 0.4549
