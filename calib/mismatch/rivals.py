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
from calib.types import FloatArray, IntArray

RIVAL = 0.4
"""Prior probability of all rivals together."""

FAST = 3.0
"""A brisk turn by hand, rad/s: what rates are scaled by."""

_KINDS = {
    "bias in a window": 0.25,
    "gain in a window": 0.1,
    "jumps in a window": 0.15,
    "time": 0.1,
    "temperature": 0.1,
    "direction of gravity": 0.1,
    "speed of rotation": 0.1,
    "its own rate": 0.1,
}


def add_rivals(stack: Stack, rows: Rows, *, skip: tuple[str, ...] = ()) -> None:
    """Add every rival that these rows can show, with weights that sum to at most `RIVAL`.

    ``skip`` names those that are not tried (``time`` where the clock is wrong).
    """
    found: list[Candidate] = []
    for c in range(len(CHANNELS)):
        found += _of_channel(stack, rows, c, typical_size(CHANNELS[c].split(".")[0]))
    found = [c for c in found if c.name not in skip]
    number = Counter(c.name for c in found)
    stack.candidates += [replace(c, weight=RIVAL * _KINDS[c.name] / number[c.name]) for c in found]


def typical_size(triad: str) -> float:
    """Return the size of an unknown disturbance: the median over the catalogue's bias steps."""
    known = effects().get(f"{triad}_bias_step")
    if known is not None:
        return float(known.parameters[0].typical)
    return 0.02 if triad == "accel" else float(np.radians(0.05))


def _of_channel(stack: Stack, rows: Rows, c: int, size: float) -> Iterator[Candidate]:
    state = rows.state
    own = (state.force if c < 3 else state.rate)[:, c % 3]
    member = sparse.csr_matrix(
        (own / (state.gravity if c < 3 else FAST), (np.arange(len(own)), rows.point_segment)),
        shape=(len(own), len(rows.interval)),
    )
    pieces = stack.add(size * rows.pieces[c].toarray())
    gains = stack.add(size * (rows.functional[c] @ member).toarray())

    def make(name: str, index: IntArray, *, summed: bool = False) -> Candidate:
        return Candidate(name, index, 0.0, False, (CHANNELS[c],), summed)

    for a, b in windows(len(rows.interval)):
        interval = (float(rows.interval[a, 0]), float(rows.interval[b - 1, 1]))
        found = [
            make("bias in a window", pieces[a:b], summed=True),
            make("gain in a window", gains[a:b], summed=True),
        ]
        # Jumps: every segment of the window has a bias of its own.
        if 2 <= b - a <= 16:
            found.append(make("jumps in a window", pieces[a:b]))
        yield from (replace(item, interval=interval) for item in found)
    for name, values in _smooth(state, c):
        yield make(name, stack.add(size * rows.columns(c, values)))


def _smooth(state: State, c: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield bases of smooth functions; coefficients fall with order, so that they are smooth."""
    span = max(float(np.ptp(state.time)), 1e-9)
    order = np.arange(1, 9)
    yield "time", np.cos(np.pi * (state.time - state.time[0])[:, None] / span * order) / order
    warmth = state.warmth
    if warmth is not None and np.ptp(warmth) > 0:
        scaled = (warmth - warmth.min()) / np.ptp(warmth)
        yield "temperature", np.cos(np.pi * scaled[:, None] * order[:5]) / order[:5]
    yield "direction of gravity", _harmonics(state.force / state.gravity)
    speed = np.linalg.norm(state.rate, axis=1) / FAST
    yield "speed of rotation", np.stack((speed, speed**2, speed**3, np.sqrt(speed)), axis=1)
    rate = state.rate[:, c % 3] / FAST
    odd = (rate, np.abs(rate), rate * np.abs(rate), rate**2, rate**3, rate**4, np.tanh(5 * rate))
    yield "its own rate", np.stack(odd, axis=1)


def windows(segments: int) -> Iterator[tuple[int, int]]:
    """Yield ``[a, b)`` of dyadic length, at every half length: 1, 2, 4 ... segments."""
    length = 1
    while length <= segments // 2:
        step = max(1, length // 2)
        for a in range(0, segments - length + 1, step):
            yield a, a + length
        length *= 2


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
