"""A recording as its sensors measured it: spikes are bridged, and said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib import faults
from calib.calibrate import calibrate
from calib.calibration import Gravity
from calib.measured import cubic, measured, mended
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import NoiseModel, simulate
from calib.simulation.bench import bench_protocol
from calib.statics import find_poses

GRAVITY = Gravity(9.80665)
NOISE = NoiseModel(accel_noise_density=2e-3, gyro_noise_density=2e-4)
RNG = np.random.default_rng
REAL = simulate(bench_protocol(RNG(3), poses=16), SensorModel(), NOISE, rng=RNG(4), rate=50.0)
POSES = find_poses(REAL)


def spiked(real: Recording, spikes: dict[tuple[int, int], float]) -> Recording:
    values = faults.values_of(real)
    for (k, c), size in spikes.items():
        values[k, c] += size
    return replace(real, accel=values[:, :3], gyro=values[:, 3:])


@settings(max_examples=25, deadline=None)
@given(
    st.dictionaries(
        st.tuples(st.integers(0, len(POSES) - 1), st.integers(0, 5)),
        st.sampled_from([-30.0, 30.0]),
        max_size=6,
    )
)
def test_spikes_are_found_and_bridged(found: dict[tuple[int, int], float]) -> None:
    # In the middle of rests: in a brisk turn nobody could tell a spike from a knock.
    middle = (POSES.start + POSES.stop) // 2
    spikes = {(int(middle[k]), c): size for (k, c), size in found.items()}
    spikes = {key: v for key, v in spikes.items() if sum(k == key[0] for k, _ in spikes) == 1}
    good, where = mended(spiked(REAL, spikes))
    assert {(k, c) for k, _, c in where.tolist()} == set(spikes)
    left = faults.values_of(good) - faults.values_of(REAL)
    assert np.abs(left).max(initial=0.0) < 0.1
    assert np.count_nonzero(left) == len(spikes)


def test_what_is_in_its_course_stays_the_same() -> None:
    good, where = mended(REAL)
    assert good is REAL
    assert where.shape == (0, 3)


def test_a_calibration_is_that_of_the_recording_without_spikes() -> None:
    spikes = {(500, 0): 30.0, (1200, 4): -8.0, (2100, 2): 30.0, (2500, 3): 8.0}
    expected = calibrate(REAL, gravity=GRAVITY)
    found = calibrate(spiked(REAL, spikes), gravity=GRAVITY)
    error = np.sqrt(expected.covariance.diagonal())
    off = np.array([found.values[n] - expected.values[n] for n in expected.names])
    assert np.all(np.abs(off) < error)
    assert np.sqrt(found.covariance.diagonal()) == pytest.approx(error, rel=0.3)


def test_stamps_are_those_of_the_samples_that_are_left() -> None:
    index = np.repeat(np.arange(len(REAL)), 2)
    time = REAL.time[0] + 0.5 * REAL.interval * np.arange(len(index))
    read = measured(Recording(time, REAL.accel[index], REAL.gyro[index], clock="host"))
    assert np.array_equal(read.stamps, np.delete(time, read.again))
    assert len(read.recording) == len(REAL)


@pytest.mark.parametrize("length", [1, 2, 3, 4])
def test_a_spike_is_three_samples_long_at_most(length: int) -> None:
    values = faults.values_of(REAL)
    start = int((POSES.start[3] + POSES.stop[3]) // 2)
    values[start : start + length, 4] -= 8.0
    good, where = mended(replace(REAL, accel=values[:, :3], gyro=values[:, 3:]))
    if length > faults.LONGEST_SPIKE:
        assert not len(where)
        return
    assert where.tolist() == [[start, start + length, 4]]
    assert good.gyro == pytest.approx(REAL.gyro, abs=0.02)


def test_a_bridge_is_a_cubic() -> None:
    at = np.array([-2, -1, 3, 4])
    asked = np.arange(3)
    assert cubic(at, 1.0 - at + 2.0 * at**3, asked) == pytest.approx(1.0 - asked + 2.0 * asked**3)
