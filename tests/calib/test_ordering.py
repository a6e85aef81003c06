"""Packets that came after the next one, and what is in order."""

from __future__ import annotations

import numpy as np
import pytest

from calib.ordering import LEAST, MOST, find_swapped
from calib.types import FloatArray

RNG = np.random.default_rng
LENGTH = 20_000


def log(noise: float = 1.0, *, seed: int = 1) -> FloatArray:
    """Return channels (n, 6) that rest, turn smoothly and rest again, in noises."""
    time = np.arange(LENGTH)
    phase = np.pi * np.maximum(time % 1000 - 800, 0) / 200
    size = RNG(seed).uniform(1000, 3000, (LENGTH // 1000, 6))[time // 1000]
    turning = np.sin(phase)[:, None] ** 3 * size * [1, -1, 1, -1, 1, -1]
    return np.asarray(turning + RNG(seed + 1).normal(0, noise, (LENGTH, 6)))


def swapped(values: FloatArray, start: int, size: int) -> FloatArray:
    order = np.arange(len(values))
    order[start : start + size] += size
    order[start + size : start + 2 * size] -= size
    return values[order]


@pytest.mark.parametrize("size", [LEAST, 10, MOST])
@pytest.mark.parametrize("count", [0.0, 5.0])
def test_packets_that_are_exchanged_in_a_turn_are_found_to_the_sample(
    size: int, count: float
) -> None:
    values = swapped(log(), 4840, size)
    if count:
        values = count * np.round(values / count)
    assert find_swapped(values) == [(4840, 4840 + 2 * size)]


def test_several_are_found() -> None:
    values = log()
    for start in (2870, 8850, 15_840):
        values = swapped(values, start, 10)
    assert [start for start, _ in find_swapped(values)] == [2870, 8850, 15_840]


@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0, 30.0])
@pytest.mark.parametrize("count", [0.0, 1.0])
def test_samples_in_order_stay_so(noise: float, count: float) -> None:
    for seed in range(4):
        values = log(noise, seed=seed)
        assert not find_swapped(count * np.round(values / count) if count else values)


def test_jolts_of_all_channels_are_in_order() -> None:
    for seed in range(6):
        rng = RNG(seed)
        values = log(seed=seed)
        jolts = (rng.random(LENGTH) < 0.02)[:, None] * rng.standard_t(2, (LENGTH, 6))
        assert not find_swapped(values + 200.0 * jolts)
        # A blow that rings on all channels, again and again.
        ring = np.exp(-np.arange(60) / 15)[:, None] * np.sin(np.arange(60)[:, None] * 0.9)
        blow = rng.normal(0, 100, (1, 6)) * ring
        for at in rng.integers(100, LENGTH - 100, 40):
            values[at : at + 60] += blow
        assert not find_swapped(values)


def test_vibration_is_in_order() -> None:
    for period in (4.0, 7.3, 10.0, 20.0):
        time = np.arange(LENGTH)[:, None]
        shaken = 100.0 * np.sign(np.sin(2 * np.pi * time / period + np.arange(6)))
        assert not find_swapped(log() + shaken)


def test_few_samples() -> None:
    for n in (1, 2, 20, 64, 100):
        assert not find_swapped(log()[:n])
