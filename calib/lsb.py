"""Counts of a converter: how large one is, and bits that never change.

A converter, or who reads it, may lose one bit: a broken line of a bus, a mask that is wrong. Each
value of which it is a part is off by it. Of the counts modulo twice that bit one half is never met,
wherever zero is; a sensor that turns meets all of them.
"""

from __future__ import annotations

import numpy as np

from calib.types import BoolArray, FloatArray, IntArray

SCALES = (4.0, 32.0, 256.0, 2048.0)
"""Counts, at most, of the changes that tell the size of one, step by step."""

WHOLE = 0.1, 0.99
"""Distance from a whole count within which a value is one, and the share that has to be."""

PERIODS = 48
"""Places that are met, each a period of a bit long: that all have the same half of it by chance is
rarer than 1e-9, whatever half that is."""

FINE = 10.0
"""Counts of a quantile from which on it does not matter where in one it is."""

WIDEST = 1 << 20
"""Counts of a range beyond which values are no counts: no converter here has as many."""


def refined(change: FloatArray, lsb: FloatArray) -> FloatArray:
    """Return the size of a count (k,) as changes of many counts (n, k) tell it, step by step.

    A size that is off by a thousandth, as decimals make it, is off by half a count in 500.
    """
    for most in SCALES:
        count = np.rint(change / np.where(lsb > 0, lsb, 1.0))
        own = np.where(count <= most, count, 0.0)
        square = np.square(own).sum(axis=0)
        lsb = np.where(square > 0, (own * change).sum(axis=0) / np.maximum(square, 1.0), lsb)
    return np.asarray(lsb)


def between_counts(change: FloatArray, lsb: FloatArray, share: float) -> FloatArray:
    """Return quantiles (k,) of sizes of changes (n, k), as they would be but for the counts.

    Of whole counts a quantile is one as well, and of coarse ones it is zero. So each count is
    spread evenly over what rounding makes it of, as a median of grouped values is found: nothing
    over half of one to either side.
    """
    out = np.quantile(change, share, axis=0)
    for c, size in enumerate(lsb.tolist()):
        most = float(out[c]) / size + 1.0 if size > 0 else np.inf
        if most > FINE:
            continue
        edges = np.append(0.0, np.arange(0.5, most + 1.0)) * size
        below = np.searchsorted(np.sort(change[:, c]), edges) / len(change)
        out[c] = np.interp(share, below, edges)
    return np.asarray(out)


def find_stuck_bits(values: FloatArray, step: FloatArray) -> list[tuple[int, float]]:
    """Return ``(channel, size)`` of bits that never change, their size in the channel's unit.

    The lowest bit is none: without it a count is twice as large.

    Parameters
    ----------
    values : (n, k) array
    step : (k,) array
        About the size of a count; 0 of a channel that is constant.
    """
    lsb = refined(np.abs(np.diff(values, axis=0)), step)
    out = []
    for c, size in enumerate(lsb.tolist()):
        if size <= 0 or np.ptp(values[:, c]) > WIDEST * size:
            continue
        off = (values[:, c] - values[:, c].min()) / size
        count = np.rint(off).astype(np.int64)
        if np.mean(np.abs(off - count) < WHOLE[0]) < WHOLE[1]:
            continue
        met = np.unique(count)
        period = 4
        while len(np.unique(met // period)) >= PERIODS:
            if _half_empty(met % period, period):
                out.append((c, 0.5 * period * size))
            period *= 2
    return out


def _half_empty(residue: IntArray, period: int) -> bool:
    """Whether one half of a period, from wherever it begins, is not met."""
    here: BoolArray = np.bincount(residue, minlength=period) > 0
    at = np.flatnonzero(here)
    gap = np.diff(np.append(at, at[0] + period))
    return bool(gap.max() > period // 2)
