"""Disturbances that come and go within rests: pulses, jumps, and stretches of restless output.

What is faster than the thirds of a rest leaves little in the rows, and what is slower than a
periodogram, or too short for one, leaves no line. So the samples of each rest are looked at through
windows of one sample to half a second: what a window's mean is off from those before and after it.
A straight drift is nothing there, a jump or a pulse stands out, and noise has the same size in all
rests but for what they differ by anyway.

What is left beside a truth is looked at in the same way, and all along: it has no motion.

What several channels show at once may well be motion: a hand, a knock at the bench, a motor nearby.
Only what one channel does alone is said to be none.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import bdtrc, ndtr, ndtri, pdtrc, stdtr

from calib.decimals import counts_at
from calib.faults import OTHERS, ROBUST, level_nearby, resolution, values_of
from calib.mismatch.findings.diagnosis import Interval, Unexplained
from calib.mismatch.hypotheses.ends import expected_overlap
from calib.mismatch.hypotheses.windows import windows
from calib.mismatch.samples.found import RESTLESS
from calib.mismatch.samples.power import CLAIM
from calib.mismatch.samples.spectrum import HIDDEN, SETTLED, SHARE
from calib.mismatch.samples.tails import beyond, tails, usual_of
from calib.poses import Poses
from calib.recording import CHANNELS, Recording
from calib.types import BoolArray, FloatArray, IntArray

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

PULSES = "the time: pulses there"

JOLT, MOST_JOLTS = 20.0, 4
"""Noises by which a moment is off that is a jolt beside a truth without noise, and how many there
are at most: of more, the truth has corners, or noise that is not normal."""

JOLTED = "the time: a jolt there"

OFF_COURSE = "the time: single samples are off course there"
"""What single samples that no others go with follow."""

SOME = 0.02
"""Share of the changes of a channel that may be less than a count."""

MOST_SPIKES = 500
"""Single samples of a channel that are looked at, at most; of more, every second or third."""

APART = 0.5
"""s between two pulses."""

MISSED = 0.01
"""Share of disturbances that are taken for motion as another channel shows the same by chance."""

CAP = 6.0
"""Times the usual noise beyond which a single value counts no more: those are pulses."""

LARGEST_OF = 1.25
"""What the largest of three medians of noise nearby is, times that of all of it."""

LONE = 3.5
"""The same of one that no neighbour goes with, for what takes more samples than one."""

FEWEST = 8
"""Rests below which none is unusual."""

LOOKED_AT = 6
"""Rests that are long enough for a width of windows, at least."""

NEARBY, STRETCH = 5.0, 1.5
"""s of differences from a truth that have noise of their own: a turn and what is beside it; and
those between which it may differ, as between rests."""

STILL_LOUD = 2.0
"""Standard errors by which the second halves of restless rests are louder."""

STRETCHES = 200
"""Such parts of a recording, at most: those of a longer one are longer."""


class _Look(NamedTuple):
    """Differences of means over windows of one width: their rest, time (s) and size in noise."""

    width: int
    rest: IntArray
    time: FloatArray
    size: FloatArray  # (n, 6)


def look_within(recording: Recording, poses: Poses) -> tuple[Unexplained, ...]:
    """Return disturbances within rests of channels that are alone with it."""
    raw = values_of(recording)
    off, alone, lone = _off_course(raw, poses)
    spikes = _spikes(recording, poses, off, alone)
    values = _without_lone(raw, lone)
    rests = [(a, b) for a, b in zip(poses.start, poses.stop, strict=True) if b - a > 4]
    if not rests:
        return tuple(spikes)
    # Where counts are coarse, noise comes and goes with where between two of them a signal is.
    change = np.vstack([np.diff(values[a:b], axis=0) for a, b in rests])
    step = resolution(raw)
    # The mean, as a median of few counts is off by up to half of one.
    noise = np.sqrt(np.pi) / 2.0 * np.abs(change).mean(axis=0)
    step[noise <= HIDDEN * step] = np.inf
    margin = round(MARGIN / max(recording.interval, 1e-9))
    pieces = np.stack((poses.start + margin, poses.stop - margin), axis=1)
    longest = float(np.median(poses.stop - poses.start)) / 8
    tried = [
        _look(recording.time, values, pieces, width, step, least=LOOKED_AT)
        for width in _widths(recording.interval, longest)
    ]
    looks = [look for look in tried if look is not None]
    if not looks:
        return tuple(spikes)
    tail = tails(np.concatenate([off[a : b - 2] for a, b in rests]), step)
    # What was put down rings at first.
    calm = poses.interval[:, 0] + SETTLED
    later = [own for look in looks if len((own := _after(look, calm)).rest)]
    pulses = spikes + (_pulses(later, recording.time, tail) if later else [])
    known = {u.channels for u in pulses}
    return tuple(pulses + _stretches(looks, poses.interval, known, after_turns=True))


def look_beside(
    time: FloatArray, left: FloatArray, *, exact: bool = False
) -> tuple[Unexplained, ...]:
    """Return channels that have pulses or are restless beside a truth, at rest or in motion.

    Parameters
    ----------
    time : (n,) array, s
        Increasing; a gap is seen as one.
    left : (n, 6) array
        What is left of samples beside the truth: noise, about as large throughout and white. On a
        channel on which it is nothing, nothing is seen.
    exact : bool
        Whether the truth has no noise of its own. Then no motion is left either, and one jolt is
        one, whichever channels show it.
    """
    if len(time) < 2:
        return ()
    interval = float(np.median(np.diff(time)))
    whole = np.array([[0, len(time)]])
    step = np.where(left.any(axis=0), 0.0, np.inf)
    tried = [
        _look(time, left, whole, width, step, least=1)
        for width in _widths(interval, len(time) / FEWEST)
    ]
    looks = [look for look in tried if look is not None]
    if not looks:
        return ()

    def by(seconds: float) -> list[_Look]:
        return [
            look._replace(rest=((look.time - time[0]) / seconds).astype(np.int64)) for look in looks
        ]

    tail = tails(np.abs(looks[0].size), step)
    pulses = _pulses(by(NEARBY), time, tail)
    if exact:
        pulses += _jolts(looks, time)
    each = max(STRETCH, (time[-1] - time[0]) / STRETCHES)
    edges = np.arange(time[0], time[-1] + each, each)
    ends = np.stack((edges[:-1], np.minimum(edges[1:], time[-1])), axis=1)
    return tuple(pulses + _stretches(by(each), ends, {u.channels for u in pulses}))


def _widths(interval: float, longest: float) -> list[int]:
    """Return windows of 1, 2, 4 ... samples, up to the longest and to `WIDEST`."""
    longest = min(WIDEST / max(interval, 1e-9), longest)
    return [1 << k for k in range(int(np.log2(max(longest, 1.0))) + 1)]


def _off_course(values: FloatArray, poses: Poses) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return how far samples are off their neighbours' mean, and which are so alone.

    Then which of them are alone with less than that: a pulse has more samples than one, and noise
    that is not normal makes such as it likes. All are (n - 2, 6), without the first and the last
    sample. Where a rest is louder than usual (something shakes it), or a moment of one (a hand is
    still there), those that stand out of that are so: the others are noise.
    """
    off = _off(values)
    padded = np.pad(off, ((1, 1), (0, 0)))
    beside = np.maximum(padded[:-2], padded[2:])
    step = counts_at(values, _step(values))[1:-1]
    # To the next count and back is what noise does where counts are coarse: off by halves of one,
    # which the decimals of a file know but roughly.
    jumps = off > 1.75 * step
    level = _at_rest(off, poses)
    # One sample has half of its size on either side, and noise; an edge has as much on one.
    alone = jumps & (off > CAP * level) & (off + level > 1.5 * beside)
    # What is left without these is louder where something shakes, and where a hand is still there.
    about = level_nearby(_off(_without_lone(values, alone)).T).T
    level = np.maximum(level, ROBUST / LARGEST_OF * np.where(about > step, about, 0.0))
    alone &= off > CAP * level
    lone = jumps & (off > LONE * level) & (off > 1.5 * beside)
    return off, alone, lone


def _off(values: FloatArray) -> FloatArray:
    """Return how far each of (n, k) values is off the mean of its neighbours, (n - 2, k)."""
    return np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))


def _at_rest(off: FloatArray, poses: Poses) -> FloatArray:
    """Return how far samples of a rest usually are off, and of this one if more, (n - 2, k)."""
    rests = [slice(max(a - 1, 0), b - 1) for a, b in zip(poses.start, poses.stop, strict=True)]
    rests = [own for own in rests if own.stop - own.start > 3]
    still = np.concatenate([off[own] for own in rests]) if rests else off
    level = np.tile(ROBUST * np.median(still, axis=0), (len(off), 1))
    for own in rests:
        level[own] = np.maximum(level[own], ROBUST * np.median(off[own], axis=0))
    return level


def _step(values: FloatArray) -> FloatArray:
    """Return what nearly all changes of the (n, 6) values reach, (6,): a count where it is coarse.

    A few samples may lie between two counts, where something was bridged.
    """
    change = np.abs(np.diff(values, axis=0))
    return np.array([np.quantile(own[own > 0], SOME) if own.any() else 0.0 for own in change.T])


def _without_lone(values: FloatArray, lone: BoolArray) -> FloatArray:
    """Return (n, 6) values, those that are off course alone replaced by their neighbours' mean."""
    out = values.copy()
    out[1:-1][lone] = (0.5 * (values[:-2] + values[2:]))[lone]
    return out


def _look(
    time: FloatArray,
    values: FloatArray,
    pieces: IntArray,
    width: int,
    step: FloatArray,
    *,
    least: int,
) -> _Look | None:
    """Look at (n, 6) values through windows of one width, every half of it.

    That is in ``pieces`` ``[start, stop)`` (k, 2) of samples; nothing is returned if fewer than
    ``least`` are long enough. ``step`` is a count of each channel, infinite where nothing is to be
    seen.
    """
    half = max(1, width // 2)
    interval = float(np.median(np.diff(time)))
    rest, at, rows = [], [], []
    for k, (a, b) in enumerate(pieces.tolist()):
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
    if len(rest) < least:
        return None
    off, which = np.concatenate(rows), np.concatenate(rest)
    return _Look(width, which, time[np.concatenate(at)], off / usual_of(off, step / width))


def _pulses(looks: list[_Look], time: FloatArray, tail: FloatArray) -> list[Unexplained]:
    """Return channels with several pulses or jumps that no other shows, from first to last.

    ``tail`` are the tails of their noise, as `tails` has them.
    """
    start, stop = float(time[0]), float(time[-1])
    number = sum(look.size.size for look in looks)
    chance = CHANCE / (number / len(CHANNELS)) / 2
    moments, places = _moments(looks, start)
    # The largest of each moment, at all widths: in the usual noise, and, as a share of what noise
    # hardly reaches, in that of its own rest.
    seen, hit = np.zeros((2, len(moments), 6))
    for look, place in zip(looks, places, strict=True):
        # One after another in time: each moment's are side by side.
        at, first = np.unique(place, return_index=True)
        size = np.abs(look.size)
        seen[at] = np.maximum(seen[at], np.maximum.reduceat(size, first))
        limit = beyond(tail, look.width, chance)
        if look.width > 1 and (size > limit).any():
            # Single samples off course are mishaps of the readout, which the audit reports.
            share = size / _own_scale(look)[look.rest] / limit
            hit[at] = np.maximum(hit[at], np.maximum.reduceat(share, first))
    near, beside = seen.copy(), np.flatnonzero(np.diff(moments) == 1)
    near[beside + 1] = np.maximum(near[beside + 1], seen[beside])
    near[beside] = np.maximum(near[beside], seen[beside + 1])
    companion = -float(ndtri(MISSED / (number / max((seen > 0).sum(), 1)) / 30))
    out = []
    for c, channel in enumerate(CHANNELS):
        alone = (np.delete(near, c, axis=1) < companion).all(axis=1)
        found = moments[(hit[:, c] > 1.0) & alone]
        # A pulse on the edge of two moments is one.
        found = found[np.diff(found, prepend=-2) > 1]
        if len(found) < SEVERAL:
            continue
        p = float(pdtrc(len(found) - 1, CHANCE)) * len(CHANNELS)
        where = densest(np.asarray(start + APART * (found + 0.5)), (start, stop))
        out.append(Unexplained((channel,), (where,), PULSES, p))
    return out


def _moments(looks: list[_Look], start: float) -> tuple[IntArray, list[IntArray]]:
    """Return the moments, from the start on, that are looked at, and which is that of each value.

    Those of a clock that jumps by years are few.
    """
    every = [((look.time - start) / APART).astype(np.int64) for look in looks]
    moments = np.unique(np.concatenate(every))
    return moments, [np.searchsorted(moments, own) for own in every]


def is_told(item: Unexplained, others: Sequence[Unexplained]) -> bool:
    """Whether a jolt is that of something else, which is left in the samples: in it, or at an end.

    Ends are known to some seconds.
    """
    alike = [other for other in others if set(other.channels) & set(item.channels)]
    spans = [where for other in alike for where in other.intervals]
    return item.follows == JOLTED and all(
        any(start - NEARBY <= b and a <= stop + NEARBY for start, stop in spans)
        for a, b in item.intervals
    )


def _jolts(looks: list[_Look], time: FloatArray) -> list[Unexplained]:
    """Return the few moments at which channels are off by many noises: one item of all of them."""
    start, stop = float(time[0]), float(time[-1])
    moments, places = _moments(looks, start)
    seen = np.zeros((len(moments), 6))
    for look, place in zip(looks, places, strict=True):
        np.maximum.at(seen, place, np.abs(look.size))
    large = (seen > JOLT).any(axis=1)
    apart = np.diff(moments[large]) > 1
    first = moments[large][np.append(True, apart)[: large.sum()]]
    last = moments[large][np.append(apart, True)[: large.sum()]] + 1
    if not 0 < len(first) <= MOST_JOLTS:
        return []
    shown = seen[large].max(axis=0)
    where = tuple(
        (start + APART * a, min(start + APART * b, stop))
        for a, b in zip(first.tolist(), last.tolist(), strict=True)
    )
    channels = tuple(c for c, size in zip(CHANNELS, shown, strict=True) if size > JOLT)
    p = 2.0 * float(ndtr(-JOLT)) * sum(look.size.size for look in looks)
    return [Unexplained(channels, where, JOLTED, p)]


def _spikes(
    recording: Recording, poses: Poses, off: FloatArray, alone: BoolArray
) -> list[Unexplained]:
    """Return channels of which single samples are off course, and where.

    In some part of the recording; or throughout, where they have a `SHARE` of the noise's power:
    a few small ones anywhere are mishaps of the readout, which the audit reports.
    """
    still = np.zeros(len(recording) + 1)
    np.add.at(still, poses.start, 1.0)
    np.add.at(still, poses.stop, -1.0)
    at_rest = np.cumsum(still[:-1]) > 0
    # Turns are left out of time: a hand makes edges of its own.
    passed = np.cumsum(at_rest) * recording.interval
    off = off / usual_of(off, np.zeros(off.shape[1]))
    out = []
    for c, channel in enumerate(CHANNELS):
        others = np.delete(off, c, axis=1).max(axis=1) < OTHERS
        here = alone[:, c] & others & at_rest[1:-1]
        power = float(np.square(off[here, c]).sum()) / float(at_rest.sum())
        every = passed[1:-1][here]
        moments = every[:: len(every) // MOST_SPIKES + 1]
        n = len(moments)
        if n < SEVERAL:
            continue
        first, last, begin, end = _runs(moments, (0.0, float(passed[-1])))
        number, share = last - first + 1, (end - begin) / passed[-1]
        # How rarely so many of the others, which may be anywhere, are between some two of them.
        p = bdtrc(number - 3, n - 2, np.minimum(share, 1.0)) * len(first) * len(CHANNELS)
        best = np.flatnonzero(p <= p.min())[-1]
        if p[best] < CLAIM:
            k = np.searchsorted(passed, [begin[best], end[best]])
            where = float(recording.time[k[0]]), float(recording.time[min(k[1], len(off))])
            out.append(Unexplained((channel,), (where,), OFF_COURSE, float(p[best])))
        elif power > SHARE:
            where = float(recording.time[0]), float(recording.time[-1])
            chance = float(pdtrc(len(every) - 1, 2.0 * ndtr(-CAP) * at_rest.sum()))
            out.append(Unexplained((channel,), (where,), OFF_COURSE, chance * len(CHANNELS)))
    return out


def _runs(
    moments: FloatArray, whole: Interval
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Return the first and last of each run of several moments, and where it begins and ends."""
    first, last = np.triu_indices(len(moments), SEVERAL - 1)
    # Of n moments anywhere in an interval the extremes are an (n + 1)-th of it from its ends.
    beyond = (moments[last] - moments[first]) / (last - first)
    begin = np.maximum(moments[first] - beyond, whole[0])
    return first, last, begin, np.minimum(moments[last] + beyond, whole[1])


def densest(moments: FloatArray, whole: Interval) -> Interval:
    """Return where pulses at (k,) moments most likely begin and end, in order of time.

    Poisson processes: inside with the rate that is seen, outside with that of noise.
    """
    start, stop = whole
    first, last, begin, end = _runs(moments, whole)
    number = last - first + 1
    value = number * np.log(number / (end - begin)) - number
    value += (len(moments) - number) * np.log(CHANCE / (stop - start))
    best = int(np.argmax(value))
    return float(begin[best]), float(end[best])


def _own_scale(look: _Look) -> FloatArray:
    """Return how much noisier each rest is than is usual, at least 1, (rests, 6)."""
    rests, first = np.unique(look.rest, return_index=True)
    out = np.ones((int(rests[-1]) + 1, 6))
    for k, own in zip(rests, np.split(np.abs(look.size), first[1:]), strict=True):
        out[k] = np.maximum(1.0, ROBUST * np.median(own, axis=0))
    return out


def _stretches(
    looks: list[_Look],
    intervals: FloatArray,
    known: set[tuple[str, ...]],
    *,
    after_turns: bool = False,
) -> list[Unexplained]:
    """Return stretches of rests in which a channel is restless, and neither before nor after.

    The rests are those ``intervals`` (k, 2), s. ``after_turns`` what has gone in their second
    halves is what turns left: a sensor on foam rings, about an axis that others do not see.
    """
    rests = np.unique(looks[0].rest)
    some = [w for w in windows(len(rests)) if w[1] - w[0] >= 2]
    if len(rests) < FEWEST:
        return []
    found = [_louder(look, rests, some) for look in looks]
    stands, chances, stirred = (np.stack(part) for part in zip(*found, strict=True))
    ends = intervals[rests]
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
        if after_turns and _fades(looks[k], intervals, rests, some[w], c):
            continue
        gain = np.where(stands[k, :, c] > 0, 0.5 * np.square(stands[k, :, c]), -np.inf)
        where = expected_overlap(ends[first, 0], ends[last - 1, 1], np.exp(gain - gain.max()))
        out.append(Unexplained((channel,), (where,), RESTLESS, p))
    return out


def _after(look: _Look, begin: FloatArray) -> _Look:
    """Return what is seen in each rest after some moment (rests,), s."""
    late = look.time > begin[look.rest]
    return look._replace(rest=look.rest[late], time=look.time[late], size=look.size[late])


def _fades(
    look: _Look, intervals: FloatArray, rests: IntArray, window: tuple[int, int], channel: int
) -> bool:
    """Whether rests in a window are no louder than others in their second halves."""
    begin = np.maximum(intervals.mean(axis=1), intervals[:, 0] + SETTLED)
    stands, _, _ = _louder(_after(look, begin), rests, [window])
    # Nothing is known of rests that are too short for that.
    return bool(0.0 != stands[0, channel] < STILL_LOUD)


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
    here = (count > 0)[:, None]
    level = here * np.log(np.maximum(power, 1e-12) / np.maximum(count, 1.0)[:, None])
    chance = here * 2.0 / np.maximum(count * _independent(look.width), 1.0)[:, None]
    parts = np.hstack((here, chance, level, np.square(level)))
    total = np.concatenate((np.zeros((1, parts.shape[1])), np.cumsum(parts, axis=0)))
    first, last = np.array(some).T
    inside = total[last] - total[first]
    outside = total[-1] - inside
    n, m = inside[:, :1], outside[:, :1]
    # Not where nearly all rests are too short for such a width.
    enough = (n >= 2) & (m >= FEWEST // 2)
    inside, outside = inside[:, 1:] / np.maximum(n, 1.0), outside[:, 1:] / np.maximum(m, 1.0)
    more = inside[:, 1:7] - outside[:, 1:7]
    scatter = (outside[:, 7:] - np.square(outside[:, 1:7])) * m / np.maximum(m - 1.0, 1.0)
    by_chance = inside[:, :1] / np.maximum(n, 1.0) + outside[:, :1] / np.maximum(m, 1.0)
    own = np.maximum(scatter - outside[:, :1], 0.0)
    error = own / np.maximum(n, 1.0) + own / np.maximum(m, 1.0) + by_chance
    spread = own + outside[:, :1]
    excess = np.maximum(own, 1e-5 * spread)
    share = np.divide(spread, excess, out=np.ones_like(spread), where=excess > 0)
    freedom = (m - 1.0) * np.square(share)
    stand = np.where(enough, more / np.sqrt(error), 0.0)
    tail = stdtr(np.maximum(freedom, 1.0), -stand)
    # The quieter half of normal errors has a mean of -0.8.
    some_rests = np.flatnonzero(here[:, 0])
    usual = float(chance[some_rests].mean())
    half = np.sort(level[some_rests], axis=0)[: max(len(some_rests) // 2, 1)]
    quiet = half.mean(axis=0) + np.sqrt(2.0 / np.pi * usual)
    stirred = (inside[:, 1:7] - quiet) / np.sqrt(by_chance + usual / np.maximum(m, 1.0))
    return stand, np.where(enough & (more > np.log(LOUDER)), tail, 1.0), enough * stirred


def _independent(width: int) -> float:
    """Return the share of independent ones among the differences of means of white noise."""
    half = max(1, width // 2)
    kernel = np.repeat([-0.5, 1.0, -0.5], width)
    lags = np.correlate(kernel, kernel, mode="full")[len(kernel) - 1 :: half]
    return float(1.0 / (1.0 + 2.0 * np.square(lags[1:] / lags[0]).sum()))
