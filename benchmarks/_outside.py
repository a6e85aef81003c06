"""Disturbances that no catalogue has, for `concealed.py`, and who could have found them.

Each kind has a channel and a window, or acts throughout; what else it is, is drawn at random. A
case counts as detectable if one who knows the kind, the channel, the window and the noise, but not
what was drawn, would hold it for 100 times more probable than noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from calib.effects.base import State
from calib.mismatch.noise.noise import Whitener
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS

Disturbance = Callable[[State], dict[str, np.ndarray]]

DRAWS = 1000
"""Ways in which the rest of a disturbance may have been drawn."""

SURE = float(np.log(100.0))
"""Log evidence at which one who knows the kind and the place has detected it."""


@dataclass(frozen=True)
class Case:
    """One disturbance: what it adds, where, and what it might have been instead.

    Parameters
    ----------
    add : function of State
        By channel, up to its size.
    interval : (start, stop), s
    other : function of a generator
        Returns another of this kind, on the same channel and in the same window.
    parts : function of a generator, optional
        Where it is a sum of many: returns (disturbances, mean and variance of their sizes).
    fast : bool
        Too fast for rows: it is sized by the noise of a sample.
    """

    add: Disturbance
    interval: tuple[float, float]
    other: Callable[[np.random.Generator], Disturbance]
    parts: Callable[[np.random.Generator], tuple[list[Disturbance], float, float]] | None = None
    fast: bool = False


def detectable(case: Case, rows: Rows, whitener: Whitener, column: np.ndarray, size: float) -> bool:
    """Return whether one who knows the kind, the place and the noise would have detected it.

    `column` is what was added to the rows of the clean recording, up to `size`. What is faster than
    the rows fills thousands of samples with as much as their noise.
    """
    if case.fast:
        return True
    y = whitener.project(rows.residual + size * column)
    rng = np.random.default_rng(1)

    def seen(add: Disturbance) -> np.ndarray:
        return size * whitener.project(rows.column(add(rows.state)))

    if case.parts is None:
        made = [seen(case.other(rng)) for _ in range(DRAWS)]
        values = [float(y @ z - 0.5 * z @ z) for z in made]
    else:
        values = []
        for _ in range(DRAWS // 50):
            pieces, mean, variance = case.parts(rng)
            z = np.stack([seen(piece) for piece in pieces], axis=1)
            # y ~ N(mean sum(z), 1 + variance z z') against N(0, 1), by the k sizes.
            left = y - mean * z.sum(axis=1)
            inner = np.eye(z.shape[1]) / variance + z.T @ z
            match = z.T @ left
            gain = 0.5 * float(y @ y - left @ left + match @ np.linalg.solve(inner, match))
            values.append(gain - 0.5 * float(np.linalg.slogdet(variance * inner)[1]))
    return bool(logsumexp(values) - np.log(len(values)) > SURE)


def _window(rows: Rows, rng: np.random.Generator) -> tuple[float, float]:
    start, stop = rows.interval[0, 0], rows.interval[-1, 1]
    length = rng.uniform(0.15, 0.4) * (stop - start)
    begin = rng.uniform(start, stop - length)
    return float(begin), float(begin + length)


def whole(rows: Rows) -> tuple[float, float]:
    """Return when a recording begins and ends, s."""
    return float(rows.interval[0, 0]), float(rows.interval[-1, 1])


def _interference(rows: Rows, rng: np.random.Generator) -> Case:
    a, b = _window(rows, rng)
    channel = str(rng.choice(CHANNELS))

    def draw(rng: np.random.Generator) -> Disturbance:
        period, phase = rng.uniform(20, 60), rng.uniform(0, 6)

        def add(state: State) -> dict[str, np.ndarray]:
            inside = (state.time >= a) & (state.time < b)
            return {channel: inside * (1 + np.sin(2 * np.pi * state.time / period + phase))}

        return add

    return Case(draw(rng), (a, b), draw)


def _loose_connector(rows: Rows, rng: np.random.Generator) -> Case:
    a, b = _window(rows, rng)
    channel = str(rng.choice(CHANNELS))
    edges = np.arange(a, b, 4.0)

    def held(values: np.ndarray) -> Disturbance:
        def add(state: State) -> dict[str, np.ndarray]:
            inside = (state.time >= a) & (state.time < b)
            return {channel: inside * values[np.searchsorted(edges, state.time)]}

        return add

    def draw(rng: np.random.Generator) -> Disturbance:
        return held(rng.normal(size=len(edges) + 1))

    def parts(rng: np.random.Generator) -> tuple[list[Disturbance], float, float]:
        return [held(unit) for unit in np.eye(len(edges) + 1)], 0.0, 1.0

    return Case(draw(rng), (a, b), draw, parts)


def _gain_window(rows: Rows, rng: np.random.Generator) -> Case:
    a, b = _window(rows, rng)
    channel = str(rng.choice(CHANNELS))
    k = CHANNELS.index(channel)

    def add(state: State) -> dict[str, np.ndarray]:
        own = (state.force if k < 3 else state.rate)[:, k % 3]
        return {channel: ((state.time >= a) & (state.time < b)) * own}

    return Case(add, (a, b), lambda _: add)


def _magnet(rows: Rows, rng: np.random.Generator) -> Case:
    """A magnet on a spring, which nods: it follows gravity, and no centrifugal force."""
    channel = str(rng.choice(CHANNELS[3:]))

    def draw(rng: np.random.Generator) -> Disturbance:
        order = rng.normal(size=3)

        def add(state: State) -> dict[str, np.ndarray]:
            phase = 4 * (state.gravity_direction @ order) / np.linalg.norm(order)
            return {channel: np.sin(phase + 1.0)}

        return add

    return Case(draw(rng), whole(rows), draw)


def _speed_crosstalk(rows: Rows, rng: np.random.Generator) -> Case:
    channel = str(rng.choice(CHANNELS[:3]))

    def add(state: State) -> dict[str, np.ndarray]:
        return {channel: np.linalg.norm(state.rate, axis=1)}

    return Case(add, whole(rows), lambda _: add)


def _supply_dips(rows: Rows, rng: np.random.Generator) -> Case:
    """Pulses at random moments, on two channels of a triad at once."""
    a, b = _window(rows, rng)
    first, two = 3 * int(rng.integers(2)), rng.choice(3, 2, replace=False)

    def made(moments: np.ndarray, height: np.ndarray, ratio: float, decay: float) -> Disturbance:
        def add(state: State) -> dict[str, np.ndarray]:
            since = state.time[:, None] - moments
            pulses = np.where(since >= 0, np.exp(-np.maximum(since, 0) / decay), 0.0) @ height
            pulses *= state.time < b
            return {CHANNELS[first + two[0]]: pulses, CHANNELS[first + two[1]]: ratio * pulses}

        return add

    number = max(3, int((b - a) / 6))

    def form(rng: np.random.Generator) -> tuple[float, float]:
        return float(rng.uniform(0.4, 1.0) * rng.choice([-1, 1])), float(rng.uniform(1.0, 3.0))

    def draw(rng: np.random.Generator) -> Disturbance:
        ratio, decay = form(rng)
        moments = np.sort(rng.uniform(a, b, number))
        return made(moments, rng.exponential(1.0, len(moments)), ratio, decay)

    def parts(rng: np.random.Generator) -> tuple[list[Disturbance], float, float]:
        # Pulses that may begin at each of many moments, of the same mean and covariance.
        ratio, decay = form(rng)
        moments = np.arange(a, b, 1.0)
        share, one = number / len(moments), np.ones(1)
        pieces = [made(np.array([m]), one, ratio, decay) for m in moments]
        return pieces, share, 2.0 * share

    return Case(draw(rng), (a, b), draw, parts)


def _creep(rows: Rows, rng: np.random.Generator) -> Case:
    """A preload that creeps and snaps back, once or a few times."""
    a, b = _window(rows, rng)
    channel = str(rng.choice(CHANNELS))

    def draw(rng: np.random.Generator) -> Disturbance:
        times = int(rng.integers(1, 4))

        def add(state: State) -> dict[str, np.ndarray]:
            part = (state.time - a) / (b - a)
            return {channel: ((part >= 0) & (part < 1)) * ((part * times) % 1.0)}

        return add

    return Case(draw(rng), (a, b), draw)


def _room_field(rows: Rows, rng: np.random.Generator) -> Case:
    """A field that is fixed to the room, and saturates what it acts on."""
    channel = str(rng.choice(CHANNELS[3:]))

    def draw(rng: np.random.Generator) -> Disturbance:
        field, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))

        def add(state: State) -> dict[str, np.ndarray]:
            return {channel: np.tanh(3 * np.einsum("nij,i,j->n", state.mat_ns, field, axis))}

        return add

    return Case(draw(rng), whole(rows), draw)


def _passing_magnet(rows: Rows, rng: np.random.Generator) -> Case:
    """A dipole that is carried past, back and forth: each axis of a triad feels it its own way."""
    a, b = _window(rows, rng)
    triad = CHANNELS[:3] if rng.random() < 0.5 else CHANNELS[3:]

    passes = 0.5 * (a + b) + 0.25 * (b - a) * np.array([-1.0, 1.0])

    def made(axes: np.ndarray, width: float) -> Disturbance:
        def add(state: State) -> dict[str, np.ndarray]:
            way = (state.time[:, None] - passes) / width
            inside = (state.time >= a) & (state.time < b)
            near = inside[:, None] / (1 + way**2) ** 1.5
            felt = near.sum(axis=1)[:, None] * axes[0] + (near * way).sum(axis=1)[:, None] * axes[1]
            return dict(zip(triad, felt.T, strict=True))

        return add

    def width(rng: np.random.Generator) -> float:
        return float(rng.uniform(0.08, 0.16)) * (b - a)

    def draw(rng: np.random.Generator) -> Disturbance:
        return made(rng.normal(size=(2, 3)), width(rng))

    def parts(rng: np.random.Generator) -> tuple[list[Disturbance], float, float]:
        wide = width(rng)
        return [made(unit.reshape(2, 3), wide) for unit in np.eye(6)], 0.0, 1.0

    return Case(draw(rng), (a, b), draw, parts)


def _hysteresis(rows: Rows, rng: np.random.Generator) -> Case:
    """A proof mass that has play, or that friction holds back: it remembers how it was loaded."""
    channel = str(rng.choice(CHANNELS[:3]))
    axis = CHANNELS.index(channel)

    def draw(rng: np.random.Generator) -> Disturbance:
        stuck, width = rng.random() < 0.5, float(rng.uniform(0.05, 0.5))

        def add(state: State) -> dict[str, np.ndarray]:
            load = state.force[:, axis] / state.gravity
            out, before = np.zeros(len(load)), load[0]
            for k in range(1, len(load)):
                lag = out[k - 1] + load[k] - before
                before = load[k]
                if stuck:
                    out[k] = min(max(lag, -width), width)
                else:
                    out[k] = np.sign(load[k]) if abs(load[k]) > width else out[k - 1]
            return {channel: out}

        return add

    return Case(draw(rng), whole(rows), draw)


def _aliased_motor(rows: Rows, rng: np.random.Generator) -> Case:
    """A motor's hum, far above the rate of samples, whose speed wanders: it aliases anywhere."""
    a, b = _window(rows, rng)
    channel = str(rng.choice(CHANNELS))
    speed, wander, phase = rng.uniform(120, 400), rng.uniform(0.01, 0.04), rng.uniform(0, 6, 2)

    def add(state: State) -> dict[str, np.ndarray]:
        slow = 2 * np.pi * state.time / 40.0
        turn = (
            2 * np.pi * speed * (state.time + 40.0 / (2 * np.pi) * wander * np.sin(slow + phase[0]))
        )
        inside = (state.time >= a) & (state.time < b)
        return {channel: inside * np.sqrt(2.0) * np.sin(turn + phase[1])}

    return Case(add, (a, b), lambda _: add, fast=True)


def _slow_hum(rows: Rows, rng: np.random.Generator) -> Case:
    """Mains that are sampled at nearly their own rate, or a pump: a swing in 0.2 to 5 s."""
    a, b = _window(rows, rng) if rng.random() < 0.5 else whole(rows)
    channel = str(rng.choice(CHANNELS))
    frequency, phase = np.exp(rng.uniform(np.log(0.2), np.log(5.0))), rng.uniform(0, 6)

    def add(state: State) -> dict[str, np.ndarray]:
        inside = (state.time >= a) & (state.time < b)
        swing = np.sqrt(2.0) * np.sin(2 * np.pi * frequency * state.time + phase)
        return {channel: inside * swing}

    return Case(add, (a, b), lambda _: add, fast=True)


def _brief_shorts(rows: Rows, rng: np.random.Generator) -> Case:
    """A contact that closes to a constant for some hundredths of a second, every other second."""
    a, b = _window(rows, rng)
    channel = str(rng.choice(CHANNELS))
    moments = np.sort(rng.uniform(a, b, int((b - a) / 2)))
    lengths, sign = rng.uniform(0.02, 0.3, len(moments)), rng.choice([-1.0, 1.0])

    def add(state: State) -> dict[str, np.ndarray]:
        k = np.searchsorted(moments, state.time, side="right") - 1
        inside = (k >= 0) & (state.time < moments[k] + lengths[k]) & (state.time < b)
        # As much on average over the window as a hum of one.
        return {channel: sign * inside / np.sqrt(lengths.sum() / (b - a))}

    return Case(add, (a, b), lambda _: add, fast=True)


OUTSIDE: dict[str, Callable[[Rows, np.random.Generator], Case]] = {
    "interference": _interference,
    "loose_connector": _loose_connector,
    "gain_window": _gain_window,
    "magnet": _magnet,
    "speed_crosstalk": _speed_crosstalk,
    "supply_dips": _supply_dips,
    "creep": _creep,
    "room_field": _room_field,
    "passing_magnet": _passing_magnet,
    "hysteresis": _hysteresis,
    "aliased_motor": _aliased_motor,
    "slow_hum": _slow_hum,
    "brief_shorts": _brief_shorts,
}
