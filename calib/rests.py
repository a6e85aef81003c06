"""Which parts of the candidates of `calib.statics` are rests, and where those end.

A run of candidates is judged by its own noise, the scatter from block to block: blocks and longer
stretches that are off the gyroscope's rate at rest, or where the specific force moves, are taken
out. That finds slow turns and bumps, and lets a hand tremble. The ends move inwards to where the
turn began: from the times at which its rate passes two levels with a ratio of four, as it grows
with the square of time in a smooth turn.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from calib.pushed import without_pushes
from calib.stillness import (
    CHI_SQUARED,
    TREMOR_RATE,
    WIDTH,
    Blocks,
    Units,
    moving_mean,
    moving_median,
    runs,
    spill,
    sway,
)
from calib.swung import without_swings
from calib.types import BoolArray, FloatArray, IntArray

NORM = 7.0
"""FACTOR for the length of a vector of three, in standard deviations of one of them."""
LASTING = 3.0
"""Mean over a long stretch, in standard deviations of a block: noise need not be white."""
BUMP = 6.0
"""Power inside a block, as a multiple of the run's median, that is a bump."""
SAME = 0.02
"""Angle by which a hand that holds still wanders, rad."""
DRIFT = 0.003
"""How far a gyroscope's rate at rest moves from pose to pose and within a minute, rad/s."""
GROUP = 20
"""Stretches of 1 s that share one estimate of the gyroscope's bias."""
POSES, APART = 3, 0.1
"""Poses through which a bias is seen to have stepped, and the angle between two, rad. They are most
of what is between the first of them and the last."""
UNMOVED, CLEARLY = 50.0, 4.0
"""How much worse a turn explains the change of specific force than rest does for fewer poses to be
at rest: by chi-squared, and as a ratio."""
MOST_BIAS = 0.07
"""rad/s: by more (4 °/s) no bias steps in a recording. A table that turns about the vertical keeps
gravity where it is as well."""
STEPS = 8
"""Times that it steps, at most."""
ONSET = 4.0
"""Rate at which a turn is seen to begin, in standard deviations of a block on one axis."""
RISE = 4.0
"""Ratio of the two levels by which the beginning of a turn is found."""
SHORTEST = 4
"""Blocks that a pose has at least, once its ends have moved inwards."""
REVERSAL = TREMOR_RATE / 4
"""Change of the mean rate from the first half of a short rest to the second, and twice its mean,
rad/s."""
LONG_REST = 30
"""Blocks from which on a rest cannot be the end of a swing."""
BRIEF = 1 / 3
"""Share of the median length of rests below which what turns slowly is a part of a turn."""
LONGEST_RISE = 40
"""Blocks by which an end may move inwards."""
NEAR = 20, 600
"""Blocks of a rest, at least and at most, that tell its rate at one end: its half there, but for
these. A bias may step in a rest, and over minutes it drifts."""


def refine(
    blocks: Blocks,
    candidates: BoolArray,
    least: int,
    steps: tuple[float, float],
    units: Units,
    scales: tuple[int, ...],
) -> list[tuple[int, int]]:
    """Return the block ranges of the poses among the runs of candidates.

    Parameters
    ----------
    blocks : Blocks
    candidates : (n,) array of bool
    least : int
        Blocks of the shortest pose.
    steps : (float, float)
        Resolution of the specific force and of the rate, in the recording's units.
    units : Units
    scales : tuple of int
        Lengths over which a run is compared with rest, in blocks.
    """
    start, stop = runs(candidates)
    long = stop - start >= max(least, 3)
    whole = list(zip(start[long].tolist(), stop[long].tolist(), strict=True))
    if not whole:
        return []
    noise = [scatter(blocks.gyro[a:b], steps[1]) for a, b in whole]
    if units.rate is not None:  # a hand that shakes more than this is not at rest
        most = max(TREMOR_RATE / 4 / units.rate, 2 * float(np.median(noise)))
        noise = [min(n, most) for n in noise]
    force = [scatter(blocks.accel[a:b], steps[0]) for a, b in whole]
    # First what the accelerometer sees, which needs no bias to be known.
    pieces = []
    for run, n_force in zip(whole, force, strict=True):
        segments = [run]
        for scale in scales:
            moved = partial(_force_moved, blocks, units=units, scale=scale, noise=n_force)
            segments = _split(segments, moved)
        pieces.append(segments)
    flat = [segment for segments in pieces for segment in segments]
    if not flat:
        return []
    usual = float(np.median(noise)), float(np.median(force))
    off = blocks.gyro - _rate_at_rest(blocks, flat, usual, units)
    # Poses differ in rate by g-sensitivity and drift.
    centre = [np.linalg.norm(np.median(off[a:b], axis=0)) for a, b in flat]
    spread = max(3.0 * float(np.median(centre)), DRIFT / units.rate if units.rate else 0.0)
    found: list[tuple[int, int, float]] = []
    for segments, n_rate, n_force in zip(pieces, noise, force, strict=True):
        for scale in scales:
            level = n_rate * max(NORM / np.sqrt(scale), LASTING) + spread
            segments = _split(segments, partial(_rate_moved, off, scale=scale, level=level))
        for a, b in _join(blocks, off, segments, (n_force, n_rate), units):
            found.append((a, b, ONSET * max(n_rate, sway(off[a:b]))))
    spans = _trim(blocks.gyro, off, found, least, units)
    if len(scales) > 1:  # with none that take long, time means nothing
        spans = without_swings(blocks, off, spans, least=least, units=units)
        spans = without_pushes(blocks, off, spans, least=least, step=steps[0], units=units)
    return _still(off, spans, steps[1])


def _still(off: FloatArray, segments: list[tuple[int, int]], step: float) -> list[tuple[int, int]]:
    """Return the segments without brief ones that turn slowly, as a part of a turn may.

    They are brief beside what a rest of this recording lasts, and `off`, or off by more in one half
    than in the other, than noise and what the rates of rests differ by make them.
    """
    if len(segments) < POSES:
        return segments
    length = np.array([b - a for a, b in segments])
    halves = np.array(
        [
            [off[a : (a + b) // 2].mean(axis=0), off[(a + b) // 2 : b].mean(axis=0)]
            for a, b in segments
        ]
    )
    rate = np.linalg.norm(halves.mean(axis=1), axis=1)
    brief = length < min(BRIEF * float(np.median(length)), LONG_REST)
    noise = np.median(
        [max(scatter(off[a:b], step), sway(off[a:b])) for a, b in np.array(segments)[~brief]]
    )
    usual = NORM * noise / np.sqrt(length)
    turns = rate > usual + 3.0 * np.median(rate[~brief])
    turns |= np.linalg.norm(np.ptp(halves, axis=1), axis=1) > 2.0 * usual
    turns &= brief
    return [segment for segment, out in zip(segments, turns.tolist(), strict=True) if not out]


def _medians(values: FloatArray, piece: IntArray) -> FloatArray:
    """Return the medians (k, 3) of (n, 3) values in pieces ``[first, last)``, (k, 2)."""
    out = np.empty((len(piece), values.shape[1]))
    length = np.diff(piece)[:, 0]
    for number in np.unique(length).tolist():
        own = np.flatnonzero(length == number)
        out[own] = np.median(values[piece[own, :1] + np.arange(number)], axis=1)
    return out


def _rate_at_rest(
    blocks: Blocks, segments: list[tuple[int, int]], noise: tuple[float, float], units: Units
) -> FloatArray:
    """Return the gyroscope's bias at each block, (n, 3): where most rates are, following drift.

    Stretches of about 1 s of the segments give a median each. The bias is where they lie densest:
    rests share one rate, slow turns do not. From there it is followed through its drift. What is
    off that and shares another rate through several poses is at rest too: the bias has stepped, as
    nothing turns a sensor in its own frame as before from pose to pose. So is what would turn
    gravity where none is seen to turn, be it in one pose.
    """
    width = max(WIDTH, round(1.0 / blocks.duration))
    pieces = [
        pair
        for a, b in segments
        for pair in pairwise(np.linspace(a, b, max(1, (b - a) // width) + 1).astype(int).tolist())
    ]
    piece = np.array(pieces)
    rate, up = _medians(blocks.gyro, piece), _medians(blocks.accel, piece)
    at = 0.5 * (piece[:, 0] + piece[:, 1] - 1)
    up /= np.maximum(np.linalg.norm(up, axis=1), 1e-300)[:, None]
    near = NORM * noise[0]
    reach = near if units.rate is None else max(near, DRIFT / units.rate)
    bias, left = np.empty((len(blocks), 3)), np.arange(len(rate))
    first, last = 0, len(blocks)
    for _ in range(STEPS + 1):
        when, smooth = _followed(at[left], rate[left], near, reach)
        place = np.arange(first, last)
        bias[first:last] = np.column_stack([np.interp(place, when, own) for own in smooth.T])
        left = np.flatnonzero(np.linalg.norm(rate - bias[at.astype(int)], axis=1) > reach)
        if not len(left):
            break
        when, smooth = _followed(at[left], rate[left], near, reach)
        path = np.column_stack([np.interp(at[left], when, own) for own in smooth.T])
        left = left[np.linalg.norm(rate[left] - path, axis=1) <= reach]
        stepped = rate[left] - bias[at[left].astype(int)]
        if units.rate and units.rate * np.linalg.norm(stepped, axis=1).max() > MOST_BIAS:
            break
        turned = np.einsum("ij,ij->i", up[left[1:]], up[left[:-1]]) < np.cos(APART)
        if 1 + turned.sum() < POSES and not _moves_nothing(
            blocks, piece[left], stepped, noise[1], units
        ):
            break
        if 2 * len(left) <= left[-1] - left[0] + 1:
            break
        first, last = piece[left[0], 0], piece[left[-1], 1]
    return bias


def _moves_nothing(
    blocks: Blocks, piece: IntArray, rate: FloatArray, noise: float, units: Units
) -> bool:
    """Whether gravity stays where it would turn if pieces (k, 2) turned at rates (k, 3).

    That is compared over whole stretches of pieces.
    """
    if units.rate is None:
        return False
    ends = np.append(np.flatnonzero(piece[1:, 0] != piece[:-1, 1]), len(piece) - 1)
    total, first = np.zeros(2), 0
    for last in ends.tolist():
        a, b = int(piece[first, 0]), int(piece[last, 1])
        own = units.rate * rate[first : last + 1].mean(axis=0)
        total += misfits(blocks.accel[a:b], own, blocks.duration, noise)
        first = last + 1
    return unmoved(total)


def misfits(accel: FloatArray, rate: FloatArray, interval: float, noise: float) -> FloatArray:
    """Return how badly specific force (n, 3) agrees with rest, and with a turn at a rate: (2,).

    These are chi-squared. In a sensor's frame it changes by ``f x w`` in unit time, of which about
    the vertical nothing is left.

    Parameters
    ----------
    accel : (n, 3) array
        ``interval`` s apart, with a standard deviation of ``noise`` on each axis.
    rate : (3,) array, rad/s
    """
    third = max(len(accel) // 3, 1)
    change = accel[-third:].mean(axis=0) - accel[:third].mean(axis=0)
    turned = np.cross(accel.mean(axis=0), rate * (len(accel) - third) * interval)
    left = np.stack((change, change - turned))
    return np.asarray(np.square(left).sum(axis=1) * third / (2.0 * noise**2))


def unmoved(misfit: FloatArray) -> bool:
    """Whether misfits of rest and of a turn (2,) say that there was no turn."""
    rest, turn = misfit.tolist()
    return bool(turn - rest > UNMOVED and turn > CLEARLY * rest)


def _followed(
    at: FloatArray, rate: FloatArray, near: float, reach: float
) -> tuple[FloatArray, FloatArray]:
    """Return when, and what, a bias was that is followed from where rates (n, 3) lie densest."""
    few = rate[:: max(1, len(rate) // 500)]
    apart = few[:, None] - few
    square = np.einsum("ijk,ijk->ij", apart, apart)
    density = (square < near**2).sum(axis=1)
    densest = int(np.argmin(np.linalg.norm(rate - few[np.argmax(density)], axis=1)))
    # From the densest place outwards, in groups, each within reach of the one before it.
    groups = [slice(k, k + GROUP) for k in range(0, len(rate), GROUP)]
    centre = densest // GROUP
    known: dict[int, tuple[FloatArray, FloatArray]] = {}
    for path in (range(centre, len(groups)), range(centre, -1, -1)):
        bias, since, slope, far = rate[densest], at[densest], np.zeros(3), 0.0
        for g in path:
            time, own = at[groups[g]], rate[groups[g]]
            # A sensor that warms up leaves faster and faster, back in time.
            off = own - bias - slope * np.clip(time - since, -far, far)[:, None]
            mine = np.linalg.norm(off, axis=1) <= reach
            if not mine.any():
                continue
            time, own, since = time[mine], own[mine], float(time[mine].mean())
            bias, slope = np.median(own, axis=0), np.zeros(3)
            if len(time) >= GROUP // 2:
                slope, far = np.polyfit(time - since, own, 1)[0], 2.0 * float(np.ptp(time))
            ends = time[[0, -1]]
            known[g] = ends, bias + slope * (ends - since)[:, None]
    when = np.concatenate([known[g][0] for g in sorted(known)])
    return when, np.concatenate([known[g][1] for g in sorted(known)])


def scatter(values: FloatArray, step: float) -> float:
    """Return the standard deviation of one axis of the block means, from block to block."""
    square = np.square(np.diff(values, axis=0)).sum(axis=1)
    return max(float(np.sqrt(np.median(square) / (2 * CHI_SQUARED))), float(step / np.sqrt(12)))


def _split(
    segments: list[tuple[int, int]], moved: Callable[[int, int], BoolArray]
) -> list[tuple[int, int]]:
    """Return what is left of the segments when the blocks that moved are taken out."""
    left = []
    for a, b in segments:
        start, stop = runs(~moved(a, b))
        left += [(a + int(s), a + int(e)) for s, e in zip(start, stop, strict=True)]
    return left


def _force_moved(
    blocks: Blocks, a: int, b: int, *, units: Units, scale: int, noise: float
) -> BoolArray:
    """Return which blocks are bumps (scale 1), or where means over `scale` blocks change."""
    n = b - a
    moved = np.zeros(n, bool)
    accel = blocks.accel[a:b]
    if scale == 1:
        local = moving_median(accel, min(11, n))
        moved |= np.linalg.norm(accel - local, axis=1) > (NORM + 1) * noise
        if blocks.size > 1:
            freedom = 3 * (blocks.size - 1)
            limit = max(BUMP, 1 + 8 * np.sqrt(2 / freedom))
            for power in (blocks.accel_power[a:b], blocks.gyro_power[a:b]):
                moved |= power > limit * np.median(power)
    elif n >= 2 * scale:
        mean = moving_mean(accel, scale)
        change = np.linalg.norm(mean[scale:] - mean[:-scale], axis=1)
        usual = np.sqrt(2) * noise * max(NORM / np.sqrt(scale), LASTING)
        spill(moved, change > usual + SAME * units.gravity, 2 * scale)
    return moved


def _rate_moved(off: FloatArray, a: int, b: int, *, scale: int, level: float) -> BoolArray:
    """Return which blocks are in a stretch of `scale` whose mean rate is not that of rest."""
    moved = np.zeros(b - a, bool)
    if b - a >= scale:
        spill(moved, np.linalg.norm(moving_mean(off[a:b], scale), axis=1) > level, scale)
    return moved


def _join(
    blocks: Blocks,
    off: FloatArray,
    segments: list[tuple[int, int]],
    noise: tuple[float, float],
    units: Units,
) -> list[tuple[int, int]]:
    """Return the segments of one run, those joined between which nothing turned.

    What stands between them is a tremble or a tap, as it is within the limits of a rest: it stays
    in the pose if the rate over it has no integral and the force is the same on both sides.
    """
    joined: list[tuple[int, int]] = []
    for segment in segments:
        if joined:
            (a, b), (c, d) = joined[-1], segment
            turned = np.linalg.norm(off[b:c].sum(axis=0)) * blocks.duration * (units.rate or 1.0)
            tilt = blocks.accel[max(a, b - 10) : b].mean(axis=0)
            tilt = tilt - blocks.accel[c : min(d, c + 10)].mean(axis=0)
            few = np.sqrt(1 / min(10, b - a) + 1 / min(10, d - c))
            if turned <= SAME and np.linalg.norm(tilt) <= (
                SAME * units.gravity + NORM * noise[0] * few
            ):
                joined[-1] = (a, d)
                continue
        joined.append(segment)
    return joined


def _trim(
    gyro: FloatArray,
    off: FloatArray,
    segments: list[tuple[int, int, float]],
    least: int,
    units: Units,
) -> list[tuple[int, int]]:
    """Return the segments with their ends moved to where the turns beside them began."""
    found = []
    edges = [0, *(e for segment in segments for e in segment[:2]), len(off)]
    for k, (a, b, level) in enumerate(segments):
        if b - a < least or _swings(off[a:b], units):
            continue
        rate = gyro[edges[2 * k] : edges[2 * k + 3]]
        into, out = a - edges[2 * k], edges[2 * k + 3] - b
        near = min(max((b - a) // 2, NEAR[0]), NEAR[1], b - a)
        first, last = (np.median(gyro[i : i + near], axis=0) for i in (a, b - near))
        size = np.linalg.norm(rate - first, axis=1)
        begin, early = rise(size[::-1], out + b - a, level, (b - a) // 2)
        size = np.linalg.norm(rate - last, axis=1)
        end, late = rise(size, into + b - a, level, (b - a) // 2)
        spare = b - a - begin - end - SHORTEST
        if spare >= 0:
            # A short rest keeps its middle: there margins share what there is.
            share = min(1.0, spare / max(early + late, 1))
            found.append((a + begin + int(early * share), b - end - int(late * share)))
    return found


def _swings(off: FloatArray, units: Units) -> bool:
    """Return whether the rate only passes through that of rest, or near it, as in a swing."""
    if units.rate is None or len(off) > LONG_REST:
        return False
    half = len(off) // 2
    change = off[-half:].mean(axis=0) - off[:half].mean(axis=0)
    second = np.square(np.diff(off, 2, axis=0)).sum(axis=1)
    noise = np.sqrt(np.median(second) / (6 * CHI_SQUARED)) if len(second) else 0.0
    usual = REVERSAL / units.rate + NORM * np.sqrt(2 / half) * noise
    return bool(max(np.linalg.norm(change), 2 * np.linalg.norm(off.mean(axis=0))) > usual)


def rise(
    rate: FloatArray, end: int, level: float, inside: int, *, brisk: int | None = None
) -> tuple[int, int]:
    """Return by how many blocks the end of a segment must move inwards, and a margin to that.

    A rate that grows as (t - t0)² passes `level` at t1 and four times it at t2 = 2 t1 - t0. The
    level may have been passed for good up to `inside` blocks before the end. With ``brisk``, what
    takes more blocks than that to rise, or begins beyond the end, is none.
    """
    begin = end - min(inside, LONGEST_RISE)
    rate = rate[begin : end + 2 * LONGEST_RISE]
    if end - begin >= len(rate):
        return 0, 0
    above = rate > level
    outside = np.flatnonzero(above[end - begin :])
    if not outside.size:
        return 0, 1
    below = np.flatnonzero(~above[: end - begin + int(outside[0])])
    first = int(below[-1]) + 1 if below.size else 0
    high = np.flatnonzero(rate[first:] > RISE * level)
    taken = int(high[0]) if high.size else int(np.argmax(rate[first:]))
    inwards = taken - (first - (end - begin))
    if brisk is not None and (taken > brisk or inwards <= 0):
        return 0, 0
    # A quarter of the rise, and the two blocks in which the levels were passed.
    margin = (taken + 3) // 4 + 2
    if inwards < 0:
        inwards, margin = 0, max(0, margin + inwards)
    return min(inwards, LONGEST_RISE), margin
