"""Samples that come twice, and those that chance makes alike."""

from __future__ import annotations

import numpy as np
import pytest

from calib.repeats import MOST, find_repeats

RNG = np.random.default_rng


def test_chance_repeats_of_a_coarse_sensor_are_no_fault() -> None:
    # Noise of a quarter of the resolution: neighbours are equal more often than not.
    coarse = np.round(RNG(1).normal(0, 0.25, (20_000, 6)) + RNG(2).uniform(-0.5, 0.5, 6))
    assert (coarse[1:] == coarse[:-1]).all(axis=1).mean() > 0.02
    still = np.zeros(len(coarse), bool)
    assert find_repeats(coarse, still).size == 0
    coarse[5000:15000:10] = coarse[4999:14999:10]
    assert find_repeats(coarse, still).size > 900


def test_chance_repeats_are_no_fault_where_rests_are_shorter_than_a_block() -> None:
    # At rest all channels stay on their counts; in motion none does.
    moving = np.arange(20_000) % 60 >= 40
    level = np.where(moving, 20.0, 0.2)[:, None]
    coarse = np.round(level * RNG(1).normal(0, 1, (20_000, 6)) + RNG(2).uniform(-0.5, 0.5, 6))
    assert (coarse[1:] == coarse[:-1]).all(axis=1).mean() > 0.02
    assert find_repeats(coarse, moving).size == 0
    coarse[50:-1:60] = coarse[49:-1:60][: len(coarse[50:-1:60])]
    assert find_repeats(coarse, moving).size > 300


@pytest.mark.parametrize("seed", range(4))
def test_channels_that_share_noise_come_again_together_by_chance(seed: int) -> None:
    """Noise of one supply is on several axes: all stay on their counts at once."""
    rng = RNG(seed)
    own, shared = rng.normal(size=(30_000, 6)), rng.normal(size=(30_000, 1))
    noise = np.sqrt(0.5) * (own + shared) * [0.5, 0.5, 0.5, 0.4, 0.4, 0.4]
    coarse = np.round(noise + rng.uniform(-0.5, 0.5, 6))
    still = np.zeros(len(coarse), bool)
    assert find_repeats(coarse, still).size == 0
    coarse[5000:25000:10] = coarse[4999:24999:10]
    assert find_repeats(coarse, still).size > 1800


@pytest.mark.parametrize("size", [1, 2, 7, MOST])
@pytest.mark.parametrize("lsb", [0.0, 0.01])
def test_a_block_that_a_buffer_gives_twice(size: int, lsb: float) -> None:
    values = RNG(1).normal(0, 1, (5000, 6))
    if lsb:
        values = lsb * np.round(values / lsb)
    values[2000:] = values[2000 - size : -size].copy()
    found = find_repeats(values, np.zeros(len(values), bool))
    assert found.tolist() == list(range(2000, 2000 + size))


def test_a_block_that_comes_three_times() -> None:
    values = RNG(1).normal(0, 1, (5000, 6))
    values[1003:1006] = values[1000:1003]
    values[1006:1009] = values[1000:1003]
    assert find_repeats(values, np.zeros(len(values), bool)).tolist() == list(range(1003, 1009))


def test_a_log_that_is_faster_than_its_sensor_repeats_samples_and_no_blocks() -> None:
    values = np.repeat(RNG(1).normal(0, 1, (500, 6)), 4, axis=0)
    found = find_repeats(values, np.zeros(len(values), bool))
    assert found.tolist() == [k for k in range(2000) if k % 4]


@pytest.mark.parametrize("noise", [0.2, 0.3, 0.5, 1.0])
def test_rounding_makes_no_blocks_by_chance(noise: float) -> None:
    for seed in range(5):
        coarse = np.round(RNG(seed).normal(0, noise, (20_000, 6)) + RNG(9).uniform(-0.5, 0.5, 6))
        assert find_repeats(coarse, np.zeros(len(coarse), bool)).size == 0


def test_few_samples() -> None:
    for n in (1, 2, 3, 40):
        assert find_repeats(RNG(1).normal(0, 1, (n, 6)), np.zeros(n, bool)).size == 0


@pytest.mark.parametrize("lsb", [0.1, 1.0])
def test_one_sample_that_comes_twice_in_a_turn_is_found(lsb: float) -> None:
    """Where noise is of a count, chance makes some at rest: one more was none."""
    time = np.arange(20_000) / 100
    turning = 4000.0 * np.sin(time)[:, None] ** 3 * [1.0, -0.7, 0.4, 2.0, 1.5, -1.0]
    turning[(time % (4 * np.pi)) > 2 * np.pi] = 0.0
    values = lsb * np.round((turning + RNG(1).normal(0, 1, (20_000, 6))) / lsb)
    moving = np.abs(turning).max(axis=1) > 1.0
    assert find_repeats(values, moving).size == 0
    at = int(np.argmax(np.abs(np.diff(turning[:, 0]))))
    again = np.insert(values, at, values[at - 1], axis=0)
    assert find_repeats(again, np.insert(moving, at, moving[at])).tolist() == [at]
