"""Samples at rest beside a truth: what they show that the motion of the truth does not have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.faults import values_of
from calib.mismatch.findings.diagnosis import Interval, Unexplained
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.band import noise_of
from calib.mismatch.reference.truths import DEGREE
from calib.mismatch.samples.resting import look_at_rests
from calib.mismatch.samples.spectrum import LOUDER_THERE, lines_of
from calib.poses import Poses
from calib.recording import CHANNELS, TRIADS, Recording
from calib.types import FloatArray

MOVES = 2.0
"""Power of a truth's samples, times that in quiet rests, from which they are shaken as well."""

QUIET = 0.25
"""Quantile of that power over rests which is that of quiet ones: half of them may be shaken."""

FEWEST = 8
"""Samples of a truth in a rest below which they tell nothing of it."""

LATE, TAPS = 0.05, 11
"""s by which a channel may show a motion earlier or later, and moments within that of which what it
shows is a sum: a low-pass of 15 Hz is one, at what a hand trembles with."""

PART, PARTS = 500, 60
"""Samples of a rest that are fitted at once, and how many such parts at most: a day is not."""

TAKEN = 0.1
"""Power of the motion that was taken off at a frequency, relative to what is left there, from which
on noise of its truth is in that."""

SILENT = 0.1
"""Noise of a truth, relative to the recording's, that does not show beside it."""

HARDLY = 0.05
"""Share of the power of a channel at rest below which what a truth explains of it is left in: where
counts are coarse, to take it off would blur them."""


def noise_beside(
    heard: Recording, poses: Poses, truth: Recording | None, alignment: Alignment
) -> tuple[Unexplained, ...]:
    """Return what samples at rest show, but for what is motion.

    So is what a truth shows in the same rests. Markers and profiles are too slow for that, and have
    no samples of their own: what shakes all axes of an accelerometer may then be motion. Channels
    of ``heard`` that have no noise are made `audible` before.
    """
    before = heard
    if truth is not None:
        heard, poses = _without_motion(heard, poses, truth, alignment)
    noisy = look_at_rests(heard, poses)
    if truth is not None and heard is not before and _is_noisy(truth, before):
        noisy = tuple(_without_rest(item, before, heard, poses) for item in noisy)
        noisy = tuple(item for item in noisy if item.follows)
    if not noisy:
        return ()
    if truth is None:
        return tuple(item for item in noisy if not _shakes(item, noisy))
    at = alignment.times(poses.interval)
    power = _fast_power(truth, at)
    return tuple(item for item in noisy if not _moves(item, poses.interval, power))


def _without_motion(
    heard: Recording, poses: Poses, truth: Recording, alignment: Alignment
) -> tuple[Recording, Poses]:
    """Return a recording whose rests move by what is left beside a truth, where that moves.

    A body held in a hand trembles in all of its rests. How much of each of the truth's signals, a
    little earlier or later too, is in a channel is fitted to all of them: it may be mounted
    otherwise, late, or behind a low-pass, and its noise is in none. Rests come back as far as the
    truth has them, without what turns may do to their ends.
    """
    from scipy.interpolate import make_interp_spline  # needed here only

    at = alignment.times(heard.time)
    first, last = np.searchsorted(at, truth.time[[0, -1]] + [LATE, -LATE])
    edge = int(np.ceil(LATE / heard.interval))
    start, stop = np.clip((poses.start + edge, poses.stop - edge), first, last)
    rests = [slice(a, b) for a, b in zip(start, stop, strict=True) if b - a >= FEWEST]
    if not rests or len(truth) <= DEGREE:
        return heard, poses
    seen = make_interp_spline(truth.time, values_of(truth), k=DEGREE)
    late = np.linspace(-LATE, LATE, TAPS)

    def motion(part: slice) -> FloatArray:
        return np.asarray(seen(at[part][:, None] + late).reshape(len(at[part]), -1))

    parts = [[slice(k, min(k + PART, r.stop)) for k in range(r.start, r.stop, PART)] for r in rests]
    every = [part for rest in parts for part in rest]
    some = every[:: -(-len(every) // PARTS)]
    moves = np.concatenate([_without_line(motion(part)) for part in some])
    shown = np.concatenate([_without_line(values_of(heard)[part]) for part in some])
    shares = np.linalg.lstsq(moves, shown, rcond=1e-10)[0]
    power = np.square(moves @ shares).sum(axis=0)
    shares[:, power < HARDLY * np.square(shown).sum(axis=0)] = 0.0
    if not shares.any():
        return heard, poses
    values = values_of(heard).copy()
    for rest in parts:
        level = (motion(rest[0]) @ shares).mean(axis=0)
        for part in rest:
            values[part] -= motion(part) @ shares - level
    known = replace(poses, start=start, stop=stop).select(stop - start >= FEWEST)
    return replace(heard, accel=values[:, :3], gyro=values[:, 3:]), known


def _is_noisy(truth: Recording, recording: Recording) -> bool:
    return bool((noise_of(truth) > SILENT * noise_of(recording)).any())


def _without_rest(
    item: Unexplained, before: Recording, heard: Recording, poses: Poses
) -> Unexplained:
    """Return an item without lines at frequencies of the motion that was taken off.

    With that came noise of the truth, of the motion's frequencies: it stands out of the noise that
    there was, as lines do.
    """
    lines = lines_of(item)
    if not lines:
        return item
    index = [CHANNELS.index(channel) for channel in item.channels]
    left = values_of(heard)[:, index]
    taken = values_of(before)[:, index] - left

    def power(values: FloatArray, frequency: float) -> FloatArray:
        total = np.zeros(len(index))
        for a, b in zip(poses.start, poses.stop, strict=True):
            for first in range(a, b - PART // 2, PART):
                part = slice(first, min(first + PART, b))
                turn = np.exp(-2j * np.pi * frequency * heard.time[part])
                turn *= np.hanning(len(turn))
                own = values[part] - values[part].mean(axis=0)
                total += np.square(np.abs(turn @ own))
        return total

    kept, shown = [], np.zeros(len(index), bool)
    for line, frequency in lines.items():
        here = power(left, frequency)
        if power(taken, frequency).sum() > TAKEN * here.sum():
            continue
        kept.append(line)
        beside = power(left, 0.9 * frequency) + power(left, 1.1 * frequency)
        shown |= here >= here.max() if (here < beside).all() else here > beside
    if len(kept) == len(lines):
        return item
    words = [part for part in item.follows.split(", ") if part in kept or part not in lines]
    channels = tuple(c for c, there in zip(item.channels, shown, strict=True) if there)
    return replace(item, follows=", ".join(words), channels=channels or item.channels)


def _without_line(values: FloatArray) -> FloatArray:
    """Return (n, k) values without their means and slopes."""
    place = np.linspace(-1.0, 1.0, len(values))
    slope = place @ values / (place @ place)
    return np.asarray(values - values.mean(axis=0) - np.outer(place, slope))


def _shakes(item: Unexplained, noisy: tuple[Unexplained, ...]) -> bool:
    """Whether an item is louder noise where all axes of the accelerometer are louder.

    Each may be so from a rest of its own on: together or in several of the ``noisy`` items.
    """
    along = {f"accel.{axis}" for axis in "xyz"}
    if item.follows != LOUDER_THERE or not along & set(item.channels):
        return False
    there = [
        other
        for other in noisy
        if other.follows == LOUDER_THERE
        and any(_meet(a, b) for a in item.intervals for b in other.intervals)
    ]
    return along <= {channel for other in there for channel in other.channels}


def _fast_power(truth: Recording, rests: FloatArray) -> FloatArray:
    """Return the power of changes from sample to sample in (n, 2) rests, (n, 2): of each triad.

    It is relative to what it is in quiet ones; NaN of rests that the truth does not have.
    """
    change = np.square(np.diff(values_of(truth), axis=0)).reshape(-1, 2, 3).sum(axis=2)
    total = np.concatenate((np.zeros((1, 2)), np.cumsum(change, axis=0)))
    first = np.searchsorted(truth.time, rests[:, 0])
    last = np.maximum(np.searchsorted(truth.time, rests[:, 1]) - 1, first)
    count = (last - first)[:, None]
    last = np.minimum(last, len(total) - 1)
    first = np.minimum(first, last)
    power = np.where(count >= FEWEST, (total[last] - total[first]) / np.maximum(count, 1), np.nan)
    known = np.isfinite(power[:, 0])
    usual = np.quantile(power[known], QUIET, axis=0) if known.any() else np.ones(2)
    # Without noise, what does not move has the rounding of its own values alone.
    least = 1e-24 * np.square(np.abs(values_of(truth)).max())
    return np.asarray(power / np.maximum(usual, least))


def _moves(item: Unexplained, rests: FloatArray, power: FloatArray) -> bool:
    """Whether a truth is shaken in rests in which an item says that a sensor is."""
    here = np.array([any(_meet(rest, where) for where in item.intervals) for rest in rests])
    triads = [k for k, t in enumerate(TRIADS) if any(c.startswith(t) for c in item.channels)]
    return bool((power[here][:, triads] > MOVES).any())


def _meet(one: FloatArray | Interval, other: Interval) -> bool:
    return bool(one[0] <= other[1] and other[0] <= one[1])
