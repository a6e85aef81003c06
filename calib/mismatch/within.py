"""Disturbances that come and go within rests: pulses, jumps, and stretches of restless output.

What is faster than the thirds of a rest leaves little in the rows, and what is slower than a
periodogram, or too short for one, leaves no line. So the samples of each rest are looked at through
windows of one sample to half a second: what a window's mean is off from those before and after it.
A straight drift is nothing there, a jump or a pulse stands out, and noise has the same size in all
rests but for what they differ by anyway.

What several channels show at once may well be motion: a hand, a knock at the bench, a motor nearby.
Only what one channel does alone is said to be none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, pdtrc, stdtr

from calib.faults import ROBUST, resolution, values_of
from calib.mismatch.diagnosis import Interval, Unexplained
from calib.mismatch.ends import expected_overlap
from calib.mismatch.rivals import windows
from calib.poses import Poses
from calib.recording import CHANNELS, Recording
from calib.types import BoolArray, FloatArray, IntArray

CLAIM = 1e-4
"""Family-wise p-value below which something is reported."""

WIDEST = 0.5
"""Longest window, s: of what is slower the rows know."""

MARGIN = 0.25
"""s at either end of a rest that may still belong to the turn."""

LOUDER = 2.0
"""Power from which a stretch of rests differs in kind: below, noise counts as steady."""

CHANCE = 0.1
"""Pulses of a channel, in a recording, that noise alone is expected to make."""

SEVERAL = 4
"""Pulses on one channel that are no noise then: it has so many in 2e-5 of recordings."""

APART = 0.5
"""s between two pulses."""

MISSED = 0.01
"""Share of disturbances that are taken for motion as another channel shows the same by chance."""

CAP = 6.0
"""Times the usual noise beyond which a single value counts no more: those are pulses."""

FEWEST = 8
"""Rests below which none is unusual."""


class _Look(NamedTuple):
    """Differences of means over windows of one width: their rest, time (s) and size in noise."""

    width: int
    rest: IntArray
    time: FloatArray
    size: FloatArray  # (n, 6)


def look_within(recording: Recording, poses: Poses) -> tuple[Unexplained, ...]:
    """Return disturbances within rests of channels that are alone with it."""
    values = _without_spikes(values_of(recording))
    rests = [(a, b) for a, b in zip(poses.start, poses.stop, strict=True) if b - a > 4]
    if not rests:
        return ()
    # Where counts are coarse, noise comes and goes with where between two of them a signal is.
    change = np.vstack([np.diff(values[a:b], axis=0) for a, b in rests])
    noisy = ROBUST * np.median(np.abs(change), axis=0) > np.sqrt(2.0) * resolution(values)
    widths = _widths(recording, poses)
    tried = [_look(recording.time, values, poses, width, noisy) for width in widths]
    looks = [look for look in tried if look is not None]
    if not looks:
        return ()
    pulses = _pulses(looks, recording)
    return tuple(pulses + _stretches(looks, recording, poses, {u.channels for u in pulses}))


def _widths(recording: Recording, poses: Poses) -> list[int]:
    """Return windows of 1, 2, 4 ... samples."""
    longest = min(WIDEST / max(recording.interval, 1e-9), np.median(poses.stop - poses.start) / 8)
    return [1 << k for k in range(int(np.log2(max(longest, 1.0))) + 1)]


def _without_spikes(values: FloatArray) -> FloatArray:
    """Return (n, 6) values, single ones that are off course replaced by their neighbours' mean."""
    out = values.copy()
    mean = 0.5 * (values[:-2] + values[2:])
    off = np.abs(values[1:-1] - mean)
    padded = np.pad(off, ((1, 1), (0, 0)))
    beside = np.maximum(padded[:-2], padded[2:])
    # One sample has half of its size on either side; an edge has as much on one.
    alone = (off > CAP * ROBUST * np.median(off, axis=0)) & (off > 1.5 * beside)
    out[1:-1][alone] = mean[alone]
    return out


def _look(
    time: FloatArray, values: FloatArray, poses: Poses, width: int, noisy: BoolArray
) -> _Look | None:
    """Look at (n, 6) values through windows of one width, every half of it."""
    half = max(1, width // 2)
    interval = float(np.median(np.diff(time)))
    margin = round(MARGIN / max(interval, 1e-9))
    rest, at, rows = [], [], []
    for k, (a, b) in enumerate(zip(poses.start + margin, poses.stop - margin, strict=True)):
        first = np.arange(width, b - a - 2 * width + 1, half)
        # Not across a gap: what was left out of a long rest, or lost.
        spans = time[a + first + 2 * width - 1] - time[a + first - width]
        first = first[spans <= (3 * width + 1) * interval]
        if len(first) < 4:
            continue
        own = values[a:b]
        total = np.concatenate((np.zeros((1, 6)), np.cumsum(own - own.mean(axis=0), axis=0)))
        mean = (total[width:] - total[:-width]) / width
        rows.append(mean[first] - 0.5 * (mean[first - width] + mean[first + width]))
        rest.append(np.full(len(first), k))
        at.append(a + first + width // 2)
    if len(rest) < 6:
        return None
    off, which = np.concatenate(rows), np.concatenate(rest)
    usual = ROBUST * np.median(np.abs(off), axis=0)
    return _Look(width, which, time[np.concatenate(at)], off / np.where(noisy, usual, np.inf))


def _pulses(looks: list[_Look], recording: Recording) -> list[Unexplained]:
    """Return channels with several pulses or jumps that no other shows, from first to last."""
    start, stop = float(recording.time[0]), float(recording.time[-1])
    number = sum(look.size.size for look in looks)
    limit = -float(ndtri(CHANCE / (number / len(CHANNELS)) / 2))
    moments = int((stop - start) / APART) + 3
    # The largest of each moment, at all widths: in the usual noise, and in that of its own rest.
    seen, hit = np.zeros((moments, 6)), np.zeros((moments, 6))
    for look in looks:
        at = ((look.time - start) / APART).astype(np.int64) + 1
        np.maximum.at(seen, at, np.abs(look.size))
        if look.width > 1:
            # Single samples off course are mishaps of the readout, which the audit reports.
            np.maximum.at(hit, at, np.abs(look.size) / _own_scale(look)[look.rest])
    near = np.maximum(seen[1:-1], np.maximum(seen[:-2], seen[2:]))
    companion = -float(ndtri(MISSED / (number / max((seen > 0).sum(), 1)) / 30))
    out = []
    for c, channel in enumerate(CHANNELS):
        alone = (np.delete(near, c, axis=1) < companion).all(axis=1)
        found = np.flatnonzero((hit[1:-1, c] > limit) & alone)
        # A pulse on the edge of two moments is one.
        found = found[np.diff(found, prepend=-2) > 1]
        if len(found) < SEVERAL:
            continue
        p = float(pdtrc(len(found) - 1, CHANCE)) * len(CHANNELS)
        where = _densest(np.asarray(start + APART * (found + 0.5)), (start, stop))
        out.append(Unexplained((channel,), (where,), "the time: pulses there", p))
    return out


def _densest(moments: FloatArray, whole: Interval) -> Interval:
    """Return where pulses at (k,) moments most likely begin and end, in order of time.

    Poisson processes: inside with the rate that is seen, outside with that of noise.
    """
    start, stop = whole
    first, last = np.triu_indices(len(moments), SEVERAL - 1)
    number = last - first + 1
    # Of n moments anywhere in an interval the extremes are an (n + 1)-th of it from its ends.
    beyond = (moments[last] - moments[first]) / (number - 1)
    begin = np.maximum(moments[first] - beyond, start)
    end = np.minimum(moments[last] + beyond, stop)
    value = number * np.log(number / (end - begin)) - number
    value += (len(moments) - number) * np.log(CHANCE / (stop - start))
    best = int(np.argmax(value))
    return float(begin[best]), float(end[best])


def _own_scale(look: _Look) -> FloatArray:
    """Return how much noisier each rest is than is usual, at least 1, (rests, 6)."""
    out = np.ones((int(look.rest.max()) + 1, 6))
    for k in np.unique(look.rest):
        own = np.abs(look.size[look.rest == k])
        out[k] = np.maximum(1.0, ROBUST * np.median(own, axis=0))
    return out


def _stretches(
    looks: list[_Look], recording: Recording, poses: Poses, known: set[tuple[str, ...]]
) -> list[Unexplained]:
    """Return stretches of rests in which a channel is restless, and neither before nor after."""
    rests = np.unique(looks[0].rest)
    some = [w for w in windows(len(rests)) if w[1] - w[0] >= 2]
    if len(rests) < FEWEST:
        return []
    found = [_louder(look, rests, some) for look in looks]
    stands, chances, stirred = (np.stack(part) for part in zip(*found, strict=True))
    ends = poses.interval[rests]
    companion = -float(ndtri(MISSED / (5 * len(looks))))
    first, last = np.array(some).T
    out = []
    for c, channel in enumerate(CHANNELS):
        if (channel,) in known:
            continue
        k, w = np.unravel_index(int(np.argmin(chances[:, :, c])), chances.shape[:2])
        p = float(chances[k, w, c]) * chances.size
        others = np.delete(stirred[:, w].max(axis=0), c)
        if p >= CLAIM or (others > companion).any():
            continue
        gain = 0.5 * np.square(stands[k, :, c])
        weight = np.where(stands[k, :, c] > 0, np.exp(gain - gain.max()), 0.0)
        where = expected_overlap(ends[first, 0], ends[last - 1, 1], weight)
        out.append(Unexplained((channel,), (where,), "the time: it is restless there", p))
    return out


def _louder(
    look: _Look, rests: IntArray, some: list[tuple[int, int]]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how much louder rests are in each window than outside, (w, 6): standard errors, p.

    And the same against the quieter half of those outside, which a hand that moves more or less
    throughout shows.

    What rests outside differ by, beyond what chance makes of their noise, widens the errors.
    """
    place = np.searchsorted(rests, look.rest)
    count = np.bincount(place, minlength=len(rests)).astype(float)
    square = np.minimum(np.square(look.size), CAP**2)
    power = np.stack([np.bincount(place, square[:, c], len(rests)) for c in range(6)], axis=1)
    here = count > 0
    level = np.log(np.maximum(power, 1e-12) / np.maximum(count, 1.0)[:, None])
    chance = 2.0 / np.maximum(count * _independent(look.width), 1.0)
    stand, p, stirred = np.zeros((3, len(some), 6))
    p += 1.0
    for i, (a, b) in enumerate(some):
        inside = here & (np.arange(len(rests)) >= a) & (np.arange(len(rests)) < b)
        outside = here & ~inside
        n, m = int(inside.sum()), int(outside.sum())
        if n < 2 or m < FEWEST // 2:
            continue
        usual = np.median(level[outside], axis=0)
        off = np.abs(level[outside] - usual)
        scatter = np.maximum(
            np.square(ROBUST * np.median(off, axis=0)), np.square(off).mean(axis=0)
        )
        own = np.maximum(scatter - np.median(chance[outside]), 0.0)
        more = level[inside].mean(axis=0) - level[outside].mean(axis=0)
        error = own / n + chance[inside].mean() / n + own / m + chance[outside].mean() / m
        total = own + chance[outside].mean()
        freedom = (m - 1) * np.square(total / np.maximum(own, 1e-9 * total))
        stand[i] = more / np.sqrt(error)
        tail = stdtr(np.minimum(freedom, 1e9), -stand[i])
        p[i] = np.where(more > np.log(LOUDER), tail, 1.0)
        # The quieter half of normal errors has a mean of -0.8.
        quiet = np.sort(level[outside], axis=0)[: m // 2].mean(axis=0)
        quiet += np.sqrt(2.0 / np.pi * chance[outside].mean())
        error = chance[inside].mean() / n + 2.0 * chance[outside].mean() / m
        stirred[i] = (level[inside].mean(axis=0) - quiet) / np.sqrt(error)
    return stand, p, stirred


def _independent(width: int) -> float:
    """Return the share of independent ones among the differences of means of white noise."""
    half = max(1, width // 2)
    kernel = np.repeat([-0.5, 1.0, -0.5], width)
    lags = np.correlate(kernel, kernel, mode="full")[len(kernel) - 1 :: half]
    return float(1.0 / (1.0 + 2.0 * np.square(lags[1:] / lags[0]).sum()))
