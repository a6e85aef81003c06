"""Windows of a recording, and what may be wrong in one.

A bias, a gain, a fluctuation, a wave, or axes that are turned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from calib.effects import effects
from calib.effects.base import State
from calib.mismatch.hypotheses.candidates import (
    DELAY,
    FLUCTUATING,
    GAIN,
    GAIN_IN_TIME,
    MOVING,
    SHARE,
    Candidate,
)
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

FAST = 3.0
"""A brisk turn by hand, rad/s: what rates are scaled by."""

PACE = 3.0
"""1/s: how fast signals change in a turn by hand, relative to what they reach."""

TURNED = "turned axes in a window"
"""A triad that a mounting, or glue, lets turn against the other: ``v x signal``, v small."""

SLIPPED = "a slip of the sensor in its mount"
"""Both triads, turned against a truth."""

WINDOWED = (
    "bias in a window",
    GAIN,
    FLUCTUATING,
    "wave in a window",
    DELAY,
    TURNED,
    SLIPPED,
)
"""Rivals that are functions of time (or a gain) in a window, whose ends can be moved."""

RAMP = {"ramp": 1.0}
"""What grows or fades at a steady pace in a window, from any value."""

THROUGHOUT = "wave throughout"
"""A rival that is a wave in time, from the first segment to the last."""

EARLIEST = 0.25
"""Share of the recording before the first moment at which a gain changes for good."""

FLUCTUATION = 4
"""Segments in a window of fluctuation, fewest."""

CORNERS = {2.0: (1, 32), 6.0: (2, 32)}
"""Half periods in a window above which a fluctuation is weaker (slow swings, and jumps), and how
many cosines it then has for each segment, and at most. With fewer than there are segments it cannot
jump from one to the next, however weak the fast ones are."""

APART, MOST_APART = {"apart": 1.0}, 32
"""What has its own value in each segment of a window, and in how many at most: a contact that every
turn makes anew."""

MIDDLE = {6.0: (1, 16)}
"""`CORNERS` of what a triad has, where three times the columns make every hypothesis dear."""

MOST_ORDERS = 64
"""Cosines that a moved window has at most, twice as many as on the grid: a window that comes to
hold a rest of hours would have thousands, of which the rows of a few segments know nothing."""

WAVES = 6
"""Segments in a window with a wave, fewest: a wave has a mean, an amplitude and a phase."""

SHORTEST_WAVE = 2.0
"""Segments to a period of a wave, at least: each has a rest and a turn."""

SLOTS = (3, 2)
"""Parts of a rest and of a turn that a function of time in a window is constant in. A mean and two
contrasts are all that the rows know of a rest."""

MOST_SLOTS = 240
"""Where there are more parts, functions of time are constant in each segment."""

ROOM = 1.22
"""Half the ratio, in its logarithm, of one length of window to the next."""

NEARBY = 5
"""Windows near one of the grid that are tried, for each of their ends, about."""


def typical_size(triad: str) -> float:
    """Return the size of an unknown disturbance: the median over the catalogue's bias steps."""
    known = effects().get(f"{triad}_bias_step")
    if known is not None:
        return float(known.parameters[0].typical)
    return 0.02 if triad == "accel" else float(np.radians(0.05))


@dataclass(frozen=True, eq=False)
class Slots:
    """Parts of segments: which points (n, k) are in each, their middles, each segment's first."""

    member: sparse.csr_matrix
    middle: FloatArray
    first: IntArray


def make_slots(rows: Rows, *, coarse: bool = False) -> Slots:
    """Cut segments into what a function of time in a window is constant in; one each if coarse."""
    each = np.where(rows.is_rest, *SLOTS)
    if coarse or each.sum() > MOST_SLOTS or not rows.is_rest.any():
        each = np.ones_like(each)
    first = np.concatenate(([0], np.cumsum(each)))
    segment = rows.point_segment
    start, stop = rows.interval[segment].T
    part = (rows.state.time - start) / np.maximum(stop - start, 1e-9) * each[segment]
    slot = first[segment] + np.clip(part.astype(np.int64), 0, each[segment] - 1)
    member = sparse.csr_matrix(
        (np.ones(len(slot)), (np.arange(len(slot)), slot)), shape=(len(slot), first[-1])
    )
    share = (np.arange(first[-1]) - np.repeat(first[:-1], each) + 0.5) / np.repeat(each, each)
    start, stop = np.repeat(rows.interval, each, axis=0).T
    return Slots(member, start + share * (stop - start), first)


@dataclass(frozen=True, eq=False)
class Local:
    """A hypothesis about a window that holds for any channel: the slots that it mixes, and how."""

    name: str
    window: tuple[int, int]
    interval: tuple[float, float]
    shape: Mapping[str, float]
    mixing: FloatArray | None
    part: str = ""
    """Of its kind; that of its length where there is none."""


def is_step(item: Local, segments: int) -> bool:
    """Whether it is a bias in a window that is open at one end."""
    ends = item.window[0] == 0 or item.window[1] == segments
    return item.name == "bias in a window" and ends


def has_ends(candidate: Candidate) -> bool:
    """Whether a candidate is in a window that can be moved; a gain that changed at once is, too."""
    changed = candidate.name == GAIN_IN_TIME and not candidate.shape
    return changed or candidate.name in WINDOWED


def in_windows(
    interval: FloatArray,
    middle: FloatArray,
    first: IntArray,
    corners: Mapping[float, tuple[int, int]],
    *,
    waves: bool,
) -> Iterator[Local]:
    """Yield what each window of segments (s, 2) may hold, with slots as `Slots` has them.

    Waves only if they are wanted.
    """
    for a, b in windows(len(interval)):
        start, stop = float(interval[a, 0]), float(interval[b - 1, 1])
        time = middle[first[a] : first[b]]
        yield Local("bias in a window", (a, b), (start, stop), {}, None)
        yield Local(GAIN, (a, b), (start, stop), {}, None)
        yield Local(DELAY, (a, b), (start, stop), {}, None)
        if b - a >= FLUCTUATION:
            ramp = function_of_time(RAMP, interval[a:b].mean(axis=1), start, stop)
            yield Local(GAIN, (a, b), (start, stop), dict(RAMP), ramp)
            if a > 0:
                yield _moving((a, b), interval, middle[first[a] :])
            if waves:
                grows = function_of_time(RAMP, time, start, stop)
                yield Local("bias in a window", (a, b), (start, stop), dict(RAMP), grows)
        if FLUCTUATION <= b - a <= MOST_APART:
            own = np.repeat(np.eye(b - a), np.diff(first[a : b + 1]), axis=0)
            yield Local(FLUCTUATING, (a, b), (start, stop), dict(APART), own)
        if b - a >= FLUCTUATION:
            for corner, (each, most) in corners.items():
                shape = {"order": float(min(each * (b - a), most)), "corner": corner}
                mixing = function_of_time(shape, time, start, stop)
                yield Local(FLUCTUATING, (a, b), (start, stop), shape, mixing)
        if waves and b - a >= WAVES:
            cycles = np.arange(0.5, (b - a) / SHORTEST_WAVE + 0.25, 0.5)
            for shape, mixing in _waves(cycles, time, start, stop):
                yield Local("wave in a window", (a, b), (start, stop), shape, mixing)


def _moving(window: tuple[int, int], interval: FloatArray, time: FloatArray) -> Local:
    """Return a bias that goes to another level in a window, and stays there to the end."""
    a, b = window
    start, end = float(interval[a, 0]), float(interval[-1, 1])
    shape = {"until": float(interval[b - 1, 1])}
    mixing = function_of_time(shape, time, start, end)
    return Local(MOVING, (a, len(interval)), (start, end), shape, mixing, f"{b - a} segments")


def function_of_time(
    shape: Mapping[str, float], time: FloatArray, start: float, stop: float
) -> FloatArray:
    """Return the (n, k) functions of time that a window from `start` to `stop` holds."""
    since = time - start
    if "until" in shape:
        return np.clip(since / (shape["until"] - start), 0.0, 1.0)[:, None]
    if "ramp" in shape:
        return np.stack((np.ones(len(time)), 2 * since / (stop - start) - 1), axis=1)
    if "period" in shape:
        phase = 2 * np.pi * since / shape["period"]
        return np.stack((np.ones(len(time)), np.cos(phase), np.sin(phase)), axis=1)
    if "order" in shape:
        order = np.arange(int(shape["order"]))
        size = 1.0 / np.sqrt(1.0 + np.square(order / shape["corner"]))
        size[1:] *= np.sqrt(2.0 / np.square(size[1:]).sum())
        # What disturbs seldom does so as much upwards as downwards: pulses have a sign.
        return cosines(np.pi * since / (stop - start), len(order)) * size
    return np.ones((len(time), 1))


def _waves(
    cycles: FloatArray, time: FloatArray, start: float, stop: float
) -> Iterator[tuple[dict[str, float], FloatArray]]:
    """Yield waves of so many cycles in a window: their shape, and `function_of_time` of it."""
    period = (stop - start) / cycles
    phase = 2 * np.pi * (time - start) / period[:, None]
    mixing = np.stack((np.ones(phase.shape), np.cos(phase), np.sin(phase)), axis=2)
    yield from zip([{"period": p} for p in period.tolist()], mixing, strict=True)


def cosines(phase: FloatArray, count: int) -> FloatArray:
    """Return the (n, count) cosines of 0, 1, 2 ... times (n,) phases.

    ``cos((k + 1) x) = 2 cos(x) cos(k x) - cos((k - 1) x)``: a cosine costs ten products.
    """
    first = np.cos(phase)
    out = np.empty((count, len(phase)))
    out[0], out[1:2], twice = 1.0, first, 2.0 * first
    for k in range(2, count):
        np.multiply(twice, out[k - 1], out=out[k])
        out[k] -= out[k - 2]
    return np.ascontiguousarray(out.T)


def moved_window(candidate: Candidate, start: float, stop: float) -> Candidate:
    """Return what a candidate says of a window for another one, as fast in seconds as it was."""
    assert candidate.interval is not None
    shape = dict(candidate.shape)
    if "order" in shape:
        ratio = (stop - start) / max(candidate.interval[1] - candidate.interval[0], 1e-9)
        shape["order"] = float(np.clip(round(shape["order"] * ratio), 2, MOST_ORDERS))
        shape["corner"] *= ratio
    return replace(candidate, interval=(start, stop), shape=shape)


def window_columns(rows: Rows, candidate: Candidate) -> FloatArray:
    """Return the (m, k) columns of what a candidate says of its window, to the very ends."""
    assert candidate.interval is not None
    start, stop = candidate.interval
    if "apart" in candidate.shape:
        inside = (rows.interval[:, 0] < stop) & (rows.interval[:, 1] > start)
        parts = segment_columns(rows, replace(candidate, shape={}))[:, inside]
        return np.asarray(parts.reshape(len(parts), -1))
    state, size = rows.state, typical_size(candidate.channels[0].split(".")[0])
    first = np.searchsorted(state.time, start)
    within = slice(first, np.searchsorted(state.time, stop, side="right"))
    shape = function_of_time(candidate.shape, state.time[within], start, stop)
    return np.hstack(
        [
            sum(
                size * np.asarray(rows.functional[c][:, within] @ (shape * of[within, None]))
                for c, of in carriers
            )
            for carriers in carried(state, candidate)
        ]
    )


def carried(state: State, candidate: Candidate) -> list[list[tuple[int, FloatArray]]]:
    """Return what functions of time multiply: of each size, the channels and signals (n,).

    The channels of a triad have a size each, but for what they share; its gain, that of its
    reference, is one, and what turns it about one axis shows on the other two.
    """
    channels = [CHANNELS.index(c) for c in candidate.channels]
    if SHARE[0] in candidate.shape:
        each = [candidate.shape[axis] for axis in SHARE]
        return [[(c, np.full(len(state.time), k)) for c, k in zip(channels, each, strict=True)]]
    if candidate.name == GAIN:
        return [[(c, own_signal(state, c)) for c in channels]]
    if candidate.name == DELAY:
        return [[(c, own_slope(state, c)) for c in channels]]
    if candidate.name == TURNED:
        signal = np.stack([own_signal(state, c) for c in channels], axis=1)
        turned = [np.cross(axis, signal) for axis in np.eye(3)]
        return [
            [(c, v[:, i]) for i, c in enumerate(channels) if i != j] for j, v in enumerate(turned)
        ]
    if candidate.name == SLIPPED:
        force, rate = state.force / state.gravity, state.rate / state.gravity
        turned = [np.hstack((np.cross(axis, force), np.cross(axis, rate))) for axis in np.eye(3)]
        return [[(c, v[:, c]) for c in channels if c % 3 != j] for j, v in enumerate(turned)]
    return [[(c, np.ones(len(state.time)))] for c in channels]


def fluctuating(
    candidate: Candidate,
    start: float,
    stop: float,
    *,
    segments: int,
    share: FloatArray | None = None,
) -> Candidate:
    """Return a fluctuation in a window of so many segments, on a candidate's channels.

    They have one each, or a ``share`` of one.
    """
    one = len(candidate.channels) == 1 or share is not None
    corner, (each, most) = list((CORNERS if one else MIDDLE).items())[-1]
    shape = {"order": float(max(min(each * segments, most), 2)), "corner": corner}
    if share is not None:
        shape |= dict(zip(SHARE, share.tolist(), strict=True))
    return replace(candidate, name=FLUCTUATING, interval=(start, stop), shape=shape)


def touched(candidate: Candidate) -> tuple[str, ...]:
    """Return the channels that a candidate acts on: of what axes share, those with a share."""
    if SHARE[0] not in candidate.shape:
        return candidate.channels
    shares = (candidate.shape[axis] for axis in SHARE)
    return tuple(c for c, share in zip(candidate.channels, shares, strict=True) if share)


def slot_columns(rows: Rows, slots: Slots, channels: tuple[str, ...]) -> FloatArray:
    """Return the (m, n, c) columns of a disturbance in each slot, on each of some channels."""
    out = []
    for name in channels:
        seen = rows.functional[CHANNELS.index(name)] @ slots.member
        out.append(typical_size(name.split(".")[0]) * seen.toarray())
    return np.stack(out, axis=2)


def segment_columns(rows: Rows, candidate: Candidate) -> FloatArray:
    """Return the (m, s, k) columns of what a candidate says of a window, in each segment alone."""
    assert candidate.interval is not None
    state, size = rows.state, typical_size(candidate.channels[0].split(".")[0])
    shape = size * function_of_time(candidate.shape, state.time, *candidate.interval)
    return np.concatenate(
        [
            np.stack(
                [sum(in_segments(rows, c, own * of) for c, of in carriers) for own in shape.T],
                axis=2,
            )
            for carriers in carried(state, candidate)
        ],
        axis=2,
    )


def in_segments(rows: Rows, c: int, values: FloatArray) -> FloatArray:
    """Return the (m, s) columns of (n,) values on a channel, in each segment alone."""
    points = np.arange(len(values))
    shape = len(points), len(rows.interval)
    member = sparse.csr_matrix((values, (points, rows.point_segment)), shape=shape)
    return np.asarray((rows.functional[c] @ member).toarray())


def throughout(
    interval: FloatArray, middle: FloatArray
) -> Iterator[tuple[dict[str, float], FloatArray]]:
    """Yield waves that a whole recording may have: their shape, and what each slot has of them."""
    start, stop = float(interval[0, 0]), float(interval[-1, 1])
    cycles = np.arange(1.0, len(interval) / SHORTEST_WAVE + 0.25, 0.5)
    yield from _waves(cycles, middle, start, stop)


def gains_in_time(interval: FloatArray) -> Iterator[Local]:
    """Yield how a gain may change in a recording of (s, 2) segments.

    For good from a moment on, at once or at a steady pace: a crack, or a reference that ages. Or
    every segment makes it anew: a loose part. A gain that follows temperature has a name.
    """
    middle, n = interval.mean(axis=1), len(interval)
    begin, end = float(interval[0, 0]), float(interval[-1, 1])
    for k in range(max(int(EARLIEST * n), 1), n):
        start = float(interval[k, 0])
        place = (k, n), (start, end)
        yield Local(GAIN_IN_TIME, *place, {}, None, "at once")
        if n - k >= FLUCTUATION:
            pace = (middle[k:, None] - start) / (end - begin)
            yield Local(GAIN_IN_TIME, *place, dict(RAMP), pace, "at a pace")
    yield Local(GAIN_IN_TIME, (0, n), (begin, end), dict(APART), np.eye(n), "apart")


def own_signal(state: State, c: int) -> FloatArray:
    """Return a channel's own signal (n,), in g or brisk turns."""
    return state.force[:, c] / state.gravity if c < 3 else state.rate[:, c - 3] / FAST


def own_slope(state: State, c: int) -> FloatArray:
    """Return how fast a channel's own signal changes, (n,), relative to a turn by hand."""
    size, slope = (state.gravity, state.force_dot) if c < 3 else (FAST, state.rate_dot)
    return np.asarray(slope[:, c % 3] / (PACE * size))


def nearby_windows(rows: Rows, candidate: Candidate) -> Iterator[tuple[float, float]]:
    """Yield the windows, to the segment, that are nearer to a candidate's than to others tried."""
    if candidate.interval is None or candidate.name in (TURNED, SLIPPED):
        # Axes that turn are tried in parts of segments.
        return
    start, stop = candidate.interval
    a = int(np.searchsorted(rows.interval[:, 0], start - 1e-9))
    length = int(np.searchsorted(rows.interval[:, 1], stop - 1e-9)) + 1 - a
    reach = max(1, length // 4) // 2
    shortest, longest = int(np.ceil(length / ROOM)), int(length * ROOM)
    low, high = 0, len(rows.interval)
    if candidate.name == "bias in a window":
        # Open at one end it would be a step, which has a name.
        low, high = 1, high - 1
    for first in range(a - reach, a + reach + 1, max(1, (2 * reach + 1) // NEARBY)):
        for size in range(shortest, longest + 1, max(1, (longest - shortest + 1) // NEARBY)):
            if first >= low and first + size <= high:
                yield float(rows.interval[first, 0]), float(rows.interval[first + size - 1, 1])


def windows(segments: int) -> Iterator[tuple[int, int]]:
    """Yield ``[a, b)`` of 1, 2, 3, 4, 6, 8, 12 ... segments, at every quarter of their length."""
    lengths = {1} | {n << k for n in (2, 3) for k in range(segments.bit_length())}
    for length in sorted(n for n in lengths if n <= max(segments // 2, 1)):
        for a in range(0, segments - length + 1, max(1, length // 4)):
            yield a, a + length
