"""How much a sensor is shaken: the variance of its specific force about its slow motion.

What rectifies vibration sees the mean square of all that it feels. Samples have that of a tone at
whatever frequency, aliased or not, if what is slow is taken off them and nothing else is.
"""

from __future__ import annotations

import numpy as np

from calib.effects.base import window_mean, windows
from calib.types import BoolArray, FloatArray, IntArray

WINDOW = 1.0
"""s over which squares are averaged."""

SLOW, FAST = 0.5, 0.05
"""s of each of three means in a row, that are the slow part at rest and in motion. At rest all
above 1.7 Hz is vibration, to 3 %; in motion what is above 17 Hz: a hand is slower."""

BESIDE = 1.5
"""s from a rest within which motion is taken to be shaken as that is, or less."""

SHAKEN = 1.5
"""Noise power, relative to that of quiet rests, from which there is vibration."""

QUIETEST = 0.3
"""Share of the rests that is taken to be free of vibration."""

UNLIMITED = np.inf
"""Of what is rectified per square of what samples show: a low-pass may hide most of what shakes."""

VIBRATION_REACH = 1.5 * SLOW + 0.5 * WINDOW + BESIDE
"""s on either side of a moment that decide its variance, but for when turns are."""


def vibration_variance(time: FloatArray, force: FloatArray, turning: BoolArray) -> FloatArray:
    """Return the variance (n, 3) of what is too fast for motion, over a second about each sample.

    In motion only the fastest of it can be told from the hand's: it counts for as much as the same
    does in the rests beside, and for no more than is there. Output noise is part of it.

    Parameters
    ----------
    time : (n,) array, s
    force : (n, 3) array, m/s²
    turning : (n,) array of bool
        Where the sensor turns.
    """
    n = len(time)
    change = np.flatnonzero(np.diff(turning)) + 1
    begin, end = np.append(0, change), np.append(change, n)
    run = np.repeat(np.arange(len(begin)), end - begin)
    within = begin[run], end[run]
    fast = _variance(time, force, FAST, within)
    out = fast.copy()
    still = ~turning
    # A slow part that is half as long takes twice as much of what is white with it. At 100 Hz what
    # it takes is 2 %.
    slow, half = (_variance(time, force, width, within)[still] for width in (SLOW, 0.5 * SLOW))
    out[still] = np.maximum(2.0 * slow - half, 0.0)
    for a, b in zip(begin[turning[begin]], end[turning[begin]], strict=True):
        moves = slice(a, b)
        most = np.full((b - a, 3), np.inf)
        for rest in (a - 1, b):
            if 0 <= rest < n:
                close = np.abs(time[moves] - time[rest]) <= BESIDE
                alike = np.minimum(fast[moves][close], fast[rest])
                level = out[rest] * alike / np.maximum(fast[rest], np.finfo(float).tiny)
                most[close] = np.minimum(most[close], level)
        out[moves] = np.where(np.isfinite(most), most, fast[moves])
    return out


def _variance(
    time: FloatArray, force: FloatArray, slow: float, within: tuple[IntArray, IntArray]
) -> FloatArray:
    """Return the mean square about three means over `slow` s in a row, in each sample's run."""
    near = windows(time, slow, within=within)
    trend = force
    for _ in range(3):
        trend = window_mean(trend, *near)
    return window_mean(np.square(force - trend), *windows(time, WINDOW, within=within))


def quiet_level(level: FloatArray, limit: FloatArray | float) -> float:
    """Return the median of (k,) noise levels of rests; of those that are quiet, if most are not.

    Where half of the rests are shaken, the median of all is a level that none has. So quiet are the
    quietest, and whatever is not louder than `limit` times the median of those that are quiet.
    """
    every = float(np.median(level))
    quiet = level <= np.quantile(level, QUIETEST)
    while True:
        middle = float(np.median(level[quiet]))
        if every <= np.max(limit) * middle:
            return every
        more = level <= limit * middle
        if not (more & ~quiet).any():
            return middle
        quiet |= more
