"""Honest rivals: what a residual may follow without being physics that we know.

They compete with the catalogue on the same terms. When one wins, the answer is "unexplained: this
channel, this span or regime, follows this", and not the nearest name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from calib.effects import effects
from calib.effects.base import State
from calib.mismatch.rows import Rows
from calib.mismatch.score import Candidate, Stack
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

RIVAL = 0.4
"""Prior probability of all rivals together."""

FAST = 3.0
"""A brisk turn by hand, rad/s: what rates are scaled by."""

_KINDS = {
    "bias in a window": 0.19,
    "gain in a window": 0.11,
    "fluctuation in a window": 0.17,
    "wave in a window": 0.15,
    "time": 0.02,
    "temperature": 0.02,
    "direction of gravity": 0.14,
    "orientation": 0.03,
    "speed of rotation": 0.05,
    "its own rate": 0.02,
}
"""Share of each. What follows temperature, time or its own rate smoothly has names in the
catalogue, or is drift: only odd shapes are left."""

_OF_TRIADS = {"bias in a window": 0.02, "fluctuation in a window": 0.05}
"""The same for what three channels have at once: their supply, cable or package."""

WINDOWED = ("bias in a window", "gain in a window", "fluctuation in a window", "wave in a window")
"""Rivals that are functions of time (or a gain) in a window, whose ends can be moved."""

FLUCTUATION = 4
"""Segments in a window of fluctuation, fewest."""

CORNERS = {2.0: (1, 12), 16.0: (2, 32)}
"""Half periods in a window above which a fluctuation is weaker (slow swings, and jumps), and how
many cosines it then has for each segment, and at most."""

MIDDLE = {6.0: (1, 16)}
"""The same for what a triad has, where three times the columns make every hypothesis dear."""

MOST_ORDERS = 64
"""Cosines that a moved window has at most, twice as many as on the grid: a window that comes to
hold a rest of hours would have thousands, of which the rows of a few segments know nothing."""

WAVES = 6
"""Segments in a window with a wave, fewest: a wave has a mean, an amplitude and a phase."""

CYCLES = 12.0
"""Periods of a wave within a window, at most; and never less than four segments to a period."""

SLOTS = (3, 2)
"""Parts of a rest and of a turn that a function of time in a window is constant in. A mean and two
contrasts are all that the rows know of a rest."""

MOST_SLOTS = 240
"""Where there are more parts, functions of time are constant in each segment."""

ROOM = 1.22
"""Half the ratio, in its logarithm, of one length of window to the next."""

NEARBY = 5
"""Windows near one of the grid that are tried, for each of their ends, about."""

RIPPLES = (2.0, 3.0, 4.0, 5.0)
"""How fast a function of one component of gravity's direction varies, rad per unit."""

CAP = 6.0
"""How steeply what acts near one direction only falls off: to a half at 28 degrees."""


_Draft = tuple[str, str, tuple[str, ...], IntArray, dict[str, Any]]
"""The part of its kind that a candidate belongs to, its name, channels, index, and the rest."""


def add_rivals(stack: Stack, rows: Rows, *, skip: tuple[str, ...] = ()) -> None:
    """Add every rival that these rows can show, with weights that sum to at most `RIVAL`.

    ``skip`` names those that are not tried (``time`` where the clock is wrong).
    """
    slots = _make_slots(rows)
    local, ripples = list(_in_windows(rows, slots, CORNERS)), list(_ripples(rows, slots))
    smooth = list(_smooth(rows.state))
    alike = [
        item
        for item in _in_windows(rows, slots, MIDDLE)
        if item.name in _OF_TRIADS and item.window[1] - item.window[0] >= FLUCTUATION
    ]
    found: list[_Draft] = []
    for triad in (CHANNELS[:3], CHANNELS[3:]):
        # Beside the bias, a window that is open at one end is a step of it, which has a name.
        name = f"{triad[0].split('.')[0]}_bias_step"
        step = name in effects() and name not in skip
        own, joint = (
            [w for w in items if not (step and _is_step(rows, w))] for items in (local, alike)
        )
        parts = []
        for channel in map(CHANNELS.index, triad):
            size = typical_size(triad[0].split(".")[0])
            parts.append(stack.add(size * (rows.functional[channel] @ slots.member).toarray()))
            found += _of_channel(stack, rows, channel, slots, parts[-1], own, ripples, smooth)
        found += _of_triad(triad, slots, parts, joint)
    found = [draft for draft in found if draft[1] not in skip]
    # Every kind has its share, each of its parts (one length of window, say) the same of that.
    number = Counter((name, len(channels), part) for part, name, channels, *_ in found)
    lengths = Counter((name, many) for name, many, _ in number)
    for part, name, channels, index, about in found:
        many = len(channels)
        share = (_KINDS if many == 1 else _OF_TRIADS)[name]
        weight = RIVAL * share / lengths[name, many] / number[name, many, part]
        stack.candidates.append(Candidate(name, index, weight, False, channels, **about))


def typical_size(triad: str) -> float:
    """Return the size of an unknown disturbance: the median over the catalogue's bias steps."""
    known = effects().get(f"{triad}_bias_step")
    if known is not None:
        return float(known.parameters[0].typical)
    return 0.02 if triad == "accel" else float(np.radians(0.05))


@dataclass(frozen=True, eq=False)
class _Slots:
    """Parts of segments: which points (n, k) are in each, their middles, each segment's first."""

    member: Any
    middle: FloatArray
    first: IntArray


def _make_slots(rows: Rows) -> _Slots:
    each = np.where(rows.is_rest, *SLOTS)
    if each.sum() > MOST_SLOTS or not rows.is_rest.any():
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
    return _Slots(member, start + share * (stop - start), first)


@dataclass(frozen=True, eq=False)
class _Local:
    """A hypothesis about a window that holds for any channel: the slots that it mixes, and how."""

    name: str
    window: tuple[int, int]
    interval: tuple[float, float]
    shape: Mapping[str, float]
    mixing: FloatArray | None


def _is_step(rows: Rows, item: _Local) -> bool:
    """Whether a bias in a window is open at one end."""
    ends = item.window[0] == 0 or item.window[1] == len(rows.interval)
    return item.name == "bias in a window" and ends


def _in_windows(
    rows: Rows, slots: _Slots, corners: Mapping[float, tuple[int, int]]
) -> Iterator[_Local]:
    """Yield what each window may hold."""
    for a, b in windows(len(rows.interval)):
        start, stop = float(rows.interval[a, 0]), float(rows.interval[b - 1, 1])
        time = slots.middle[slots.first[a] : slots.first[b]]
        yield _Local("bias in a window", (a, b), (start, stop), {}, None)
        yield _Local("gain in a window", (a, b), (start, stop), {}, None)
        shapes: list[tuple[str, dict[str, float]]] = []
        if b - a >= FLUCTUATION:
            for corner, (each, most) in corners.items():
                order = float(min(each * (b - a), most))
                shapes.append(("fluctuation", {"order": order, "corner": corner}))
        if b - a >= WAVES:
            cycles = np.arange(0.5, min(CYCLES, (b - a) / 4) + 0.25, 0.5)
            shapes += [("wave", {"period": (stop - start) / k}) for k in cycles]
        for kind, shape in shapes:
            name = f"{kind} in a window"
            mixing = _function(shape, time, start, stop)
            yield _Local(name, (a, b), (start, stop), shape, mixing)


def _function(
    shape: Mapping[str, float], time: FloatArray, start: float, stop: float
) -> FloatArray:
    """Return the (n, k) functions of time that a window from `start` to `stop` holds."""
    since = time - start
    if "period" in shape:
        phase = 2 * np.pi * since / shape["period"]
        return np.stack((np.ones(len(time)), np.cos(phase), np.sin(phase)), axis=1)
    if "order" in shape:
        order = np.arange(int(shape["order"]))
        size = 1.0 / np.sqrt(1.0 + np.square(order / shape["corner"]))
        size *= np.sqrt(2.0 / np.square(size).sum())
        return np.asarray(np.cos(np.pi * since[:, None] / (stop - start) * order) * size)
    return np.ones((len(time), 1))


def _of_channel(
    stack: Stack,
    rows: Rows,
    c: int,
    slots: _Slots,
    parts: IntArray,
    local: list[_Local],
    ripples: list[tuple[float, FloatArray]],
    smooth: list[tuple[str, FloatArray]],
) -> Iterator[_Draft]:
    """Yield candidates of a channel."""
    state, size = rows.state, typical_size(CHANNELS[c].split(".")[0])
    own = _scaled(state, c)
    member = sparse.csr_matrix(
        (own, (np.arange(len(own)), rows.point_segment)), shape=(len(own), len(rows.interval))
    )
    gains = stack.add(size * (rows.functional[c] @ member).toarray())
    channels = (CHANNELS[c],)
    for item in local:
        a, b = item.window
        gain = item.name == "gain in a window"
        index = gains[a:b] if gain else parts[slots.first[a] : slots.first[b]]
        about = {
            "summed": item.mixing is None,
            "interval": item.interval,
            "shape": item.shape,
            "mixing": item.mixing,
        }
        yield f"{b - a} segments", item.name, channels, index, about
    for name, values in (*smooth, ("its own rate", _own_rate(state, c))):
        index = stack.add(size * rows.columns(c, values))
        yield "smooth", name, channels, index, {}
        if name == "direction of gravity":
            # Harmonics come in the order of their degree: 3 + 6 of degrees 1 and 2.
            yield "quadratic", name, channels, index[:9], {}
    for ripple, mixing in ripples:
        yield f"ripple {ripple}", "direction of gravity", channels, parts, {"mixing": mixing}


def _of_triad(
    triad: tuple[str, ...], slots: _Slots, parts: list[IntArray], local: list[_Local]
) -> Iterator[_Draft]:
    """Yield candidates that three channels have at once, each in a way of its own."""
    for item in local:
        a, b = item.window
        own = slice(slots.first[a], slots.first[b])
        mixing = np.ones((own.stop - own.start, 1)) if item.mixing is None else item.mixing
        n, k = mixing.shape
        each = np.zeros((3, n, 3, k))
        each[range(3), :, range(3)] = mixing
        about = {"interval": item.interval, "shape": item.shape, "mixing": each.reshape(3 * n, -1)}
        index = np.concatenate([part[own] for part in parts])
        yield f"{b - a} segments", item.name, triad, index, about


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
    state, size = rows.state, typical_size(candidate.channels[0].split(".")[0])
    inside = (state.time >= start) & (state.time <= stop)
    shape = size * inside[:, None] * _function(candidate.shape, state.time, start, stop)
    out = []
    for c in map(CHANNELS.index, candidate.channels):
        own = _scaled(state, c)[:, None] if candidate.name == "gain in a window" else 1.0
        out.append(rows.columns(c, shape * own))
    return np.hstack(out)


def segment_columns(rows: Rows, candidate: Candidate) -> FloatArray:
    """Return the (m, s, k) columns of what a candidate says of a window, in each segment alone."""
    assert candidate.interval is not None
    state, size = rows.state, typical_size(candidate.channels[0].split(".")[0])
    shape = size * _function(candidate.shape, state.time, *candidate.interval)
    points = np.arange(len(state.time))
    out = []
    for c in map(CHANNELS.index, candidate.channels):
        own = _scaled(state, c)[:, None] if candidate.name == "gain in a window" else 1.0
        for values in (shape * own).T:
            member = sparse.csr_matrix(
                (values, (points, rows.point_segment)), shape=(len(points), len(rows.interval))
            )
            out.append((rows.functional[c] @ member).toarray())
    return np.stack(out, axis=2)


def _scaled(state: State, c: int) -> FloatArray:
    """Return a channel's own signal (n,), in g or brisk turns."""
    return state.force[:, c] / state.gravity if c < 3 else state.rate[:, c - 3] / FAST


def nearby_windows(rows: Rows, candidate: Candidate) -> Iterator[tuple[float, float]]:
    """Yield the windows, to the segment, that are nearer to a candidate's than to others tried."""
    if candidate.interval is None:
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


def _ripples(rows: Rows, slots: _Slots) -> Iterator[tuple[float, FloatArray]]:
    """Yield how fast a function of gravity's direction varies, and what each slot has of it.

    Waves over one component of the direction; and what acts near one direction only (0).
    """
    count = np.maximum(slots.member.sum(axis=0).A1, 1.0)
    up = (slots.member.T @ rows.state.gravity_direction) / count[:, None]
    for ripple in RIPPLES:
        # Half a sphere of directions: close enough for half a radian of phase.
        axes = _spiral(int(np.ceil(16.0 * ripple**2)))
        for phase in ripple * (axes[axes[:, 2] > 0] @ up.T):
            yield ripple, np.stack((np.cos(phase), np.sin(phase)), axis=1)
    for near in _spiral(64) @ up.T:
        yield 0.0, np.exp(CAP * (near - 1.0))[:, None]


def _spiral(number: int) -> FloatArray:
    """Return unit vectors (n, 3) that cover the sphere evenly: a Fibonacci spiral."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(number)
    z = (2.0 * np.arange(number) + 1.0) / number - 1.0
    flat = np.sqrt(1 - z**2)
    return np.stack((flat * np.cos(turn), flat * np.sin(turn), z), axis=1)


def _smooth(state: State) -> Iterator[tuple[str, FloatArray]]:
    """Yield bases of smooth functions; coefficients fall with order, so that they are smooth."""
    span = max(float(np.ptp(state.time)), 1e-9)
    order = np.arange(1, 9)
    yield "time", np.cos(np.pi * (state.time - state.time[0])[:, None] / span * order) / order
    warmth = state.warmth
    if warmth is not None and np.ptp(warmth) > 0:
        scaled = (warmth - warmth.min()) / np.ptp(warmth)
        yield "temperature", np.cos(np.pi * scaled[:, None] * order[:5]) / order[:5]
    # Of unit length where it shakes, too: powers of 16 g would take the place of any physics.
    yield "direction of gravity", _harmonics(state.gravity_direction)
    if state.mat_ns is not None:
        # A field that is fixed to the room, as the sensor sees it: linear in the attitude.
        yield "orientation", state.mat_ns.reshape(-1, 9)
    speed = np.linalg.norm(_scaled_rates(state), axis=1)
    yield "speed of rotation", np.stack((speed, speed**2, speed**3, np.sqrt(speed)), axis=1)


def _own_rate(state: State, c: int) -> FloatArray:
    """Return the basis of smooth functions of the rate about a channel's axis, (n, 7)."""
    rate = _scaled_rates(state)[:, c % 3]
    odd = (rate, np.abs(rate), rate * np.abs(rate), rate**2, rate**3, rate**4, np.tanh(5 * rate))
    return np.stack(odd, axis=1)


def _scaled_rates(state: State) -> FloatArray:
    """Return rates in brisk turns; where one is brisker, in units of that."""
    return state.rate / max(FAST, float(np.abs(state.rate).max()))


def windows(segments: int) -> Iterator[tuple[int, int]]:
    """Yield ``[a, b)`` of 1, 2, 3, 4, 6, 8, 12 ... segments, at every quarter of their length."""
    lengths = {1} | {n << k for n in (2, 3) for k in range(segments.bit_length())}
    for length in sorted(n for n in lengths if n <= max(segments // 2, 1)):
        for a in range(0, segments - length + 1, max(1, length // 4)):
            yield a, a + length


def _harmonics(direction: FloatArray) -> FloatArray:
    """Return products of a direction's components, degrees 1 to 4, falling with degree."""
    x, y, z = direction.T
    powers = [
        (i, j, k)
        for degree in range(1, 5)
        for i in range(degree + 1)
        for j in range(degree + 1 - i)
        for k in (degree - i - j,)
    ]
    return np.stack([x**i * y**j * z**k / (i + j + k) for i, j, k in powers], axis=1)
