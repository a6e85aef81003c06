"""Steady times for stamps that scatter: samples are taken evenly, but stamped when they arrive.

A sensor has an oscillator; what stamps its samples is often a computer that is busy, or a column
that was rounded to milliseconds. Over a turn such stamps lose as much angle as the scatter times
the change of rate. Whether samples were taken evenly or when the stamps say is in the samples: what
turns is smooth in time, and smoother over the times at which it was really sampled.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from calib.recording import Recording
from calib.types import BoolArray, FloatArray, IntArray

EVENED = "stamps evened out"
"""Key of a note: by how much they scattered."""

FEWEST = 64
"""Samples below which stamps stay as they are."""

EVEN = 1e-6
"""Scatter of stamps, in intervals, that is no more than how times are written down."""

BESIDE = 32
"""Samples, at least, before and after a hole in time that say whether stamps stay late."""

STALL = 0.5
"""A computer that is busy catches up with what waits for it within this time, s."""

PAUSE = 1.0
"""A hole this long (s) parts a recording: the clock is followed on each side by itself."""

HELD_UP = 6.0
"""Median deviations beyond which a stamp was held up."""

STEADY = 20.0
"""Time over which the clock that stamps is steady, s: crystals change by less than 1 ppm in it."""


def evened(recording: Recording) -> Recording:
    """Return the recording with times of a steady clock, if its samples were taken evenly.

    Its note `EVENED` then says by how much the stamps scattered. Otherwise, and where there is
    nothing to even out, the recording itself is returned.
    """
    if recording.clock == "invalid":
        return recording
    time = even_times(recording.time, recording.gyro, recording.lost)
    if time is None:
        return recording
    off = recording.time - time
    notes = {**recording.notes, EVENED: f"{1e3 * np.std(off):.2g} ms rms"}
    return replace(recording, time=time, notes=notes)


def even_times(
    time: FloatArray, values: FloatArray, lost: IntArray | None = None
) -> FloatArray | None:
    """Return the times at which samples were taken, (n,), if evenly; None if the stamps are right.

    Times are ``a + T k`` with the number k of a sample (lost ones counted), plus the mean
    deviation of the stamps from that over `STEADY`, so that a clock that drifts is followed. They
    are right if the values (each against the cubic through its four neighbours) are smoother over
    them than over the stamps.

    Parameters
    ----------
    time : (n,) array, s
        Stamps, increasing.
    values : (n, c) array
        What moves smoothly; rows that are not finite do not count.
    lost : (n,) array of int, optional
        Samples known to be missing before each.
    """
    if len(time) < FEWEST:
        return None
    step = np.diff(time) / np.median(np.diff(time))
    if np.abs(step - np.rint(step)).max() < EVEN:
        return None
    number = sample_numbers(time, lost)
    even = np.empty_like(time)
    edges = [0, *(np.flatnonzero(np.diff(time) > PAUSE) + 1).tolist(), len(time)]
    for a, b in pairwise(edges):
        even[a:b] = _followed(time[a:b], number[a:b])
    good: BoolArray = np.asarray(np.isfinite(values).all(axis=1))
    values = np.where(good[:, None], values, 0.0)
    # All but two at each end, where the four neighbours are there.
    usual = (number[4:] - number[:-4] == 4) & (np.convolve(good, np.ones(5), "valid") == 5)
    if np.diff(even).min() <= 0 or not usual.any():
        return None
    rough = [float(roughness(at, values)[usual].mean()) for at in (even, time)]
    return even if rough[0] < rough[1] else None


def sample_numbers(time: FloatArray, lost: IntArray | None = None) -> IntArray:
    """Return the number of each sample, (n,), with those counted that are lost.

    After a hole in time samples are late by those that are lost: all of them, so that the earliest
    are as well as the middle ones. One that is late by itself is followed by some that come sooner.
    """
    known = np.zeros(len(time), np.int64) if lost is None else lost
    number = np.asarray(np.arange(len(time)) + np.cumsum(known))
    if len(time) <= BESIDE:
        return number
    interval = float(np.median(time[BESIDE:] - time[:-BESIDE])) / BESIDE
    for _ in range(2):
        # How late stamps are far from a hole can be told if the interval is known well.
        reach = max(BESIDE, min(round(STALL / interval), len(time) // 20))
        number = np.arange(len(time)) + np.cumsum(_count_missing(time, known, interval, reach))
        interval = _period(time, number)
    return np.asarray(number)


def _count_missing(time: FloatArray, known: IntArray, interval: float, reach: int) -> IntArray:
    """Return how many samples are missing before each, those counted that are known.

    ``reach`` samples on either side of a hole say whether stamps stay late.
    """
    missing = known.copy()
    late = time - interval * (np.arange(len(time)) + np.cumsum(missing))
    holes = np.flatnonzero((np.diff(time) > 1.5 * interval) & (missing[1:] == 0)) + 1
    before = late[np.maximum(holes[:, None] - 1 - np.arange(BESIDE), 0)]
    after = late[np.minimum(holes[:, None] + np.arange(BESIDE), len(late) - 1)]
    # What was lost shortly before counts in both, so that each waits for those before it.
    for k in np.flatnonzero(_later(before, after) > 0.5 * interval):
        at = int(holes[k])
        first = max(at - reach, 0)
        counted = interval * np.cumsum(missing[first:at])
        moved = _later(late[first:at] - counted, late[at : at + reach] - counted[-1])
        missing[at] = max(int(np.rint(moved / interval)), 0)
    return missing


def _later(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return by how much what is after a hole comes later, (...) from (..., samples)."""
    return np.asarray(
        np.minimum(
            after.min(axis=-1) - before.min(axis=-1),
            np.median(after, axis=-1) - np.median(before, axis=-1),
        )
    )


def _followed(time: FloatArray, number: IntArray) -> FloatArray:
    """Return times of a steady clock that follows these stamps."""
    if len(time) < FEWEST:
        return time
    even = _period(time, number) * (number - number.mean())
    off = time - even
    blocks = max(2, int((time[-1] - time[0]) / STEADY))
    cuts = np.linspace(0, len(time), blocks + 1).astype(int)[1:-1]
    middle = np.array([part.mean() for part in np.split(even, cuts)])
    level = np.array([_level(part) for part in np.split(off, cuts)])
    # The clock goes on at either end as it goes beside it.
    slope = np.diff(level) / np.diff(middle)
    begin = level[0] - slope[0] * (middle[0] - even[0])
    end = level[-1] + slope[-1] * (even[-1] - middle[-1])
    middle, level = np.r_[even[0], middle, even[-1]], np.r_[begin, level, end]
    return np.asarray(even + np.interp(even, middle, level))


def _period(time: FloatArray, number: IntArray) -> float:
    """Return the time from one number to the next, by least squares."""
    at = number - number.mean()
    return float(at @ (time - time.mean())) / float(at @ at)


def _level(off: FloatArray) -> float:
    """Return the mean of what stamps are off by, those that were held up cut to size."""
    middle = float(np.median(off))
    usual = HELD_UP * float(np.median(np.abs(off - middle)))
    return float(np.clip(off, middle - usual, middle + usual).mean())


def roughness(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the squares by which samples are off the cubics through their neighbours, (n - 4,).

    In units in which white noise comes out as its variance, however the times are spaced; of all
    samples but two at each end.

    Parameters
    ----------
    time : (n,) array
    values : (n, c) array
    """
    n = len(time) - 4
    offset = [time[k : k + n] - time[2 : 2 + n] for k in (0, 1, 3, 4)]
    left = values[2 : 2 + n].copy()
    gain = np.ones(n)
    for j, own in enumerate(offset):
        others = [other for k, other in enumerate(offset) if k != j]
        weight = np.prod([other / (other - own) for other in others], axis=0)
        start = (0, 1, 3, 4)[j]
        left -= weight[:, None] * values[start : start + n]
        gain += np.square(weight)
    return np.asarray(np.square(left).sum(axis=1) / gain)
