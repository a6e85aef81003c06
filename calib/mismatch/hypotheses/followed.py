"""What a disturbance may follow: time, temperature, direction, rate, and what came before.

Each basis is (n, k) values at the points of a recording, with coefficients that a prior of unit
variance makes as smooth as nature is.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from calib.effects.base import State
from calib.mismatch.hypotheses.windows import FAST
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

RIPPLES = (2.0, 3.0, 4.0, 5.0)
"""How fast a function of one component of gravity's direction varies, rad per unit."""

OWN_RIPPLES = np.arange(6.0, 21.0)
"""The same for an accelerometer's own axis, whose converter may have steps of uneven height."""

MEMORIES = np.array([0.5, 2.0, 8.0])
"""How long what creeps remembers poses, in times from one to the next."""

PLAY = (0.0, 0.1, 0.2, 0.3, 0.4)
"""Load in g, beyond which what has play goes to the other side."""

LAGS = (0.05, 0.1, 0.2, 0.4)
"""Load in g, by which what is elastic lags behind at most."""

FORGOTTEN = 500.0
"""Times the memory after which nothing is left."""

LOADED = "its load before: play, or friction"
"""What has play, or sticks, depends on how it was loaded before."""

CAP = 6.0
"""How steeply what acts near one direction only falls off: to a half at 28 degrees."""


def ripples(up: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Yield how fast a function of gravity's direction varies, and what each slot has of it.

    Waves over one component of the direction; and what acts near one direction only (0).
    """
    for ripple in RIPPLES:
        for phase in ripple * (axes(ripple) @ up.T):
            yield ripple, wave(phase)
    for near in axes(0.0) @ up.T:
        yield 0.0, np.exp(CAP * (near - 1.0))[:, None]


def wave(phase: FloatArray) -> FloatArray:
    """Return a wave of any phase over (n,) phases, (n, 2)."""
    return np.stack((np.cos(phase), np.sin(phase)), axis=1)


def axes(ripple: float) -> FloatArray:
    """Return the unit vectors along which a ripple is tried, (n, 3)."""
    if not ripple:
        return _spiral(64)
    # Half a sphere of directions: close enough for half a radian of phase.
    sphere = _spiral(int(np.ceil(16.0 * ripple**2)))
    return np.asarray(sphere[sphere[:, 2] > 0])


def _spiral(number: int) -> FloatArray:
    """Return unit vectors (n, 3) that cover the sphere evenly: a Fibonacci spiral."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(number)
    z = (2.0 * np.arange(number) + 1.0) / number - 1.0
    flat = np.sqrt(1 - z**2)
    return np.stack((flat * np.cos(turn), flat * np.sin(turn), z), axis=1)


def smooth(state: State) -> Iterator[tuple[str, FloatArray]]:
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
    speed = np.linalg.norm(scaled_rates(state), axis=1)
    yield "speed of rotation", np.stack((speed, speed**2, speed**3, np.sqrt(speed)), axis=1)
    both = state.gravity_direction[:, :, None] * scaled_rates(state)[:, None]
    yield "rate and direction of gravity", both.reshape(-1, 9)
    yield "rate and direction of gravity", state.gravity_direction * speed[:, None]


def history(rows: Rows) -> Iterator[tuple[str, FloatArray]]:
    """Yield what came before: the direction of gravity in the last poses, and the last turn.

    What sticks remembers the last one, or which way its turn was; what creeps forgets it slowly,
    and has followed by so much less.
    """
    rests = np.flatnonzero(rows.is_rest)
    if len(rests) < 2:
        return
    state, segment, number = rows.state, rows.point_segment, len(rows.interval)
    count = np.maximum(np.bincount(segment, minlength=number), 1)[:, None]
    up, rate = (
        np.stack([np.bincount(segment, v, number) for v in signal.T], axis=1) / count
        for signal in (state.gravity_direction, state.rate)
    )
    turn = rate * np.ptp(rows.interval, axis=1)[:, None]
    turn /= np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1.0)
    pose = poses_at(rows)
    for name, what in (
        ("the pose before", up[rests[:-1]]),
        ("the turn before", turn[rests[1:] - 1]),
        ("the turn before", np.sign(turn[rests[1:] - 1])),
    ):
        # Nothing was before the first rest.
        yield name, np.vstack((np.zeros(3), what))[pose]
    for memory in MEMORIES * float(np.median(np.diff(rows.interval[rests].mean(axis=1)))):
        up = state.gravity_direction
        yield "the pose before", up - lately(rows, up, memory)


def poses_at(rows: Rows) -> IntArray:
    """Return the number of the rest that each point is in, or nearest to: turns have halves."""
    start, stop = rows.interval[rows.is_rest].T
    return np.searchsorted(0.5 * (stop[:-1] + start[1:]), rows.state.time, side="right")


def lately(rows: Rows, signal: FloatArray, memory: float) -> FloatArray:
    """Return a signal (n, k) as what creeps still knows it, with a `memory` in seconds.

    A low-pass of first order, exact where the signal stays: ``memory dx/dt = signal - x``.
    """
    time, out = rows.state.time, np.empty_like(signal)
    ends = np.searchsorted(rows.point_segment, np.arange(len(rows.interval) + 1)).tolist()
    known, before = signal[0], float(time[0])
    for a, b in pairwise(ends):
        if a == b:
            continue
        # Of what was so long ago nothing is known.
        grown = np.exp(np.minimum((time[a:b] - before) / memory, FORGOTTEN))[:, None]
        felt = np.cumsum(np.diff(grown, axis=0, prepend=1.0) * signal[a:b], axis=0)
        out[a:b] = (known + felt) / grown
        known, before = out[b - 1], float(time[b - 1])
    return out


def remembered(rows: Rows, c: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield what a channel may remember of how its axis was loaded before, (n, 1).

    What has play lies on the side that it was last loaded to, if by enough; where it sticks in a
    turn, on that of the pose before. What is elastic, with friction, lags behind its load, or goes
    by the way that it came. A turn tells as much of it as the rests.
    """
    if np.count_nonzero(rows.is_rest) < 2:
        return
    load = rows.state.force[:, c % 3] / rows.state.gravity
    for least in PLAY:
        yield LOADED, side_of(load, least)[:, None]
    for most in LAGS:
        yield LOADED, lag_of(load, most)[:, None] / most
    total = np.bincount(rows.point_segment, load, len(rows.is_rest))[rows.is_rest]
    count = np.bincount(rows.point_segment, minlength=len(rows.is_rest))[rows.is_rest]
    mean = total / np.maximum(count, 1)
    for side in (mean[:-1], np.diff(mean)):
        yield LOADED, np.append(0.0, np.sign(side))[poses_at(rows)][:, None]


def side_of(load: FloatArray, least: float) -> FloatArray:
    """Return the side (n,) that something was last loaded to, by more than the least it takes."""
    beyond = np.abs(load) > least
    last = np.maximum.accumulate(np.where(beyond, np.arange(len(load)), -1))
    return np.where(last < 0, 0.0, np.sign(load)[last])


def lag_of(load: FloatArray, most: float) -> FloatArray:
    """Return how far something is behind its load (n,), by so much at most.

    The stop of Prandtl's model [1]_, from one reversal of the load to the next.

    References
    ----------
    .. [1] Visintin, "Differential Models of Hysteresis", Springer 1994, ch. III (play and stop).
    """
    step = np.diff(load)
    moved = np.flatnonzero(step)
    if not len(moved):
        return np.zeros(len(load))
    turned = moved[1:][step[moved[1:]] * step[moved[:-1]] < 0]
    ends = np.concatenate(([0], turned))
    lag = [0.0]
    for change in np.diff(load[ends]).tolist():
        lag.append(min(max(lag[-1] + change, -most), most))
    piece = np.searchsorted(ends, np.arange(len(load)), side="right") - 1
    return np.asarray(np.clip(np.array(lag)[piece] + load - load[ends][piece], -most, most))


SMEARED = {"accel": 0.05, "gyro": 0.01}
"""How near to zero (SI) its noise leaves the sign of a signal open."""

LEVEL = "a level of its output, on either side"
"""What has a step there, as a converter that misses codes, follows that."""

LOADS = np.delete(np.linspace(-0.9, 0.9, 19), 9)
SPEEDS = np.concatenate((-np.geomspace(0.8, 0.1, 7), np.geomspace(0.1, 0.8, 7)))
"""Levels, in parts of gravity and of the fastest rate."""

FORGETS = np.geomspace(0.5, 8.0, 5)
"""s in which a gyroscope forgets a turn."""

LATE = np.geomspace(10.0, 160.0, 5)
"""s by which what follows a temperature is late."""

PASSES = np.geomspace(2.0, 128.0, 7)
"""Time constants of high-passes, s."""


def sign_of(rows: Rows, c: int) -> FloatArray:
    """Return the sign of what a channel reads, (n, 1): what is cut towards zero goes by that."""
    signal = rows.state.force if c < 3 else rows.state.rate
    reads = signal[:, c % 3] + rows.offset[c]
    return np.asarray(np.tanh(reads[:, None] / SMEARED[CHANNELS[c].split(".")[0]]))


def past_levels(rows: Rows, c: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield on which side of a level a channel reads, (n, 1): codes that are missing, a kink.

    Of an accelerometer every tenth of gravity, of a gyroscope parts of its fastest rate; that of
    zero is its sign.
    """
    signal = (rows.state.force if c < 3 else rows.state.rate)[:, c % 3]
    most = rows.state.gravity if c < 3 else float(np.abs(signal).max(initial=0.0))
    smeared = SMEARED[CHANNELS[c].split(".")[0]]
    for level in (LOADS if c < 3 else SPEEDS).tolist():
        reads = signal + rows.offset[c] - level * most
        yield LEVEL, np.tanh(reads[:, None] / smeared)


def warmed(state: State, c: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield what a channel may feel of gravity, or of turns about other axes, as it is warm.

    But for what has names: an accelerometer's own axis in proportion.
    """
    warmth = state.warmth
    if warmth is None or not np.ptp(warmth) > 0:
        return
    scaled = ((warmth - warmth.mean()) / np.ptp(warmth))[:, None]
    up = state.gravity_direction
    felt = np.delete(up, c, axis=1) if c < 3 else up
    yield "temperature and direction of gravity", scaled * felt
    i, j = np.triu_indices(3)
    yield "temperature and direction of gravity", scaled * up[:, i] * up[:, j]
    if c >= 3:
        yield (
            "temperature and rate about the other axes",
            scaled * np.delete(scaled_rates(state), c % 3, axis=1),
        )


def after_turns(rows: Rows, c: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield what a channel may have after each turn, while it fades, (n, k).

    Once the same after all of them, and once as the turn was about its axis, either way or not. And
    what a high-pass takes away: turns go through it while they last, and what it let go comes back.
    """
    state = rows.state
    rests = np.flatnonzero(rows.is_rest)
    if state.since_turn is None or state.turning is None or len(rests) < 2:
        return
    segment, number = rows.point_segment, len(rows.interval)
    rate = scaled_rates(state)[:, c % 3]
    most, least = np.zeros((2, number))
    np.maximum.at(most, segment, rate)
    np.minimum.at(least, segment, rate)
    peak = np.where(most > -least, most, least)
    # Nothing was before the first rest.
    last = np.zeros(number)
    last[rests[1:]] = peak[rests[1:] - 1]
    turned = np.zeros(number)
    turned[rests[1:]] = 1.0
    own = np.stack((turned, last, np.abs(last)), axis=1)[segment]
    own[state.turning] = 0.0
    for memory in FORGETS.tolist():
        yield "time since the last turn", np.exp(-state.since_turn / memory)[:, None] * own
    for memory in PASSES.tolist():
        yield "time since the last turn", lately(rows, scaled_rates(state)[:, [c % 3]], memory)


def lagging(rows: Rows) -> Iterator[tuple[str, FloatArray]]:
    """Yield what follows a temperature late, (n, 1): its thermometer is not where the sensor is."""
    warmth = rows.state.warmth
    if warmth is None or not np.ptp(warmth) > 0:
        return
    for memory in LATE.tolist():
        yield "temperature", lately(rows, warmth[:, None], memory) / np.ptp(warmth)


def of_use(rows: Rows) -> Iterator[tuple[str, FloatArray]]:
    """Yield what any channel may have of how much the sensor was turned of late, (n, 1)."""
    if not rows.is_rest.any() or rows.is_rest.all():
        return
    speed = np.linalg.norm(scaled_rates(rows.state), axis=1, keepdims=True)
    for memory in PASSES.tolist():
        yield "time since the last turn", lately(rows, speed, memory)


HARDLY = 0.03
"""Of the fastest turn, what an axis shows that lies askew by two degrees and does not turn."""


def own_rate(state: State, c: int) -> FloatArray:
    """Return the basis of smooth functions of the rate about a channel's axis, (n, 7).

    Of a gyroscope's axis that hardly turned that is nothing: the rate is what it shows of others.
    """
    rates = scaled_rates(state)
    most = np.abs(rates).max(axis=0)
    rate = rates[:, c % 3] if c < 3 or most[c % 3] > HARDLY * most.max() else 0.0 * rates[:, 0]
    size, square = np.abs(rate), np.square(rate)
    odd = (rate, size, rate * size, square, square * rate, square**2, np.tanh(5 * rate))
    return np.stack(odd, axis=1)


def other_rates(state: State, c: int) -> FloatArray:
    """Return what a channel may see of the rates about the other axes, (n, k).

    What a gyroscope sees of them in proportion is its misalignment, and of two of them their
    product is one of rates. Of an accelerometer's it is squares, which are a force on it somewhere.
    """
    other = np.delete(scaled_rates(state), c % 3, axis=1)
    size = np.abs(other)
    if c < 3:
        return np.hstack((other, size, other[:, :1] * other[:, 1:]))
    return np.hstack((size, size**2, size**3, other * size))


def paired_rates(state: State, c: int) -> FloatArray:
    """Return what a channel may see of its own rate and another's together, (n, 4).

    But for their product, which has names.
    """
    rates = scaled_rates(state)
    own, other = rates[:, [c % 3]], np.delete(rates, c % 3, axis=1)
    return np.hstack((own * np.abs(other), np.abs(own) * other))


def scaled_rates(state: State) -> FloatArray:
    """Return rates in brisk turns; where one is brisker, in units of that."""
    return state.rate / max(FAST, float(np.abs(state.rate).max()))


def _harmonics(direction: FloatArray) -> FloatArray:
    """Return products of a direction's components, degrees 1 to 4, falling with degree."""
    power = np.ones((5, *direction.T.shape))
    power[1:] = np.cumprod(np.broadcast_to(direction.T, power[1:].shape), axis=0)
    powers = [
        (i, j, k)
        for degree in range(1, 5)
        for i in range(degree + 1)
        for j in range(degree + 1 - i)
        for k in (degree - i - j,)
    ]
    each = [power[i, 0] * power[j, 1] * power[k, 2] / (i + j + k) for i, j, k in powers]
    return np.stack(each, axis=1)
