"""Lines, bursts and noise that changes, in the samples at rest.

A disturbance faster than the means of the rows leaves no residual there. It shows as power: at one
frequency above its neighbours (a line), or in some rests above the others (a burst).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc, stdtr

from calib.faults import noise_in_counts, resolution, values_of
from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.hypotheses.places import SEEN, joined
from calib.mismatch.hypotheses.windows import windows
from calib.mismatch.rows.underway import GAP
from calib.mismatch.samples.hand import HAND, held_in_hand, skirted, trembling
from calib.mismatch.samples.knocks import knocked
from calib.mismatch.samples.power import CLAIM, LENGTH, LOUDER, NEIGHBOURS, above, frequencies
from calib.poses import Poses
from calib.read_once import HELD
from calib.recording import AXES, CHANNELS, TRIADS, Recording
from calib.types import BoolArray, FloatArray, IntArray

HIDDEN = 0.5
"""Noise in counts below which its power depends on where between two of them a signal is."""

SPREAD = 3
"""Bins on either side that a line whose pace is not quite steady has power in."""

SETTLED = 0.75
"""s after which what lies on foam, or was let go, rings no more."""

_HERE = 0.01
"""P-value below which one rest has what is known to be in the recording, a line or a burst."""

LINE = "a line at "
"""What a line follows, before its frequency."""

LOUDER_THERE = "the time: noise is louder there"
"""What a burst follows."""

_SPREAD = 1.94
"""Frequencies for one that is independent: sum of the squared correlations of a Hann window's."""

_STEADY = 2.0
"""Noise power whose trend over the recording stays below this factor counts as steady."""

SHARE = 0.25
"""A burst, or spikes anywhere, are reported if they hold this share of the channel's usual noise
power: sensors and benches have many small ones, which matter to nobody."""

FAINTEST = 0.03
"""The same of a line in all rests, or in those of its window: an amplitude of a quarter of a
sample's noise."""

FEWEST = 3
"""Rests in a row that a line in a window has, at least: one shows it only with a `SHARE`."""


def look_at_spectrum(recording: Recording, poses: Poses) -> tuple[Unexplained, ...]:
    """Return lines and bursts of the six channels at rest."""
    start, pose, number = _places(recording, poses)
    if number < 8:
        return ()
    out: list[Unexplained] = []
    window = np.hanning(LENGTH)[:, None, None]
    index = start + np.arange(LENGTH)[:, None]
    values = np.concatenate((recording.accel[index], recording.gyro[index]), axis=2)
    at = np.arange(LENGTH) - (LENGTH - 1) / 2
    values = values - values.mean(axis=0)
    slope = np.einsum("n,nkc->kc", at, values) / float(at @ at)
    values -= at[:, None, None] * slope
    power = np.square(np.abs(np.fft.rfft(window * values, axis=0)))[2:-1]
    power += _between_counts(recording, poses) * float(np.square(window).sum())
    gravity = float(np.linalg.norm(poses.accel, axis=1).mean())
    held = trembling(power[:, :number], recording.interval, gravity)
    for c, channel in enumerate(CHANNELS):
        own = power[:, :number, c]
        # Along cubics between samples of its own a signal has no floor.
        followed = TRIADS[channel.split(".")[0]] in recording.notes.get(HELD, "")
        if followed or not np.median(own) > 0:
            continue
        # Where rounding leaves a channel constant there is no floor to compare with.
        noisy = np.asarray(power[:, :, c].all(axis=0))
        own, rest = own[:, noisy[:number]], pose[:number][noisy[:number]]
        line, spread = _lines(recording, poses, own, rest, channel, held)
        if not line:
            line, spread = _passing(recording, poses, power[:, noisy], pose[noisy], c, held)
        narrow = not line and not held.any()
        kept = np.delete(np.arange(len(own)), spread)
        bursts = _bursts(poses, own[kept], rest, channel, narrow=narrow)
        if bursts and held_in_hand(bursts, recording, poses):
            # A few rests may be held in a hand, the others on a table.
            faster = frequencies(len(own), recording.interval)[kept] > HAND[1]
            bursts = _bursts(poses, own[kept[faster]], rest, channel, narrow=False)
        if not 0 < len(bursts) <= 2:
            # Rests that are louder time and again, as something has it, are no bursts.
            bursts = _changes(recording, poses, own, rest, channel) or bursts
        out += line + bursts
    return tuple(_merged(out))


def _places(recording: Recording, poses: Poses) -> tuple[IntArray, IntArray, int]:
    """Return where periodograms begin, and in which rests, and how many of them are side by side.

    After these come such as are halfway between two. Those overlap with both, but with a Hann
    window they hardly correlate [1]_: brief rests tell twice as much of a line by them.

    References
    ----------
    .. [1] Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE
       Trans. Audio Electroacoust. 15, 1967, p. 71.
    """
    settled = round(SETTLED / recording.interval) if recording.interval > 0 else 0
    starts = [
        _starts(a, b, settled)
        for a, b in zip(poses.start.tolist(), poses.stop.tolist(), strict=True)
    ]
    pose = np.repeat(np.arange(len(poses)), [len(s) for s in starts])
    if not len(pose):
        return pose, pose, 0
    start = np.concatenate(starts)
    count = np.append(0, np.cumsum(knocked(recording, poses)))
    torn = np.zeros(len(recording), np.int64)
    if recording.interval > 0 and recording.clock != "invalid":
        torn[1:] = np.cumsum(np.diff(recording.time) > GAP * recording.interval)

    def still(at: IntArray) -> BoolArray:
        own = (count[at + LENGTH] == count[at]) & (torn[at + LENGTH - 1] == torn[at])
        return np.asarray(own)

    whole = still(start)
    start, pose = start[whole], pose[whole]
    # Enough for any line; a day at rest is not read whole.
    if len(start) > 2000:
        keep = np.linspace(0, len(start) - 1, 2000).astype(np.int64)
        start, pose = start[keep], pose[keep]
    among = np.flatnonzero(start - LENGTH // 2 >= poses.start[pose] + settled)
    among = among[still(start[among] - LENGTH // 2)]
    between = start[among] - LENGTH // 2
    return np.append(start, between), np.append(pose, pose[among]), len(start)


def _starts(start: int, stop: int, settled: int) -> IntArray:
    """Return where periodograms of a rest, samples ``[start, stop)``, begin: the last at its end.

    Those in which a sensor may not have settled yet are left out where most are not.
    """
    every = np.arange(stop - LENGTH, start - 1, -LENGTH)[::-1]
    later = every[every >= start + settled]
    return later if 2 * len(later) >= len(every) else every


def coarse_at_rest(recording: Recording, poses: Poses) -> tuple[BoolArray, FloatArray]:
    """Return on which channels noise at rest is less than half a count, and counts, (6,) each."""
    values = values_of(recording)
    moving = np.ones(len(recording), bool)
    for a, b in zip(poses.start, poses.stop, strict=True):
        moving[a:b] = False
    step = resolution(values)
    return noise_in_counts(values, moving, step) < HIDDEN, step


def _between_counts(recording: Recording, poses: Poses) -> FloatArray:
    """Return the variance (6,) that noise has at most if it is less than half a count.

    By where a signal is, it jumps between two counts all the time or stays on one: no louder noise.
    """
    coarse, step = coarse_at_rest(recording, poses)
    return np.where(coarse, np.square(step) / 4, 0.0)


def _merged(found: list[Unexplained]) -> list[Unexplained]:
    """Return one entry for all channels of one kind, or in one place."""
    out = joined([item for item in found if item.follows.endswith(SEEN)])
    kinds: dict[str, list[Unexplained]] = {}
    for item in found:
        if not item.follows.endswith(SEEN):
            kinds.setdefault(item.follows.split(" at ")[0], []).append(item)
    for items in kinds.values():
        best = min(items, key=lambda item: item.p_value)
        start = min(item.intervals[0][0] for item in items)
        stop = max(item.intervals[0][1] for item in items)
        channels = tuple(c for c in CHANNELS if any(c in item.channels for item in items))
        follows = sorted({item.follows for item in items})
        out.append(Unexplained(channels, ((start, stop),), ", ".join(follows), best.p_value))
    return out


def _lines(
    recording: Recording,
    poses: Poses,
    power: FloatArray,
    pose: IntArray,
    channel: str,
    held: BoolArray,
) -> tuple[list[Unexplained], IntArray]:
    """A line, and the frequencies that it spreads over, where its power is that of no burst.

    That is mean power over all rests, compared with that of its neighbours in frequency. It reaches
    from the first to the last rest that has it by itself. What is ``held`` trembles, and so does
    what only falls on from there: no resonance ends where hands do.
    """
    bins = len(power)
    mean, floor, p = above(power)
    held = skirted(held, mean)
    # By its height: of lines that stand far above, all p-values are zero.
    k = int(np.argmax(np.where(held, 0.0, mean / floor)))
    # A Hann window spreads a line over three frequencies.
    near = slice(max(k - 1, 0), k + 2)
    if held[k] or p[k] >= CLAIM or (mean - floor)[near].sum() < FAINTEST * floor.sum():
        return [], np.zeros(0, np.int64)
    frequency = (_peak(np.maximum(mean - floor, 0.0), k) + 2) / (LENGTH * recording.interval)
    found, of = np.unique(pose, return_inverse=True)
    # Beside the frequencies that the line spreads over, each rest shows its own floor.
    beside = np.r_[max(k - NEIGHBOURS, 0) : max(k - 2, 0), k + 3 : min(k + NEIGHBOURS + 1, bins)]
    count = np.bincount(of)
    own = np.bincount(of, power[k]) / count
    quiet = np.median([power[beside][:, of == i].mean(axis=1) for i in range(len(found))], axis=1)
    here = found[chdtrc(2.0 * count, 2.0 * count * own / quiet) * len(found) < _HERE]
    where = (float(recording.time[0]), float(recording.time[-1]))
    # In most of them: throughout.
    if 0 < len(here) < 0.8 * len(found):
        where = (float(poses.interval[here[0], 0]), float(poses.interval[here[-1], 1]))
    line = Unexplained((channel,), (where,), f"{LINE}{frequency:.3g} Hz", float(p[k]))
    return [line], _spread(k, bins)


def _spread(k: int, bins: int) -> IntArray:
    """Return what a line spreads over by itself, and by whatever its pace is unsteady."""
    return np.arange(max(k - SPREAD, 0), min(k + SPREAD + 1, bins))


def _passing(
    recording: Recording,
    poses: Poses,
    power: FloatArray,
    pose: IntArray,
    c: int,
    held: BoolArray,
) -> tuple[list[Unexplained], IntArray]:
    """A line of channel `c` that is there in a window only, as `_lines` returns one of all rests.

    The mean over all rests holds little of it. In those of its window it stands above its
    neighbours in frequency, and above what all rests usually have there, also without the one that
    has the most: that may have been knocked at. ``power`` is that of all channels (bins, n, 6), of
    all `_places`.
    """
    own, bins = power[:, :, c], len(power)
    found, of, count = np.unique(pose, return_inverse=True, return_counts=True)
    some = [w for w in windows(len(found)) if w[1] - w[0] >= FEWEST]
    if not some:
        return [], np.zeros(0, np.int64)
    mean = np.stack([own[:, of == i].mean(axis=1) for i in range(len(found))], axis=1)
    usual, _ = _peaks(mean, count)
    parts = np.stack((np.tile(count, (bins, 1)), count * mean, count * usual))
    total = np.concatenate((np.zeros((3, bins, 1)), np.cumsum(parts, axis=2)), axis=2)
    first, last = np.array(some).T
    number, has, expected = total[:, :, last] - total[:, :, first]
    # The best window of each frequency, and what stands out most first.
    gain = _likelier(number, has / expected)
    best = np.arange(bins), gain.argmax(axis=1)
    looks = len(some) * bins * len(CHANNELS)
    n = 2.0 * number[best]
    chance = chdtrc(n, n * has[best] / expected[best]) * looks
    seen = np.flatnonzero((chance < CLAIM) & ~skirted(held, own.mean(axis=1)))
    for k in seen[np.argsort(-gain[best][seen])].tolist():
        there = np.arange(first[best[1][k]], last[best[1][k]])
        there = np.delete(there, int(np.argmax((mean / usual)[k, there])))
        here = np.isin(of, there)
        level, floor, p = above(own[:, here])
        expect = np.average(usual[:, there], axis=1, weights=count[there])
        freedom = 2.0 * count[there].sum()
        by_chance = float(chdtrc(freedom, freedom * level[k] / expect[k])) * looks
        p_value = max(float(p[k]) * len(some), by_chance)
        excess = np.maximum(level - np.maximum(floor, expect), 0.0)
        near = slice(max(k - 1, 0), k + 2)
        if p_value >= CLAIM or excess[near].sum() < FAINTEST * floor.sum():
            continue
        gravity = float(np.linalg.norm(poses.accel, axis=1).mean())
        if skirted(trembling(power[:, here], recording.interval, gravity), level)[k]:
            continue
        frequency = (_peak(excess, k) + 2) / (LENGTH * recording.interval)
        a, b = _loudest(mean[k] / usual[k], count, float(level[k] / expect[k]))
        where = (float(poses.interval[found[a], 0]), float(poses.interval[found[b - 1], 1]))
        line = Unexplained((CHANNELS[c],), (where,), f"{LINE}{frequency:.3g} Hz", p_value)
        return [line], _spread(k, bins)
    return [], np.zeros(0, np.int64)


def _likelier(number: FloatArray, ratio: FloatArray) -> FloatArray:
    """Return by how much means of so many exponentials are likelier if they are louder, in logs."""
    more = np.maximum(ratio, 1.0)
    return number * (more - 1.0 - np.log(more))


def _loudest(ratio: FloatArray, count: IntArray, louder: float) -> tuple[int, int]:
    """Return the rests ``[a, b)`` that are so much louder, most likely, the others being usual."""
    gain = np.append(0.0, np.cumsum(count * (ratio * (1.0 - 1.0 / louder) - np.log(louder))))
    b = int(np.argmax(gain - np.minimum.accumulate(gain)))
    return int(np.argmin(gain[: b + 1])), b


def lines_of(item: Unexplained) -> dict[str, float]:
    """Return the lines that an item is made of, in words and in Hz."""
    words = [part for part in item.follows.split(", ") if part.startswith(LINE)]
    return {part: float(part[len(LINE) :].split()[0]) for part in words}


def _peak(power: FloatArray, k: int) -> float:
    """Return where a line is, in bins, of which bin `k` has the most of the power.

    A Hann window has ``(1 + x) / (2 - x)`` times as large an amplitude at the bin x below a line
    as one beyond it [1]_. At the last bin the one beyond is missing, and that before tells it.

    References
    ----------
    .. [1] Grandke, "Interpolation algorithms for discrete Fourier transforms of weighted signals",
       IEEE Trans. Instrum. Meas. 32, 1983, p. 350.
    """
    beside = [i for i in (k - 1, k + 1) if 0 <= i < len(power)]
    other = max(beside, key=lambda i: power[i])
    ratio = float(np.sqrt(power[k] / max(power[other], 1e-12 * power[k])))
    apart = min((2.0 * ratio - 1.0) / (1.0 + ratio), 1.5)
    return other + apart * (k - other)


def _bursts(
    poses: Poses,
    power: FloatArray,
    pose: IntArray,
    channel: str,
    *,
    narrow: bool,
) -> list[Unexplained]:
    """A burst: some rests have more power than others, in all or (`narrow`) at one frequency."""
    found = np.unique(pose)
    if len(found) < 6:
        return []
    count = np.bincount(pose, minlength=len(poses))[found]
    mean = np.stack([power[:, pose == k].mean(axis=1) for k in found], axis=1)
    floor, each = _peaks(mean, count)
    ratio = mean / floor
    total = np.median(floor, axis=0) * ratio.mean(axis=0)
    total /= np.median(total)
    # Real rests differ in noise; their own scatter sets the degrees of freedom.
    scatter = 1.4826 * float(np.median(np.abs(np.log(total))))
    most = min(2.0 * len(power) * float(np.median(count)), 2.0 / max(scatter**2, 1e-9))
    p_one = fdtrc(most, most, total)
    p_all = p_one * len(found) * len(CHANNELS)
    loud = (p_all < CLAIM) & (total > LOUDER)
    extra = np.where(each < CLAIM, mean - floor, 0.0).sum(axis=0) / np.median(floor.sum(axis=0))
    thin = (each.min(axis=0) < CLAIM) & (extra > SHARE) & narrow
    # Beside a rest that surely has it, others need less: at the same frequencies, if it has one.
    own = np.unique(each[:, thin & ~loud].argmin(axis=0))
    near = np.unique(np.clip(own[:, None] + [-1, 0, 1], 0, len(power) - 1))
    looks = mean.size * len(CHANNELS)
    p_near = each[near].min(axis=0, initial=looks) * len(near) / looks
    out = []
    for which, follows, p, alone in (
        (loud, LOUDER_THERE, p_all, p_one),
        (thin & ~loud, "the time: power at one frequency there", each.min(axis=0), p_near),
    ):
        # What most rests have is no event of some of them.
        if not which.any() or which.mean() > 0.5:
            continue
        # Each run of rests that have it is a place of its own.
        at = np.flatnonzero(which | (alone * len(found) < _HERE))
        for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            if not which[run].any():
                continue
            rest = found[run]
            interval = (float(poses.interval[rest[0], 0]), float(poses.interval[rest[-1], 1]))
            out.append(Unexplained((channel,), (interval,), follows, float(p[run].min())))
    return out


def _peaks(mean: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the floor of each rest's mean power (bins, rests), and the p-value of what is above.

    The level of each rest is the median over frequencies, and the usual spectrum one over such
    levels: where some rests are shaken, the median of their powers would be a shaken one at one
    frequency and a quiet one at the next. A median of few periodograms is below their mean, by 31 %
    for one, and the level that one shows is off by a fifth: both are in the p-value.
    """
    low = chdtri(2.0 * count, 0.5) / (2.0 * count)
    level = np.median(mean, axis=0) / low
    floor = level * np.median(mean / (level * low), axis=1, keepdims=True)
    # A median's variance, relative to the square of a mean of n exponentials, is about 2 / n.
    variance = 2.0 * _SPREAD / (count * len(mean)) + 2.0 / count.sum()
    return floor, fdtrc(2.0 * count, 2.0 / variance, mean / floor) * mean.size * len(CHANNELS)


def _changes(
    recording: Recording, poses: Poses, power: FloatArray, pose: IntArray, channel: str
) -> list[Unexplained]:
    """Noise power that goes with temperature, time or the pose: a line through its logarithms.

    The residual scatter of the rests about that line sets the standard error, so that rests which
    merely differ from each other are no trend.
    """
    found = np.unique(pose)
    if len(found) < 10:
        return []
    level = np.log([power[:, pose == k].mean() for k in found])
    # What a hand does goes with where gravity is; noise does so at any frequency.
    faster = power[frequencies(len(power), recording.interval) > HAND[1]]
    looked = {"the time": (poses.interval[found].mean(axis=1), level)}
    if (heat := recording.temperature) is not None:
        warm = np.array([heat[poses.start[k] : poses.stop[k]].mean() for k in found])
        looked["the temperature"] = warm, level
    if len(faster) >= NEIGHBOURS:
        fast = np.log([faster[:, pose == k].mean() for k in found])
        up = poses.accel[found] / np.linalg.norm(poses.accel[found], axis=1, keepdims=True)
        for axis, along in zip(AXES, up.T, strict=True):
            # By either end, or by both alike.
            looked[f"gravity along {axis}"] = along, fast
            looked[f"gravity along {axis}, either way"] = along**2, fast
    best: tuple[float, str] = (CLAIM, "")
    for name, (values, own) in looked.items():
        if np.ptp(values) <= 0:
            continue
        slope, chance = _trend(values, own)
        p = chance * len(looked) * len(CHANNELS)
        if p < best[0] and abs(slope) * np.ptp(values) > np.log(_STEADY):
            best = (p, name)
    if not best[1]:
        return []
    where = (float(poses.interval[found[0], 0]), float(poses.interval[found[-1], 1]))
    return [Unexplained((channel,), (where,), f"{best[1]}: the level of noise follows it", best[0])]


def _trend(at: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Return the slope of a straight line, and the p-value of Student's test that it is zero."""
    at, values = at - at.mean(), values - values.mean()
    square = float(at @ at)
    slope = float(at @ values) / square
    freedom = len(at) - 2
    error = float(np.square(values - slope * at).sum()) / freedom / square
    return slope, 2 * float(stdtr(freedom, -abs(slope) / np.sqrt(max(error, 1e-300))))
