"""A rest in which the sensor was bumped is two; what steps or shakes without that is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.mismatch import diagnose_recording
from calib.mismatch.rows.bumped import parted
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

GRAVITY = 9.80665
MILLIRADIAN = 1e-3
TILT = np.array([1.5, -1.0, 0.7]) * MILLIRADIAN
QUICK = 0.06
"""s that a bump takes."""


def rise(part: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a smooth step from 0 to 1, and its slope."""
    x = np.clip(part, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2


def bench(seed: int, rate: float, tilt: FloatArray | None = None) -> tuple[Recording, float]:
    """Return a recording whose sixth pose is bumped half way, and when; put right in a turn."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=20, power_on=0.0)
    made = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=rate)
    poses = find_poses(made)
    moment, stop = float(poses.interval[5].mean()), float(poses.interval[5, 1])
    if tilt is None:
        return made, moment
    turn = float(poses.interval[6, 0]) - stop
    up, brisk = rise((made.time - moment) / QUICK)
    down, slow = rise((made.time - stop) / turn)
    back = Rotation.from_rotvec(np.outer(up - down, tilt)).inv().as_matrix()
    accel = np.einsum("nij,nj->ni", back, made.accel)
    gyro = np.einsum("nij,nj->ni", back, made.gyro) + np.outer(brisk / QUICK - slow / turn, tilt)
    return replace(made, accel=accel, gyro=gyro), moment


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
@pytest.mark.parametrize("size", [1.0, 2.0, 4.0])
def test_a_bumped_pose_is_two(rate: float, size: float) -> None:
    recording, moment = bench(1, rate, size * TILT)
    poses = find_poses(recording)
    two, bumps = parted(recording, poses)
    assert len(two) == len(poses) + 1
    ((start, stop),) = bumps
    assert start < moment + 0.03 < stop
    assert stop - start < 0.6


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_named_for_a_bump_and_it_is_said(seed: int) -> None:
    """It was a bias that stepped, or one in a window."""
    recording, moment = bench(seed, 100.0, TILT)
    found = diagnose_recording(recording, gravity=GRAVITY)
    assert found.verdict == "consistent"
    (bump,) = found.summary["bumped"]
    assert bump[0] < moment + 0.03 < bump[1]
    assert found.summary["poses_used"] == found.summary["poses"]


@pytest.mark.parametrize("seed", range(4))
def test_no_rest_is_parted_by_noise(seed: int) -> None:
    recording, _ = bench(seed, 100.0)
    assert not len(parted(recording, find_poses(recording))[1])


@pytest.mark.parametrize("step", [0.0, 0.02])
@pytest.mark.parametrize("pulse", [0.0, 0.04])
def test_what_gravity_does_not_follow_is_no_bump(step: float, pulse: float) -> None:
    """A scale that steps along gravity, and a pulse of a gyroscope."""
    recording, moment = bench(5, 100.0)
    poses = find_poses(recording)
    up = poses.accel[5] / np.linalg.norm(poses.accel[5])
    stepped = np.outer(recording.time > moment, step * up)
    pulsed = np.outer(np.abs(recording.time - moment) < 0.05, [pulse, pulse, 0.0])
    accel, gyro = recording.accel + stepped, recording.gyro + pulsed
    assert not len(parted(replace(recording, accel=accel, gyro=gyro), poses)[1])


def test_without_a_clock_nothing_is_brisk() -> None:
    recording, _ = bench(1, 100.0, TILT)
    timeless: Recording = replace(recording, clock="invalid")
    assert not len(parted(timeless, find_poses(recording))[1])


def test_a_bump_about_one_axis_is_no_sample_that_is_off_course() -> None:
    """It is over in four samples."""
    recording, moment = bench(4, 100.0, np.array([3.3, 0.2, -0.2]) * MILLIRADIAN)
    found = diagnose_recording(recording, gravity=GRAVITY)
    ((start, stop),) = found.summary["bumped"]
    assert start < moment + 0.03 < stop
    assert not found.unexplained
