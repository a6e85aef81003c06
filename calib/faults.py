"""Faults of recordings that show in the samples themselves: gaps, clipping, spikes, stuck channels.

No threshold is in the units of a sensor. Each test asks how probable what is seen would be for a
sensor that works, from the scatter, the resolution and the motion of the recording at hand.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, pdtrc

from calib.decimals import counts_at
from calib.errors import RecordingError
from calib.recording import CHANNELS, Recording
from calib.stillness import runs
from calib.types import BoolArray, FloatArray, IntArray

BLOCK = 64
"""Samples over which local scatter and chances are estimated."""
NEARBY = 16
"""Samples over which the scatter about a spike is estimated; turns begin and end within few."""
FASTEST = 150.0
"""rad/s, twice the largest full scale that MEMS gyroscopes have."""
LARGEST = np.array([1e4] * 3 + [FASTEST] * 3)
"""Of each channel: 1000 g, and what no gyroscope measures."""
WILD = 100.0
"""Times what is beside it, from which a value that no sensor measures is one on its own."""
FALSE_ALARM = 1e-6
"""Probability, for a whole recording, that chance alone makes a finding."""
SPIKE, ISOLATED, OTHERS = 9.0, 4.0, 4.0
"""A spike over the local scatter, over the ten samples around it; what other channels may show."""
BEYOND = 1.2
"""How far one axis of a triad goes beyond another that is at its limit, at most: each has its own
offset, and an analogue one its own range."""
HELD = 8
"""Equal samples that no machine makes at a level which is none of its sensor's."""
LONGEST_SPIKE = 3
"""Samples of a spike, at most: as many as are lost where a few bytes are."""
SPIKES_PART = 256 * NEARBY
"""Samples that are looked at for spikes at a time."""
TAIL, FEW, FALLS, RARELY = 4.5, 4, 5.0, 0.01
"""Local scatters from which on a sample is in the tail of its noise, of which normal noise has next
to none; samples in it from which on there is a tail; the power of their size that they fall with,
at least (Student's t with five degrees of freedom: heavier ones no sensor has); and how many of a
recording are so large by chance that none is a spike."""
STILL = 3.0
"""Times the noise at rest, by which what moves scatters more."""
SHARED = 0.15
"""Of a spike's size over the noise: a knock shows on other channels by more than this."""
SHAKEN = 50.0
"""Local scatter over that at rest, above which a spike and a knock cannot be told apart."""
OFTEN = 0.05
"""Share of turns in which a coarse channel stands still by itself."""
BETWEEN = 0.25
"""Noise in counts below which a channel may stay on one count for as long as nothing moves."""
MOVED = 10.0
"""Times the noise at rest, by which something changes that moves."""
COINCIDENCE = 0.75
"""How often one of two channels that turn alike is where the other one has just come to, at most.
At rest it is half of the time for counts of any size, and less of fine ones."""
ROUNDING = 1e-9
"""Of a channel's largest value: what computing leaves of no noise."""
ROBUST = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""


JUMP = 5.0
"""Times the steps that follow, by which what is no longer stuck jumps to where it is by then."""


UNITS = 1e9
"""Times `LARGEST`, beyond which no unit, however small, makes a value of what a sensor measures."""


class Gaps(NamedTuple):
    """Samples after which time is missing: index of the sample after each gap, and how many."""

    at: IntArray
    missing: IntArray
    declared: BoolArray


def find_gaps(recording: Recording) -> Gaps:
    """Return gaps in time and losses that the source counted itself.

    A gap is a step of more than 1.5 intervals that the scatter of the steps does not explain.
    """
    assert recording.lost is not None
    step = np.diff(recording.time, prepend=recording.time[0])
    interval = recording.interval
    if len(recording) < 3:
        return Gaps(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, bool))
    scatter = ROBUST * float(np.median(np.abs(step[1:] - interval)))
    wide = step > max(1.5 * interval, interval + 6 * scatter)
    missing = np.where(wide, np.rint(step / interval).astype(np.int64) - 1, 0)
    missing = np.maximum(missing, recording.lost)
    at = np.flatnonzero(missing)
    return Gaps(at, missing[at], recording.lost[at] > 0)


def jitter(recording: Recording) -> float:
    """Return the rms deviation of the steps in time from their median, s, gaps left out."""
    if len(recording) < 3:
        return 0.0
    step = np.delete(np.diff(recording.time, prepend=np.nan), [0, *find_gaps(recording).at])
    return float(np.sqrt(np.mean((step - recording.interval) ** 2))) if step.size else 0.0


def values_of(recording: Recording) -> FloatArray:
    """Return all six channels side by side, (n, 6)."""
    return np.hstack([recording.accel, recording.gyro])


def check_sizes(recording: Recording, name: str) -> None:
    """Refuse values that are no measurement in whatever unit; squares of them might overflow.

    Raises
    ------
    RecordingError
    """
    size = np.abs(values_of(recording)).max(axis=0, initial=0.0)
    channel = outsized(size, UNITS)
    if channel is not None:
        raise RecordingError(
            f"{CHANNELS[channel]} of {name} reaches {size_of(channel, size)}: check how it was "
            "written, and the unit of that column"
        )


def outsized(size: FloatArray, factor: float = 1.0) -> int | None:
    """Return the first of six channels that is `factor` times what any sensor measures."""
    beyond = np.flatnonzero(size > factor * LARGEST)
    return int(beyond[0]) if beyond.size else None


def size_of(channel: int, size: FloatArray) -> str:
    """Return how large an outsized channel is, beside what a sensor measures at most."""
    unit = ("m/s²", "rad/s")[channel // 3]
    return (
        f"{size[channel]:.3g} {unit}, where no sensor measures more than "
        f"{LARGEST[channel]:g} {unit}"
    )


def find_wild(values: FloatArray) -> BoolArray:
    """Return which values (n, 6) no sensor measures, alone among others that one could, (n, 6).

    Values in another unit are as large, but so are those beside them. What is wrong by that much
    came about on the way: a bit that was flipped, or a byte that was lost.
    """
    size = np.abs(values)
    beyond = size > LARGEST
    if not beyond.any():
        return np.asarray(beyond)
    padded = np.pad(size, ((2, 2), (0, 0)), mode="reflect") if len(size) > 2 else size
    around = [padded[k : k + len(size)] for k in (0, 1, 3, 4)] if len(size) > 2 else [size]
    return np.asarray(beyond & (size > WILD * np.median(around, axis=0)))


STEEP = 10.0
"""How far a signal falls on both sides of where it was at its limit, in noise."""

LEVEL = 3.0
"""How far a parabola may fall, in noise, over n samples that noise leaves equal. On both sides of
them it is ``2 LEVEL ((n + 1) / (n - 1))²`` lower."""


BOTH_WAYS = 0.8
"""What a range has one way at least, relative to the other: a calibration has moved its ends, by
far less. Without noise, what turns one way only is at rest where it turns the least."""


def find_clipping(
    channel: FloatArray, *, full_scale: float | None, lsb: float | None, noise: float
) -> IntArray:
    """Return the samples of one channel at which the sensor, or its logger, was at its limit.

    With a known full scale: what reaches it. Otherwise a plateau: the extreme value of the
    recording, held for longer than chance explains; or held for three samples and left by a step
    that no smooth peak makes, `STEEP` times the noise or the resolution, and more than a parabola
    falls that noise leaves level for so long; or met in two peaks, each of which would be higher by
    as much, going by what is beside it. A machine turns by like peaks time and again.
    """
    if full_scale is not None:
        limit = 0.9995 * full_scale
        if lsb is not None and abs(full_scale / (32768 * lsb) - 1) < 0.01:
            limit = min(full_scale, 32767 * lsb) - 0.5 * lsb
        at = np.flatnonzero(np.abs(channel) >= limit)
        if at.size:
            return at
    most = float(np.abs(channel).max())
    found = [
        _plateaus(sign * channel, max(noise, lsb or 0.0))
        for sign in (1.0, -1.0)
        if (sign * channel).max() >= BOTH_WAYS * most
    ]
    return np.sort(np.concatenate(found))


def find_limits(
    triad: FloatArray, *, full_scale: float | None, lsb: float | None, noise: FloatArray
) -> list[IntArray]:
    """Return the samples of each channel of a triad at which it was at its limit.

    As `find_clipping` does. But the range of a triad is one: where another axis went well beyond
    it, the level at which one stayed for some samples is none. A machine turns at the same rate
    time and again.

    Parameters
    ----------
    triad : (n, 3) array
    noise : (3,) array
    """
    found = [
        find_clipping(own, full_scale=full_scale, lsb=lsb, noise=float(level))
        for own, level in zip(triad.T, noise, strict=True)
    ]
    most = np.abs(triad).max(axis=0, initial=0.0)
    if full_scale is not None or not most.any():
        return found
    return [
        at if BEYOND * m >= most.max() or _longest_run(at, len(triad)) > HELD else at[:0]
        for at, m in zip(found, most, strict=True)
    ]


def _longest_run(at: IntArray, number: int) -> int:
    """Return how many of the indices, of so many samples, follow one another at most."""
    held = np.zeros(number, bool)
    held[at] = True
    start, stop = runs(held)
    return int((stop - start).max(initial=0))


def limits_of(recording: Recording, noise: FloatArray) -> list[IntArray]:
    """Return the samples of each channel at which it was at its limit, for (6,) ``noise``."""
    device = recording.device
    accel = find_limits(
        recording.accel,
        full_scale=device.accel_full_scale,
        lsb=device.accel_lsb,
        noise=noise[:3],
    )
    gyro = find_limits(
        recording.gyro, full_scale=device.gyro_full_scale, lsb=device.gyro_lsb, noise=noise[3:]
    )
    return accel + gyro


def _plateaus(channel: FloatArray, scale: float) -> IntArray:
    top = channel == channel.max()
    start, stop = runs(top)
    inside = (start > 0) & (stop < len(channel))
    start, stop = start[inside], stop[inside]
    share, blocks = _equal_share(channel), np.unique(np.flatnonzero(top) // BLOCK)
    share = np.delete(share, blocks[blocks < len(share)])
    if len(start) == 1 and _released(channel, int(stop[0]), scale):
        return np.zeros(0, np.int64)
    if share.size and (stop - start).max(initial=0) > _longest(share, len(channel)):
        return np.flatnonzero(top)
    drop = 2 * channel.max() - channel[start - 1] - channel[np.minimum(stop, len(channel) - 1)]
    length = stop - start
    cut = _missing(channel, start, stop) > STEEP * scale
    alone = (length >= 3) & (drop > _least_drop(length, scale))
    if not (alone.any() or (cut.sum() >= 2 and length[cut].sum() >= 4)):
        return np.zeros(0, np.int64)
    if _flat_peaks_below(channel, scale) > max(alone.sum(), cut.sum()):
        return np.zeros(0, np.int64)
    return np.flatnonzero(top)


def _least_drop(length: IntArray, scale: float) -> FloatArray:
    """Return how far, on both sides together, what is level by no chance falls from a plateau."""
    smooth = 2.0 * LEVEL * np.square((length + 1) / np.maximum(length - 1, 1))
    return np.asarray(np.maximum(STEEP, smooth) * scale)


def _flat_peaks_below(channel: FloatArray, scale: float) -> int:
    """Return the number of peaks below the extreme value that are as flat as if clipped there.

    A median filter makes every peak flat, and a limit only those that reach it.
    """
    start, stop = runs(channel[1:] == channel[:-1])
    inside = (start > 0) & (stop < len(channel) - 1)
    start, stop = start[inside], stop[inside] + 1
    level, before, after = channel[start], channel[start - 1], channel[stop]
    length = stop - start
    flat = (length >= 3) & (2 * level - before - after > _least_drop(length, scale))
    below = level < channel.max() - STEEP * scale
    return int((flat & below & (before < level) & (after < level)).sum())


def _missing(channel: FloatArray, start: IntArray, stop: IntArray) -> FloatArray:
    """Return how much higher parabolas through two samples on either side are than plateaus.

    On average over each, which is over samples ``[start, stop)``.
    """
    last, length = len(channel) - 1, stop - start
    near, far = 0.5 * (length + 1), 0.5 * (length + 3)
    by, off = (
        0.5 * (channel[np.maximum(start - k, 0)] + channel[np.minimum(stop - 1 + k, last)])
        for k in (1, 2)
    )
    bend = (off - by) / (np.square(far) - np.square(near))
    return np.asarray(by + bend * ((np.square(length) - 1) / 12 - np.square(near)) - channel[start])


def _released(channel: FloatArray, stop: int, scale: float) -> bool:
    """Return whether a channel jumps from a plateau that ends before `stop`: it was stuck there.

    What is clipped comes back through its limit, no faster than it goes on.
    """
    steps = np.abs(np.diff(channel[stop - 1 : stop + 4]))
    return bool(len(steps) > 2 and steps[0] > JUMP * steps[1:].max() + 10.0 * scale)


def find_stuck(
    values: FloatArray, moving: BoolArray, *, interval: float, clipped: BoolArray
) -> list[tuple[int, int, int]]:
    """Return stretches ``(channel, start, stop)`` in which a channel must change and does not.

    A stretch counts if chance does not make it that long, and the sensor moves in it for 0.2 s; or
    if the channel is noisy at every other time. A coarse channel, or one without noise, is constant
    at rest and in turns about other axes too: of that, only standing still through turns counts in
    which it does not do so otherwise.
    """
    n = len(values)
    out = []
    step, noise = resolution(values), noise_at_rest(values)
    turns = _turning(values, np.stack(runs(moving), axis=1), 2 * step + MOVED * noise)
    counts, held = noise_in_counts(values, moving, step), counts_at(values, step)
    rests = block_sums(moving[1:, None])[:, 0] == 0
    for c in range(values.shape[1]):
        equal = values[1:, c] == values[:-1, c]
        share = _equal_share(values[:, c])
        constant = share == 1.0
        if constant.all():
            if n >= BLOCK:
                out.append((c, 0, n))
            continue
        # Of a log that moves nearly throughout, rests have the longest runs.
        longest = max(
            _longest(share[own], n) for own in (~constant, ~constant & rests) if own.any()
        )
        longest = max(longest, 8)
        start, stop = runs(equal)
        long = stop + 1 - start >= longest
        start, stop = start[long], stop[long] + 1
        # In counts that hold where the run is.
        level = counts[c] * step[c] / np.where(step[c] > 0, held[start, c], 1.0)
        # In the middle of a count neighbours are equal unless either reaches another one. The
        # noise may be less by a third: at the edge of a count it seems that much larger.
        stays = 1.0 - 2.0 * ndtr(-0.75 / np.clip(level, BETWEEN, 1.0))
        some = (level >= BETWEEN) & (level < 1.0)
        long = ~some | (stop - start >= np.log(FALSE_ALARM / n) / np.log(np.square(stays)))
        start, stop, level = start[long], stop[long], level[long]
        coarse = _mostly_constant(constant, moving) | (level < BETWEEN)
        around = _around(turns, start, stop)
        for k, (begin, end) in enumerate(zip(start.tolist(), stop.tolist(), strict=True)):
            if clipped[begin:end, c].all():
                continue
            elsewhere = np.delete(constant, np.s_[begin // BLOCK : -(-end // BLOCK)])
            moved = moving[begin:end].sum() * interval >= 0.2
            if coarse[k]:
                others = ((around >= 0) & (around != k)).sum()
                moved = (around == k).any() and others < OFTEN * len(turns)
            noisy = level[k] >= BETWEEN and elsewhere.size > 4 and elsewhere.mean() < 0.02
            if moved or noisy:
                out.append((c, begin, end))
    return out


def find_copies(values: FloatArray) -> list[tuple[int, int, BoolArray]]:
    """Return channels ``(c, d, where)`` of which one repeats the other: a register read twice.

    Of two that have noise of their own the chance that both go to one value, or to opposite ones,
    is at most `COINCIDENCE` where that changes; so a run counts that holds as many changes as make
    a false alarm rare. Without noise, or with less than a count shows, axes of a table may well
    turn alike.
    """
    n, moved = len(values), np.diff(values, axis=0, prepend=values[:1]) != 0
    noisy = noise_at_rest(values) > np.maximum(
        BETWEEN * resolution(values), ROUNDING * np.abs(values).max(axis=0)
    )
    least = np.log(FALSE_ALARM / max(n, 1)) / np.log(COINCIDENCE)
    out = []
    for c, d in combinations(np.flatnonzero(noisy).tolist(), 2):
        told = np.append(0, np.cumsum(moved[:, c]))
        for sign in (1.0, -1.0):
            start, stop = runs(values[:, c] == sign * values[:, d])
            long = told[stop] - told[start] >= least
            if long.any():
                where = np.zeros(n, bool)
                for begin, end in zip(start[long].tolist(), stop[long].tolist(), strict=True):
                    where[begin:end] = True
                out.append((c, d, where))
    return out


def noise_in_counts(values: FloatArray, moving: BoolArray, step: FloatArray) -> FloatArray:
    """Return the noise at rest of each channel in counts of `step`, (6,); infinite without rest.

    From the mean size of changes, which rounding leaves as it is on average over where between two
    counts a signal is; their square it does not. An axis that is at the edge of a count in all
    rests changes more often than that, so that the quietest axis speaks for its triad. Blocks that
    are shaken, beyond what rounding may do to one, do not count.
    """
    still = ~(moving[1:] | moving[:-1])
    if not still.any():
        return np.full(6, np.inf)
    change = np.abs(np.diff(values, axis=0))[still]
    size = min(BLOCK, len(change))
    blocks = change[: len(change) // size * size].reshape(-1, size, change.shape[1]).mean(axis=1)
    shaken = blocks > np.maximum(4.0 * np.median(blocks, axis=0), step)
    change = np.where(shaken, 0.0, blocks).sum(axis=0) / np.maximum((~shaken).sum(axis=0), 1)
    counts = 0.5 * np.sqrt(np.pi) * change / np.where(step > 0, step, np.inf)
    counts = np.where(change > 0, counts, np.inf).reshape(2, 3)
    return np.asarray(np.repeat(counts.min(axis=1), 3))


def _turning(values: FloatArray, turns: IntArray, least: FloatArray) -> IntArray:
    """Return the (k, 2) stretches in which some channel changes by more than `least` (c,)."""
    change = [np.ptp(values[a:b], axis=0) for a, b in turns.tolist()]
    return turns[[bool((own > least).any()) for own in change]] if len(turns) else turns


def _mostly_constant(constant: BoolArray, moving: BoolArray) -> bool:
    """Return whether a channel is constant in most blocks at rest, of which `constant` says so."""
    at_rest = block_sums(moving[1:, None])[: len(constant), 0] == 0
    return bool(at_rest.sum() > 4 and constant[at_rest].mean() > 0.5)


def _around(turns: IntArray, start: IntArray, stop: IntArray) -> IntArray:
    """Return which stretch each of the (k, 2) turns lies in, from rest to rest; -1 for none."""
    if not len(start):
        return np.full(len(turns), -1)
    which = np.searchsorted(start, turns[:, 0], side="left") - 1
    return np.where((which >= 0) & (turns[:, 1] < stop[which]), which, -1)


def find_spikes(values: FloatArray, *, lsb: FloatArray) -> list[tuple[int, int, int]]:
    """Return ``(start, stop, channel)`` of samples that leave a channel's course and come back.

    A spike is `LONGEST_SPIKE` samples long at most. It stands out of the local scatter and out of
    everything within ten samples, on one channel only: a knock shows on several, and rings. Where
    the sensor is shaken nothing is said.
    """
    if len(values) < 2 * BLOCK:
        return []
    held = np.ascontiguousarray(counts_at(values, lsb).T)
    noise = noise_at_rest(values)
    floor = np.maximum(noise, lsb)[:, None]
    # What moves is off by more than noise, which short rests of few samples show in few.
    unit = np.maximum(np.minimum(_quietest(values, NEARBY), noise), lsb)
    unit = np.where(unit > 0, unit, np.inf)
    # Channel by channel samples lie side by side, and parts of them stay in a processor's cache.
    rows = np.ascontiguousarray(values.T)
    found: list[tuple[int, int, int]] = []
    ratios: list[float] = []
    tail = np.zeros(len(rows))
    for begin in range(0, len(values), SPIKES_PART):
        first = max(begin - 2 * NEARBY, 0)
        here = slice(first, begin + SPIKES_PART + 2 * NEARBY)
        part, count = rows[:, here], held[:, here]
        for length in range(1, LONGEST_SPIKE + 1):
            some, beyond = _spikes(part, length, floor, count, unit)
            for start, stop, c, ratio in some:
                if begin <= first + start < begin + SPIKES_PART:
                    found.append((first + start, first + stop, c))
                    ratios.append(ratio)
            tail += beyond if length == 1 else 0.0
    # Where noise has tails, its largest samples are none; but for more than tails have beyond.
    least = TAIL * np.power(np.maximum(tail / RARELY, 1.0), 1.0 / FALLS) * (tail >= FEW)
    number = np.bincount([c for _, _, c in found], minlength=len(rows))
    falls = (TAIL / SPIKE) ** FALLS
    many = pdtrc(number - 1, tail * falls / (1.0 - falls)) < FALSE_ALARM
    least[many & (number > 0)] = 0.0
    return sorted(f for f, ratio in zip(found, ratios, strict=True) if ratio > least[f[2]])


def _spikes(
    values: FloatArray, length: int, floor: FloatArray, count: FloatArray, unit: FloatArray
) -> tuple[list[tuple[int, int, int, float]], FloatArray]:
    """Return the spikes of so many samples of (6, n) values, with such counts and `floor` (6, 1).

    The last of each is its ratio to the local scatter. In units of `unit` (6,), other channels show
    none of one. Beside them is how many samples of each channel are in the tail of its noise, (6,).
    """
    n = values.shape[1]
    number = n - length - 3
    sides = (2, 1, -length, -length - 1)
    before, also, after, then = (values[:, 2 - s : 2 - s + number] for s in sides)
    low = np.minimum(np.minimum(before, also), np.minimum(after, then))
    high = np.maximum(np.maximum(before, also), np.maximum(after, then))
    middle = 0.5 * (before + also + after + then - low - high)
    off = [values[:, 2 + j : 2 + j + number] - middle for j in range(length)]
    rest = most = np.abs(off[0])
    for other in off[1:]:
        size = np.abs(other)
        rest = np.where(off[0] * other > 0, np.minimum(rest, size), 0.0)
        most = np.maximum(most, size)
    rest, most = (np.pad(x, ((0, 0), (2, length + 1))) for x in (rest, most))
    scale = np.maximum(ROBUST * level_nearby(most), count)
    ratio = rest / np.where(scale > 0, scale, np.inf)
    still = scale < STILL * floor
    tail = ((ratio > TAIL) & (ratio <= SPIKE) & still).sum(axis=1).astype(np.float64)
    # Of a longer one, what begins beside it stands out as well.
    own = 0 if length == 1 else length + 1
    found = []
    for c, k in np.argwhere((ratio > SPIKE) & (scale < SHAKEN * floor)).tolist():
        first, last = max(0, k - 10), k + 10 + length
        near = np.delete(rest[c, first:last], np.s_[max(k - own - first, 0) : k + own + 1 - first])
        leaves = values[c, k] - values[c, k - 1]
        returns = values[c, k + length - 1] - values[c, k + length]
        others = np.delete(np.arange(len(values)), c)
        alone = (ratio[others, max(0, k - 1) : k + 2] < OTHERS).all()
        # Of the others all of it counts: what moves is not off its course to one side.
        fine = np.maximum(unit, count[:, k])
        alone &= (most[:, k] / fine)[others].max() < max(OTHERS, SHARED * rest[c, k] / fine[c])
        back = leaves * returns > 0 and min(abs(leaves), abs(returns)) > 0.5 * rest[c, k]
        # What moves has begun to a sample earlier, and has not ended yet a sample later.
        begins = values[c, k - 1] - values[c, k - 2]
        ends = values[c, k + length] - values[c, k + length + 1]
        back &= ISOLATED * max(abs(begins), abs(ends)) < max(abs(leaves), abs(returns))
        if alone and back and rest[c, k] > ISOLATED * near.max(initial=0.0):
            found.append((k, k + length, c, float(ratio[c, k])))
    return found, tail


def level_nearby(sizes: FloatArray) -> FloatArray:
    """Return the median of (k, n) sizes over `NEARBY` samples, where it is largest beside each.

    It is 0 of fewer.
    """
    n = sizes.shape[1]
    count = n // NEARBY
    if not count:
        return np.zeros_like(sizes)
    parts = np.sort(sizes[:, : count * NEARBY].reshape(-1, count, NEARBY))
    level = 0.5 * (parts[:, :, NEARBY // 2 - 1] + parts[:, :, NEARBY // 2])
    padded = np.pad(level, ((0, 0), (1, 1)), mode="edge")
    level = np.maximum(np.maximum(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
    return np.pad(np.repeat(level, NEARBY, axis=1), ((0, 0), (0, n - count * NEARBY)), "edge")


def resolution(values: FloatArray, *, sample: int = 100_000) -> FloatArray:
    """Return the smallest change of each channel, (k,): about its LSB; 0 if it is constant."""
    change = np.abs(np.diff(values[:sample], axis=0))
    change[change == 0] = np.inf
    least = change.min(axis=0, initial=np.inf)
    return np.where(np.isfinite(least), least, 0.0)


def noise_at_rest(values: FloatArray) -> FloatArray:
    """Return the scatter of each channel in the quietest tenth of the recording, (k,)."""
    return _quietest(values, BLOCK)


def _quietest(values: FloatArray, block: int) -> FloatArray:
    """Return the scatter of each channel, (k,), within which a tenth of the blocks are."""
    count = len(values) // block
    if not count:
        return np.asarray(values.std(axis=0), np.float64)
    scatter = values[: count * block].reshape(count, block, -1).std(axis=1)
    return np.asarray(np.quantile(scatter, 0.1, axis=0), np.float64)


def _equal_share(channel: FloatArray) -> FloatArray:
    """Return the share of samples equal to the one before, for each block."""
    equal = (channel[1:] == channel[:-1])[:, None]
    return (block_sums(equal) / block_sums(np.ones((len(equal), 1))))[:, 0]


def _longest(share: FloatArray, n: int) -> float:
    """Return the longest run of equal values that chance makes among `n` samples."""
    chance = float(np.clip(np.quantile(share, 0.9), 0.01, 0.999))
    return float(np.log(FALSE_ALARM / n) / np.log(chance))


def block_sums(flags: BoolArray | FloatArray) -> FloatArray:
    """Return the sums of (n, k) flags over each `BLOCK` of samples."""
    edges = np.arange(0, len(flags), BLOCK)
    return np.asarray(np.add.reduceat(flags, edges, axis=0, dtype=np.float64), np.float64)
