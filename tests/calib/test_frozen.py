"""A channel that stands still for a few samples of a turn, and what does so without a fault."""

from __future__ import annotations

import numpy as np
import pytest

from calib.frozen import find_frozen
from calib.types import BoolArray, FloatArray

RNG = np.random.default_rng
LENGTH, PERIOD, TURN = 40_000, 1000, 200


def log(noise: float, *, count: float = 1.0, seed: int = 1) -> tuple[FloatArray, BoolArray]:
    """Return channels (n, 6) of rests and turns in `count`, and where they move."""
    time = np.arange(LENGTH)
    moving = time % PERIOD >= PERIOD - TURN
    phase = np.pi * (time % PERIOD - (PERIOD - TURN)) / TURN
    shape = LENGTH // PERIOD, 6
    size = (RNG(seed).choice([-1, 1], shape) * RNG(seed).uniform(1000, 3000, shape))[time // PERIOD]
    turning = np.where(moving, np.sin(phase) ** 3, 0.0)[:, None] * size
    values = turning + RNG(seed + 1).normal(0, noise, (LENGTH, 6)) + RNG(3).uniform(0, 1, 6)
    return count * np.round(values / count), moving


def found(
    values: FloatArray, moving: BoolArray, *, clipped: BoolArray | None = None
) -> list[tuple[int, int, int]]:
    none = np.zeros(values.shape, bool)
    known = none[:, 0]
    return find_frozen(values, moving, clipped=none if clipped is None else clipped, known=known)


def steepest(values: FloatArray, channel: int, turn: int) -> int:
    """Return where a channel changes fastest in one turn."""
    begin = turn * PERIOD + PERIOD - TURN
    return begin + int(np.argmax(np.abs(np.diff(values[begin : begin + TURN], axis=0)[:, channel])))


@pytest.mark.parametrize(("noise", "length"), [(3.0, 12), (10.0, 8), (100.0, 6)])
def test_a_channel_that_keeps_its_value_in_a_turn_is_frozen(noise: float, length: int) -> None:
    values, moving = log(noise)
    first = steepest(values, 4, 7)
    values[first : first + length, 4] = values[first, 4]
    assert found(values, moving) == [(4, first, first + length)]


def test_a_channel_that_reads_nothing_in_two_turns_is_frozen() -> None:
    values, moving = log(4.0)
    for turn in (3, 20):
        first = turn * PERIOD + PERIOD - TURN // 2
        values[first : first + 6, 5] = 0.0
    assert [c for c, *_ in found(values, moving)] == [5, 5]


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 0.7, 1.5, 4.0, 50.0])
def test_rounding_freezes_nothing(noise: float) -> None:
    for seed in range(8):
        assert not found(*log(noise, seed=seed))


@pytest.mark.parametrize("times", [2, 5])
def test_a_triad_that_is_read_faster_than_it_measures_is_not_frozen(times: int) -> None:
    values, moving = log(20.0)
    values[:, 3:] = np.repeat(values[::times, 3:], times, axis=0)[: len(values)]
    assert not found(values, moving)


def test_a_triad_that_is_read_a_little_faster_than_it_measures_is_not_frozen() -> None:
    values, moving = log(20.0)
    again = RNG(5).choice(len(values) - 1, len(values) // 50, replace=False) + 1
    values[again, :3] = values[again - 1, :3]
    assert not found(values, moving)


def test_a_channel_at_its_limit_is_not_frozen() -> None:
    values, moving = log(4.0)
    limit = 0.7 * np.abs(values).max()
    cut = np.clip(values, -limit, limit)
    assert not found(cut, moving)
    assert not found(cut, moving, clipped=np.abs(cut) >= limit)


def test_a_deadband_freezes_nothing() -> None:
    values, moving = log(4.0)
    assert not found(np.where(np.abs(values) < 20.0, 0.0, values), moving)


def test_a_log_of_few_samples_freezes_nothing() -> None:
    values, moving = log(4.0)
    for n in (1, 2, 3, 50, 300):
        assert not found(values[800 : 800 + n], moving[800 : 800 + n])
