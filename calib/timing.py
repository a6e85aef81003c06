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
from scipy.special import chdtri

from calib.recording import Recording
from calib.types import BoolArray, FloatArray, IntArray

EVENED = "stamps evened out"
"""Key of a note: by how much they scattered."""

SHARED = "stamps shared"
"""Key of a note: how far apart stamps are of which each is that of several samples."""

FEWEST = 64
"""Samples below which stamps stay as they are."""

EVEN = 1e-6
"""Scatter of stamps, in intervals, that is no more than how times are written down."""

WRITTEN = 0.005
"""Scatter, in intervals, up to which it is nothing that anybody would want to know of."""

HOLES = 0.02
"""Share of steps beyond which holes may be no lost samples: that is then in the samples."""

BESIDE = 32
"""Samples, at least, before and after a hole in time that say whether stamps stay late."""

BURSTS = 1024
"""Samples over which bursts of any number are many."""

LONGEST = 128
"""Samples that a part keeps at most until they are read, in a burst."""

PART = 4096
"""Holes that are looked at at a time."""

NO_WORSE = 1.2
"""Scatter, relative to that with more lost samples, that is no larger."""

STALL, LATEST = 0.5, 4.0
"""A computer that is busy catches up with what waits for it within this time, s; and within that,
if the interval is known so well, some packet comes at once."""

PAUSE = 1.0
"""A hole this long (s) parts a recording: the clock is followed on each side by itself."""

SHIFTED, STAYS = 0.1, 6.0
"""Part of an interval, and median steps of what stamps are late by, from which they stay late."""

LASTING = 512
"""Samples, at most, before and after a hole over which stamps stay late that do: packets are late
together, each by its own delay, and a few of them tell nothing."""

HELD_UP = 6.0
"""Median deviations beyond which a stamp was held up."""

STEADY = 20.0
"""Time over which the clock that stamps is steady, s: crystals change by less than 1 ppm in it."""

BATCHES = 8
"""Parts of that time whose means scatter as much as stamps, late together, let them."""

MEANS = 64
"""Batches of samples whose means tell how well a clock is known."""

BENT = 0.01
"""Chance below which a clock that deviates so much from straight pieces has more of them."""


def evened(recording: Recording) -> Recording:
    """Return the recording with times of a steady clock, if its samples were taken evenly.

    Its note `EVENED` then says by how much the stamps scattered, if that is more than times that
    are written with few digits do. Otherwise, and where there is nothing to even out, the recording
    itself is returned.
    """
    if recording.clock == "invalid":
        return recording
    time = even_times(recording.time, recording.gyro, recording.lost)
    if time is None:
        return recording
    scatter = float(np.std(recording.time - time))
    notes = dict(recording.notes)
    if scatter > WRITTEN * recording.interval:
        notes[EVENED] = f"{1e3 * scatter:.2g} ms rms"
    return replace(recording, time=time, notes=notes)


def even_times(
    time: FloatArray, values: FloatArray, lost: IntArray | None = None
) -> FloatArray | None:
    """Return the times at which samples were taken, (n,), if evenly; None if the stamps are right.

    Times are ``a + T k`` with the number k of a sample (lost ones counted). A clock that does not
    keep its pace is followed: by the fewest straight pieces, none shorter than `STEADY`, about
    which stamps scatter by chance. They are right if the values (each against the cubic through
    its four neighbours) are smoother over them than over the stamps.

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
    hole = step > 1.5
    # Stamps of bursts that are counted on have whole steps, too, and many long ones.
    if np.abs(step - np.rint(step))[~hole].max() < EVEN and hole.mean() < HOLES:
        return None
    number = sample_numbers(time, lost)
    even = np.empty_like(time)
    parted = (np.diff(time) > PAUSE) | _out_of_step(time, number, hole)
    edges = [0, *(np.flatnonzero(parted) + 1).tolist(), len(time)]
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


def _out_of_step(time: FloatArray, number: IntArray, hole: BoolArray) -> BoolArray:
    """Return the holes, (n - 1,) bool, after which samples are not taken when they would have been.

    What tracks a body anew begins when it finds it. Stamps on either side then stay late, or early,
    by part of an interval, and scatter by less.
    """
    out = np.zeros(len(hole), bool)
    at = np.flatnonzero(hole) + 1
    at = at[(at >= BESIDE) & (at <= len(time) - BESIDE)]
    if not len(at):
        return out
    interval = _period(time, number)
    late = time - interval * number
    around = np.arange(BESIDE)
    before, after = late[at[:, None] - 1 - around], late[at[:, None] + around]
    moved = np.median(after, axis=1) - np.median(before, axis=1)
    scatter = np.maximum(*(np.median(np.abs(np.diff(x, axis=1)), axis=1) for x in (before, after)))
    shifted = _off_grid(moved, interval)
    at = at[shifted > np.maximum(SHIFTED * interval, STAYS * scatter)]
    out[at[_lasts(late, at, interval)] - 1] = True
    return out


def _lasts(late: FloatArray, at: IntArray, interval: float) -> BoolArray:
    """Return at which samples (k,) stamps become later, or earlier, by part of an interval.

    And stay so: by more than the means of so many samples do by chance, which are as far apart. Of
    fewer than half as many nobody can tell.
    """
    reach = min(LASTING, len(late) // 4)
    total = np.append(0.0, np.cumsum(late - late.mean()))
    low, high = np.maximum(at - reach, 0), np.minimum(at + reach, len(late))
    moved = (total[high] - total[at]) / (high - at) - (total[at] - total[low]) / (at - low)
    # What was shifted once leaves a slope on either side.
    step = np.diff(np.diff(total[::reach]) / reach)
    slope = float(np.median(step)) if len(step) else 0.0
    moved -= slope * (high - low) / (2 * reach)
    usual = float(np.median(np.abs(step - slope))) if len(step) else 0.0
    fewer = np.minimum(high - at, at - low)
    least = np.maximum(SHIFTED * interval, STAYS * usual * np.sqrt(reach / fewer))
    return np.asarray((_off_grid(moved, interval) > least) & (2 * fewer >= reach))


def _off_grid(moved: FloatArray, interval: float) -> FloatArray:
    """Return by how much a move is no whole number of intervals."""
    return np.asarray(np.abs(moved - interval * np.rint(moved / interval)))


def clock_errors(stamps: FloatArray, time: FloatArray) -> FloatArray:
    """Return the standard errors of the offset (s) and the pace of times that follow stamps.

    From the means of batches of (n,) stamps less times; zero where the stamps are the times.
    """
    parts = np.array_split(stamps - time, min(MEANS, len(time)))
    spread = float(np.std([part.mean() for part in parts])) / np.sqrt(len(parts))
    span = float(time[-1] - time[0])
    return np.array([spread, spread * np.sqrt(12.0) / span if span > 0 else 0.0])


def sample_numbers(time: FloatArray, lost: IntArray | None = None) -> IntArray:
    """Return the number of each sample, (n,), with those counted that are lost.

    After a hole in time samples are late by those that are lost: all of them, so that the earliest
    are as well as the middle ones. One that is late by itself is followed by some that come sooner.
    """
    known = np.zeros(len(time), np.int64) if lost is None else lost
    number = np.asarray(np.arange(len(time)) + np.cumsum(known))
    if len(time) <= BESIDE:
        return number
    # The median over few samples is right though many are lost, the mean over many though they
    # come in bursts, and that over a quarter of them all though these are late, too. That is so
    # where fewer lost ones leave no more scatter.
    short = float(np.median(_intervals(time, BESIDE)))
    many = _numbered(time, known, short, BESIDE, STALL)
    if many[-1] == number[-1]:
        return many
    long = _intervals(time, min(BURSTS, len(time) // 2))
    usual = np.abs(long / np.median(long) - 1.0) < LONGEST / BURSTS
    longest = _intervals(time, max(len(time) // 4, 1))
    tried = (float(long[usual].mean()), STALL), (float(np.median(longest)), LATEST)
    for interval, stall in tried:
        few = _numbered(time, known, interval, LONGEST, stall)
        if few[-1] < many[-1] and _scatter(time, few) < NO_WORSE * _scatter(time, many):
            many = few
    return many


def _intervals(time: FloatArray, span: int) -> FloatArray:
    """Return the mean time from sample to sample, over so many."""
    return (time[span:] - time[:-span]) / span


def _numbered(
    time: FloatArray, known: IntArray, interval: float, beside: int, stall: float
) -> IntArray:
    """Return the numbers of samples from roughly how far they are apart, s.

    So many ``beside`` a hole say whether samples are missing there, and at first those that are
    within ``stall`` (s) of it how many.
    """
    for latest in (stall, LATEST):
        # How late stamps are far from a hole can be told if the interval is known well.
        reach = max(beside, min(round(latest / interval), len(time) // 20))
        missing = _count_missing(time, known, interval, reach, beside)
        number = np.arange(len(time)) + np.cumsum(missing)
        interval = _period(time, number)
    return np.asarray(number)


def _scatter(time: FloatArray, number: IntArray) -> float:
    """Return the deviation of stamps from even times, s."""
    return float(np.std(time - _period(time, number) * number))


def _count_missing(
    time: FloatArray, known: IntArray, interval: float, reach: int, beside: int
) -> IntArray:
    """Return how many samples are missing before each, those counted that are known.

    ``reach`` samples on either side of a hole say whether stamps stay late.
    """
    missing = known.copy()
    late = time - interval * (np.arange(len(time)) + np.cumsum(missing))
    holes = np.flatnonzero((np.diff(time) > 1.5 * interval) & (missing[1:] == 0)) + 1
    moved = []
    for some in np.array_split(holes, len(holes) // PART + 1):
        before = late[np.maximum(some[:, None] - 1 - np.arange(beside), 0)]
        after = late[np.minimum(some[:, None] + np.arange(beside), len(late) - 1)]
        moved.append(_later(before, after))
    # What was lost shortly before counts in both, so that each waits for those before it.
    for at in holes[np.concatenate(moved) > 0.5 * interval].tolist():
        first = max(at - reach, 0)
        counted = interval * np.cumsum(missing[first:at])
        before, after = late[first:at] - counted, late[at : at + reach] - counted[-1]
        far = _later(before, after)
        # A few at the end may all be late; not by more than any were before.
        if len(after) < beside and far < np.ptp(before):
            continue
        missing[at] = max(int(np.rint(far / interval)), 0)
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
    parts = [_usual(part) for part in np.array_split(off, blocks)]
    middle = np.array([part.mean() for part in np.array_split(even, blocks)])
    level = np.array([part.mean() for part in parts])
    scatter = [np.var([p.mean() for p in np.array_split(part, BATCHES)]) for part in parts]
    knots, level = _pieces(middle, level, float(np.mean(scatter)) / (BATCHES - 1))
    # The clock goes on at either end as it goes beside it.
    slope = np.diff(level) / np.diff(knots)
    begin = level[0] - slope[0] * (knots[0] - even[0])
    end = level[-1] + slope[-1] * (even[-1] - knots[-1])
    knots, level = np.r_[even[0], knots, even[-1]], np.r_[begin, level, end]
    return np.asarray(even + np.interp(even, knots, level))


def _pieces(at: FloatArray, level: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the fewest straight pieces that levels scatter about as they should.

    Of a clock that keeps its pace stamps then tell one offset and one pace, which all samples share
    in; and no bends, which are nothing but scatter.
    """
    pieces = 1
    while pieces + 1 < len(at):
        knots = np.linspace(at[0], at[-1], pieces + 1)
        hats = np.stack([np.interp(at, knots, unit) for unit in np.eye(pieces + 1)], axis=1)
        fitted = np.linalg.lstsq(hats, level, rcond=None)[0]
        left = float(np.square(level - hats @ fitted).sum())
        if left <= variance * chdtri(len(at) - pieces - 1, BENT):
            return knots, np.asarray(fitted)
        pieces *= 2
    return at, level


def _period(time: FloatArray, number: IntArray) -> float:
    """Return the time from one number to the next, by least squares."""
    at = number - number.mean()
    return float(at @ (time - time.mean())) / float(at @ at)


def _usual(off: FloatArray) -> FloatArray:
    """Return what stamps are off by, those that were held up cut to size."""
    middle = float(np.median(off))
    most = HELD_UP * float(np.median(np.abs(off - middle)))
    return np.clip(off, middle - most, middle + most)


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
