"""What turns slowly in a rest is no rest; what only a gyroscope shows is its own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.mismatch import diagnose_recording
from calib.mismatch.rows.nudged import still_parts
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses
from calib.types import FloatArray

GRAVITY = 9.80665
SLOW = 3.0
"""s that a small turn takes."""

QUIET = NoiseModel(
    accel_noise_density=2e-4,
    gyro_noise_density=1e-5,
    accel_bias_instability=5e-5,
    gyro_bias_instability=2e-6,
)
"""Of a tactical part."""


def rise(part: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a smooth step from 0 to 1, and its slope."""
    x = np.clip(part, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2


def made(seed: int, noise: NoiseModel = QUIET) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(
        rng, poses=20, pose_duration=(9.0, 12.0), power_on=0.0, temperature=25.0
    )
    return simulate(motion, SensorModel(), noise, rng=rng, rate=100.0)


def nudged(recording: Recording, at: FloatArray, angle: FloatArray) -> Recording:
    """Return a recording with slow turns at (k,) s by (k, 3) rad, each put right 12 s later."""
    accel, gyro = recording.accel, recording.gyro
    for moment, turn in zip(at.tolist(), angle, strict=True):
        on, begins = rise((recording.time - moment) / SLOW)
        off, ends = rise((recording.time - moment - 12.0) / SLOW)
        back = Rotation.from_rotvec(np.outer(on - off, turn)).inv().as_matrix()
        accel = np.einsum("nij,nj->ni", back, accel)
        gyro = np.einsum("nij,nj->ni", back, gyro) + np.outer((begins - ends) / SLOW, turn)
    return replace(recording, accel=accel, gyro=gyro)


@pytest.mark.parametrize("degrees", [0.1, 0.3])
def test_a_rest_that_begins_with_a_slow_turn_is_the_rest_of_it(degrees: float) -> None:
    recording = made(1)
    poses = find_poses(recording)
    across = np.cross(poses.accel[5], [0.3, 0.8, -0.5])
    turn = np.radians(degrees) * across / np.linalg.norm(across)
    moment = float(poses.interval[5, 0]) + 0.1
    seen = nudged(recording, np.array([moment]), turn[None])
    found = still_parts(seen, find_poses(seen))
    at = int(np.argmin(np.abs(found.interval.mean(axis=1) - poses.interval[5].mean())))
    assert 0.6 * SLOW < found.interval[at, 0] - moment < SLOW + 0.5
    assert found.interval[at, 1] == pytest.approx(poses.interval[5, 1], abs=0.3)


def test_one_in_the_middle_of_which_it_turns_is_two() -> None:
    recording = made(2)
    poses = find_poses(recording)
    moment = float(poses.interval[8].mean()) - 0.5 * SLOW
    across = np.cross(poses.accel[8], [0.3, 0.8, -0.5])
    turn = 5e-3 * across / np.linalg.norm(across)
    seen = nudged(recording, np.array([moment]), turn[None])
    found = still_parts(seen, poses)
    assert len(found) > len(poses)
    inside = (found.interval[:, 0] < moment + 0.7 * SLOW) & (
        found.interval[:, 1] > moment + 0.3 * SLOW
    )
    assert not inside.any()


@pytest.mark.parametrize("noise", [QUIET, CONSUMER])
@pytest.mark.parametrize("seed", range(3))
def test_no_rest_is_parted_by_noise(noise: NoiseModel, seed: int) -> None:
    recording = made(seed, noise)
    poses = find_poses(recording)
    assert still_parts(recording, poses) is poses


def test_what_gravity_denies_is_the_gyroscopes() -> None:
    """A channel that is off for three seconds in each of four rests."""
    recording = made(3)
    poses = find_poses(recording)
    gyro = recording.gyro.copy()
    for k in range(6, 10):
        start = float(poses.interval[k, 0]) + 0.3
        gyro[(recording.time > start) & (recording.time < start + SLOW), 1] += 2e-3
    disturbed = replace(recording, gyro=gyro)
    assert still_parts(disturbed, poses) is poses


def test_without_a_clock_nothing_is_slow() -> None:
    timeless = replace(made(1), clock="invalid")
    poses = find_poses(timeless)
    assert still_parts(timeless, poses) is poses


@pytest.mark.parametrize("seed", [4, 5])
def test_nothing_is_named_for_a_stage_that_makes_small_turns(seed: int) -> None:
    """It was a fluctuation in a window, or a bias that stepped."""
    recording = made(seed)
    poses = find_poses(recording)
    rng = np.random.default_rng(seed)
    at = poses.interval[3:17:3, 0] + 0.1
    angle = (
        np.radians(rng.uniform(0.1, 0.4, (len(at), 1))) * np.eye(3)[rng.integers(3, size=len(at))]
    )
    found = diagnose_recording(nudged(recording, at, angle), gravity=GRAVITY)
    assert found.verdict == "consistent"
