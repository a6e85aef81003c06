"""Honest rivals: what a residual may follow without being physics that we know.

They compete with the catalogue on the same terms. When one wins, the answer is "unexplained: this
channel, this span or regime, follows this", and not the nearest name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import sparse

from calib.effects import effects
from calib.effects.base import State
from calib.mismatch.rows import Rows
from calib.mismatch.score import Candidate, Stack
from calib.recording import CHANNELS
from calib.types import FloatArray

RIVAL = 0.4
"""Prior probability of all rivals together."""

FAST = 3.0
"""A brisk turn by hand, rad/s: what rates are scaled by."""

_KINDS = {
    "bias in a window": 0.2,
    "gain in a window": 0.1,
    "jumps in a window": 0.15,
    "wave in a window": 0.15,
    "time": 0.05,
    "temperature": 0.1,
    "direction of gravity": 0.15,
    "speed of rotation": 0.05,
    "its own rate": 0.05,
}

WINDOWED = ("bias in a window", "gain in a window")
"""Rivals that are one column in a window, whose ends can be moved."""

JUMPS = (4, 64)
"""Segments in a window of jumps, fewest and most: each of its segments has a bias of its own."""

WAVES = 8
"""Segments in a window with a wave, fewest: a wave has a mean, an amplitude and a phase."""

CYCLES = 16.0
"""Periods of a wave within a window, at most; and never less than four segments to a period."""

RIPPLES = (2.0, 3.5, 5.0)
"""How fast a function of one component of gravity's direction varies, rad per unit."""


def add_rivals(stack: Stack, rows: Rows, *, skip: tuple[str, ...] = ()) -> None:
    """Add every rival that these rows can show, with weights that sum to at most `RIVAL`.

    ``skip`` names those that are not tried (``time`` where the clock is wrong).
    """
    found: list[tuple[str, Candidate]] = []
    mixings = _Mixings(rows)
    for c in range(len(CHANNELS)):
        triad = CHANNELS[c].split(".")[0]
        # Beside the bias, a window that is open at one end is a step of it, which has a name.
        step = f"{triad}_bias_step" in effects() and f"{triad}_bias_step" not in skip
        found += _of_channel(stack, rows, c, typical_size(triad), mixings, step=step)
    found = [(part, c) for part, c in found if c.name not in skip]
    # Every kind has its share, each of its parts (one length of window, say) the same of that.
    number = Counter((c.name, part) for part, c in found)
    parts = Counter(name for name, _ in number)
    stack.candidates += [
        replace(c, weight=RIVAL * _KINDS[c.name] / parts[c.name] / number[c.name, part])
        for part, c in found
    ]


def typical_size(triad: str) -> float:
    """Return the size of an unknown disturbance: the median over the catalogue's bias steps."""
    known = effects().get(f"{triad}_bias_step")
    if known is not None:
        return float(known.parameters[0].typical)
    return 0.02 if triad == "accel" else float(np.radians(0.05))


class _Mixings:
    """Waves and ripples of the segments, which the channels share."""

    def __init__(self, rows: Rows) -> None:
        self.waves = {
            (a, b): list(_waves(rows.interval, a, b))
            for a, b in windows(len(rows.interval))
            if b - a >= WAVES
        }
        self.ripples = list(_ripples(rows))


def _of_channel(
    stack: Stack, rows: Rows, c: int, size: float, mixings: _Mixings, *, step: bool
) -> Iterator[tuple[str, Candidate]]:
    """Yield candidates of a channel, each with the part of its kind that it belongs to."""
    state = rows.state
    own = (state.force if c < 3 else state.rate)[:, c % 3]
    member = sparse.csr_matrix(
        (own / (state.gravity if c < 3 else FAST), (np.arange(len(own)), rows.point_segment)),
        shape=(len(own), len(rows.interval)),
    )
    pieces = stack.add(size * rows.pieces[c].toarray())
    gains = stack.add(size * (rows.functional[c] @ member).toarray())
    blank = Candidate("", pieces, 0.0, False, (CHANNELS[c],))
    count = len(rows.interval)
    for a, b in windows(count):
        interval = (float(rows.interval[a, 0]), float(rows.interval[b - 1, 1]))
        window = replace(blank, interval=interval)
        length = f"{b - a} segments"
        if not (step and (a == 0 or b == count)):
            yield (
                length,
                replace(window, name="bias in a window", index=pieces[a:b], summed=True),
            )
        yield length, replace(window, name="gain in a window", index=gains[a:b], summed=True)
        if JUMPS[0] <= b - a <= JUMPS[1] and (b - a).bit_count() == 1:
            yield length, replace(window, name="jumps in a window", index=pieces[a:b])
        for mixing in mixings.waves.get((a, b), ()):
            yield length, replace(window, name="wave in a window", mixing=mixing)
    for name, values in _smooth(state, c):
        index = stack.add(size * rows.columns(c, values))
        yield "smooth", replace(blank, name=name, index=index)
        if name == "direction of gravity":
            # Harmonics come in the order of their degree: 3 + 6 of degrees 1 and 2.
            yield "quadratic", replace(blank, name=name, index=index[:9])
    for mixing in mixings.ripples:
        yield "ripple", replace(blank, name="direction of gravity", mixing=mixing)


def window_columns(
    rows: Rows, candidate: Candidate, intervals: list[tuple[float, float]]
) -> FloatArray:
    """Return the (m, k) columns of a bias or a gain in each of k intervals."""
    c = CHANNELS.index(candidate.channels[0])
    state, size = rows.state, typical_size(candidate.channels[0].split(".")[0])
    values = np.full(len(state.time), size)
    if candidate.name == "gain in a window":
        own = (state.force if c < 3 else state.rate)[:, c % 3]
        values = size * own / (state.gravity if c < 3 else FAST)
    start, stop = np.array(intervals).T
    inside = (state.time[:, None] >= start) & (state.time[:, None] <= stop)
    return rows.columns(c, values[:, None] * inside)


def _waves(interval: FloatArray, a: int, b: int) -> Iterator[FloatArray]:
    """Yield (segments, 3) weights of a mean and a wave in the window ``[a, b)``."""
    middle = interval[a:b].mean(axis=1)
    turns = (middle - interval[a, 0]) / (interval[b - 1, 1] - interval[a, 0])
    for cycles in np.arange(1.0, min(CYCLES, (b - a) / 4) + 0.25, 0.5):
        phase = 2 * np.pi * cycles * turns
        mixing = np.zeros((len(interval), 3))
        mixing[a:b] = np.stack((np.ones(b - a), np.cos(phase), np.sin(phase)), axis=1)
        yield mixing


def _ripples(rows: Rows) -> Iterator[FloatArray]:
    """Yield (segments, 2) weights of waves over one component of gravity's direction."""
    count = np.bincount(rows.point_segment, minlength=len(rows.interval))
    up = np.stack(
        [np.bincount(rows.point_segment, f, len(rows.interval)) for f in rows.state.force.T], axis=1
    ) / (rows.state.gravity * np.maximum(count, 1)[:, None])
    # Half a sphere of directions, a Fibonacci spiral of about 25 degrees' spacing.
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(32)
    z = (np.arange(32) + 0.5) / 32
    axes = np.stack((np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z), axis=1)
    for axis in axes:
        for ripple in RIPPLES:
            phase = ripple * (up @ axis)
            yield np.stack((np.cos(phase), np.sin(phase)), axis=1)


def _smooth(state: State, c: int) -> Iterator[tuple[str, FloatArray]]:
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
    rates = state.rate / max(FAST, float(np.abs(state.rate).max()))
    speed = np.linalg.norm(rates, axis=1)
    yield "speed of rotation", np.stack((speed, speed**2, speed**3, np.sqrt(speed)), axis=1)
    rate = rates[:, c % 3]
    odd = (rate, np.abs(rate), rate * np.abs(rate), rate**2, rate**3, rate**4, np.tanh(5 * rate))
    yield "its own rate", np.stack(odd, axis=1)


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
