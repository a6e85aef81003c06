"""What a disturbance may follow: time, temperature, direction, rate, and what it reads.

Each basis is (n, k) values at the points of a recording, with coefficients that a prior of unit
variance makes as smooth as nature is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.effects.base import State
from calib.mismatch.hypotheses.windows import FAST
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import FloatArray

RIPPLES = (2.0, 3.0, 4.0, 5.0)
"""How fast a function of one component of gravity's direction varies, rad per unit."""

OWN_RIPPLES = np.arange(6.0, 21.0)
"""The same for an accelerometer's own axis, whose converter may have steps of uneven height."""

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


SMEARED = {"accel": 0.05, "gyro": 0.01}
"""How near to zero (SI) its noise leaves the sign of a signal open."""

LEVEL = "a level of its output, on either side"
"""What has a step there, as a converter that misses codes, follows that."""

LOADS = np.delete(np.linspace(-0.9, 0.9, 19), 9)
SPEEDS = np.concatenate((-np.geomspace(0.8, 0.1, 7), np.geomspace(0.1, 0.8, 7)))
"""Levels, in parts of gravity and of the fastest rate."""


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
