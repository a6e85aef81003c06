"""The noise of contrasts within rests and windows."""

from __future__ import annotations

from itertools import product

import numpy as np

from calib.mismatch.noise.coupling import lean_in_contrasts
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

FEW = 5
"""Contrasts of one kind and channel from which on what repeats in them is taken out."""

STRAY = 3.0
"""Standard deviations beyond which a contrast is that of something else."""

SEEN = 30
"""Contrasts of an accelerometer from which on a lean is told from them."""

CUT = 9.0
"""Squares of normal errors that count in full."""

USUAL = 0.995
"""Mean square of normal errors, cut there."""

HALVINGS = 60
"""Of the span in which a level lies, until it is known to the last digits."""

MOSTLY_WHITE = 2.0
"""Variance, relative to white noise, up to which that is most of it."""


def contrast_variance(rows: Rows, *, apart: BoolArray | None = None) -> FloatArray:
    """Return the variance of the contrast rows: white noise times one robust factor a channel.

    Restless segments have a factor of their own, each. Rows that are marked in ``apart``, by number
    of contrast, hold more than noise: their channel's factor is that of the others.

    Drift within a rest and correlated noise lift it above white noise. What repeats in every rest
    or goes with time (an effect) is taken out first.
    """
    start = rows.n_dense
    y, channel = rows.residual[start:], rows.channel[start:]
    restless = rows.restless[start:] if rows.restless.size else np.zeros(len(y), bool)
    taken = np.ones(len(y), bool) if apart is None else ~apart
    variance = rows.white_diagonal + _swaying(rows, taken & ~restless)
    for c, moved in product(range(6), (False, True)):
        mine = (channel == c) & (restless == moved)
        squares = _squares(rows, variance, mine, taken)
        if squares:
            values = np.concatenate([found for _, found in squares])
            level = typical(values)
            level = max(level, float(np.minimum(values, CUT * max(level, 1e-12)).mean()))
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


def _squares(
    rows: Rows, variance: FloatArray, which: BoolArray, taken: BoolArray
) -> list[tuple[IntArray, FloatArray]]:
    """Return some contrasts of one channel, and their squares in units of a variance, by orders.

    Without what repeats in them or goes with time. Those ``taken`` are all, unless they are few.
    """
    y = rows.residual[rows.n_dense :]
    time = rows.interval[rows.segment[rows.n_dense :]].mean(axis=1)
    # Of the two that a channel has in a rest one is of the first order, and one of the second.
    segment = rows.segment[rows.n_dense :]
    order = rows.is_rest[segment].astype(int)
    place = len(CHANNELS) * segment + rows.channel[rows.n_dense :]
    order[np.unique(place, return_index=True)[1]] = 0
    out = []
    for k in (0, 1):
        own = np.flatnonzero(which & (order == k))
        if taken[own].sum() >= FEW:
            own = own[taken[own]]
        if len(own) < FEW:
            continue
        scaled = y[own] / np.sqrt(variance[own])
        design = np.stack((np.ones(len(own)), (time[own] - time[own].mean())), axis=1)
        left = scaled - design @ np.linalg.lstsq(design, scaled, rcond=None)[0]
        out.append((own, np.square(left) * len(own) / (len(own) - 2)))
    return out


def _swaying(rows: Rows, taken: BoolArray) -> FloatArray:
    """Return the variance (n,) that contrasts have as the sensor leans.

    A rest that lasts twice as long leans by more, axes along gravity see nothing of it, and some
    rests lean more than others: no factor on white noise says that. Zero for rows that nothing
    leans in, and unless what those that are ``taken`` hold beyond noise is clearly seen: by the
    accelerometer first, where gravity has not told so already. It may lean about each axis apart.
    """
    out = np.zeros(len(taken))
    if rows.lean is None:
        return out
    shape = lean_in_contrasts(rows)
    channel = rows.channel[rows.n_dense :]
    accel = channel < 3
    out[accel] = shape[accel] * _level_of_lean(rows, shape, taken & (shape > 0) & accel, SEEN)
    for c in range(3, 6) if out.any() or rows.lean.told else ():
        own = channel == c
        out[own] = shape[own] * _level_of_lean(rows, shape, taken & (shape > 0) & own, 2 * FEW)
    return out


def _level_of_lean(rows: Rows, shape: FloatArray, which: BoolArray, least: int) -> float:
    """Return the level of a lean that some contrasts (n,) hold; zero if none is clear.

    Or if fewer of them than ``least`` tell.
    """
    channel, white = rows.channel[rows.n_dense :], rows.white_diagonal
    found = [
        pair
        for c in np.unique(channel[which])
        for pair in _squares(rows, white, which & (channel == c), which)
    ]
    if sum(len(own) for own, _ in found) < least:
        return 0.0
    at, square = (np.concatenate(parts) for parts in zip(*found, strict=True))
    ratio = shape[at] / white[at]

    def excess(level: float) -> float:
        return float(np.minimum(square / (1.0 + level * ratio), CUT).mean()) - USUAL

    if excess(0.0) <= 3.0 * np.sqrt(2.0 / len(at)):
        return 0.0
    low, high = 0.0, float(np.max(square / ratio))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high


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
