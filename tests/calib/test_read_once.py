"""What is read more often than it is measured: samples that come again, triads that are held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calib import faults
from calib.model import SensorModel
from calib.read_once import HELD, find_rereads, read_once
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.timing import evened
from calib.types import FloatArray

RNG = np.random.default_rng


def sampled(n: int = 4000, *, rate: float = 100.0, noise: float = 0.02, seed: int = 1) -> Recording:
    """Return what a sensor measures that is turned to and fro, and rests in between."""
    time = np.arange(n) / rate
    moving = np.sin(2 * np.pi * 0.05 * time)[:, None] > 0
    course = np.sin(2 * np.pi * np.array([0.5, 0.7, 0.3]) * time[:, None])
    scatter = RNG(seed).normal(0, noise, (n, 6))
    accel, gyro = 9.81 * np.cos(course), np.where(moving, course, 0.0)
    return Recording(time, accel + scatter[:, :3], gyro + 0.1 * scatter[:, 3:], clock="host")


def read_at(real: Recording, rate: float, *, jitter: float = 0.0) -> Recording:
    """Return what a host reads that asks so often for the last sample, and stamps the answer."""
    ask = np.arange(real.time[0] + 1e-6, real.time[-1], 1.0 / rate)
    ask = ask + RNG(3).uniform(0, jitter / rate, len(ask))
    last = np.searchsorted(real.time, ask, side="right") - 1
    return rows(real, last, ask)


def rows(real: Recording, which: NDArray[np.int64], time: FloatArray) -> Recording:
    return Recording(time, real.accel[which], real.gyro[which], clock="host")


@settings(max_examples=20, deadline=None)
@given(st.floats(1.05, 8.0), st.integers(0, 1000))
def test_each_sample_is_left_once(ratio: float, seed: int) -> None:
    real = sampled(seed=seed)
    heard = read_at(real, ratio * 100.0)
    once, again = read_once(heard)
    assert len(once) + len(again) == len(heard)
    # The last one may come after the last reading.
    assert np.array_equal(once.gyro, real.gyro[: len(once)])
    assert len(real) - len(once) <= 1
    assert not read_once(once)[1].size


def test_what_is_read_as_often_as_it_is_measured_stays_the_same() -> None:
    real = sampled()
    once, again = read_once(real)
    assert once is real
    assert not again.size


@pytest.mark.parametrize("lsb", [0.002, 0.02, 0.1, 0.5])
def test_chance_repeats_of_a_coarse_sensor_are_not_read_again(lsb: float) -> None:
    real = sampled(20_000)
    coarse = lsb * np.round(faults.values_of(real) / lsb)
    assert not find_rereads(coarse[:, :3]).any()
    assert not find_rereads(coarse[:, 3:]).any()


def test_short_rests_of_coarse_counts_are_not_read_again() -> None:
    """Ten samples a second, and rests of a second or two between turns as short."""
    rng = RNG(2)
    hands = bench_protocol(rng, poses=50, pose_duration=(1.2, 2.0), turn_duration=(0.8, 2.5))
    made = simulate(hands, SensorModel(), CONSUMER.scaled(0.3), rng=rng, rate=10.0)
    coarse = replace(made, gyro=1e-3 * np.round(made.gyro / 1e-3))
    assert read_once(coarse)[0] is coarse


def test_a_coarse_sensor_that_is_read_twice() -> None:
    real = sampled(20_000)
    values = np.repeat(0.002 * np.round(real.gyro / 0.002), 2, axis=0)
    found = find_rereads(values)
    # Turns show it; at rest a sample that is as the one before is one that says nothing new.
    turning = np.repeat(np.abs(real.gyro).max(axis=1) > 0.3, 2)
    assert found[1::2][turning[1::2]].all()
    assert found[::2][turning[::2]].mean() < 0.05


def test_what_comes_again_now_and_then_is_a_fault_of_that_moment() -> None:
    real = sampled()
    values = faults.values_of(real)
    values[500:540] = values[499]
    values[1000::400] = values[999::400][: len(values[1000::400])]
    assert not find_rereads(values[:, :3]).any()


def test_a_channel_that_is_stuck_is_not_read_again() -> None:
    values = faults.values_of(sampled())
    values[1000:1500] = values[1000]
    assert not find_rereads(values[:, :3]).any()


def test_without_noise_rests_are_not_read_again() -> None:
    assert not find_rereads(faults.values_of(sampled(noise=0.0))[:, 3:]).any()


@pytest.mark.parametrize("triad", ["accel", "gyro"])
def test_a_triad_that_measures_half_as_often_is_followed(triad: str) -> None:
    exact = sampled(noise=1e-4)
    signal = getattr(exact, triad)
    held = replace(exact, **{triad: np.repeat(signal[::2], 2, axis=0)})
    once, again = read_once(held)
    assert not again.size
    assert once.notes[HELD] == {"accel": "accelerometer", "gyro": "gyroscope"}[triad]
    left = getattr(once, triad) - signal
    assert np.abs(getattr(held, triad) - signal).max() > 0.01
    # But where a turn sets in at once, and after the last sample that is its own.
    assert np.quantile(np.abs(left[:-1]), 0.99) < 1e-3
    other = "gyro" if triad == "accel" else "accel"
    assert np.array_equal(getattr(once, other), getattr(exact, other))


def test_both_triads_at_rates_of_their_own() -> None:
    exact = sampled(noise=1e-4)
    index = np.repeat(np.arange(4000), 4)
    fine = rows(exact, index, np.arange(16_000) / 400.0)
    held = replace(fine, accel=np.repeat(exact.accel[::2], 8, axis=0))
    once, again = read_once(held)
    assert len(again) == 12_000
    assert once.notes[HELD] == "accelerometer"
    assert np.array_equal(once.gyro, exact.gyro)
    assert np.quantile(np.abs(once.accel - exact.accel)[:-1], 0.99) < 1e-3


def test_the_clock_of_the_sensor_is_found_again() -> None:
    real = sampled()
    once, _ = read_once(read_at(real, 133.0, jitter=0.2))
    late = evened(once).time - real.time[: len(once)]
    # All are as late as a reading is on average; by themselves they are late by up to one.
    assert np.std(once.time - real.time[: len(once)]) > 1.5e-3
    assert np.std(late) < 1e-4
    assert late.mean() == pytest.approx(0.5 / 133, abs=1.5e-3)


def test_two_mishaps_in_a_short_motion_are_none_of_the_host() -> None:
    steps = RNG(1).integers(5, 10, (150, 3)) * RNG(2).choice([-1, 1], (150, 3))
    steps[[60, 120]] = 0
    values = np.concatenate((np.cumsum(steps, axis=0), np.full((1000, 3), 99))).astype(float)
    values[900] += 1.0
    assert not find_rereads(values).any()
