"""Markers that are taken for one another: where the captured orientation is not the body's."""

from functools import cache

import numpy as np
import pytest

from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.swaps import swapped
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.rotation import mat_from_rotvec, quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665
RATE = 120.0
SWAPS = ((1500, 1512, 0.3), (2400, 2460, -0.2))
"""Samples from and to, and the angle."""


@cache
def motion() -> Motion:
    rng = np.random.default_rng(1)
    return bench_protocol(rng, poses=8, first_pose=1.0, pose_duration=(2.0, 3.0), tremor=0.3)


def recorded() -> Recording:
    """Scale, misalignment and bias of the gyroscope are as large as data sheets have them."""
    gyro = Triad(np.array([0.1, -0.05, 0.02]), np.array([0.03, -0.02, 0.01]))
    rng = np.random.default_rng(2)
    return simulate(motion(), SensorModel(gyro=gyro), CONSUMER, rng=rng, rate=104.0)


def captured(*, swaps: bool) -> ReferenceMotion:
    rng = np.random.default_rng(3)
    time = np.arange(0.0, motion().duration, 1.0 / RATE)
    turning, path = motion().kinematics(time)
    assert path is not None
    shake = quat_from_rotvec(rng.normal(0, np.radians(0.2), (len(time), 3)))
    quat = quat_multiply(turning.quat, shake)
    position = path.position + rng.normal(0, 2e-4, path.position.shape)
    for first, last, angle in SWAPS if swaps else ():
        turn = quat_from_rotvec(np.array([0.0, angle, 0.0]))
        quat[first:last] = quat_multiply(quat[first:last], np.tile(turn, (last - first, 1)))
        position[first:last] += 0.02
    quat[700:730] = np.nan
    return ReferenceMotion(time, quat, position)


@pytest.mark.parametrize("late", [0.0, 0.01])
@pytest.mark.parametrize("turn", [np.zeros(3), np.array([0.3, 2.0, -1.0])])
def test_swapped_markers_are_found_and_nothing_else(late, turn):
    """Though the clocks are roughly known only, and the sensor is mounted at any angle."""
    mat = mat_from_rotvec(turn)
    real, seen = recorded(), captured(swaps=True)
    real = Recording(real.time, real.accel @ mat.T, real.gyro @ mat.T, "device")
    found = swapped(seen.time, seen.quat, real, Alignment(late, 0.0, 10.0), mat)
    expected = np.zeros(len(found), bool)
    for first, last, _ in SWAPS:
        assert found[first:last].all()
        expected[first - 4 : last + 4] = True
    assert not (found & ~expected).any()


def test_nothing_is_swapped_in_what_is_merely_noisy():
    seen = captured(swaps=False)
    alignment = Alignment(0.0, 0.0, 0.0)
    assert not swapped(seen.time, seen.quat, recorded(), alignment, np.eye(3)).any()


def test_swapped_markers_are_nothing_that_a_sensor_does():
    found = diagnose_reference(recorded(), captured(swaps=True), gravity=GRAVITY)
    assert found.verdict == "consistent"


def test_a_gap_in_which_the_body_turns_on_is_no_swap():
    """What it turns by there is no vector: about other axes in between, it does not add up."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 60.0, 1.0 / RATE)
    rate = np.stack(
        [2.5 * np.sin(1.7 * time), 2.0 * np.sin(2.3 * time + 1.0), np.cos(time)], axis=1
    )
    quat = np.zeros((len(time), 4))
    quat[0] = 1.0, 0.0, 0.0, 0.0
    for k, step in enumerate(quat_from_rotvec(rate[:-1] / RATE)):
        quat[k + 1] = quat_multiply(quat[k], step)
    force = np.tile([0.0, 0.0, GRAVITY], (len(time), 1))
    real = Recording(time, force, rate + rng.normal(0.0, 1e-3, rate.shape), "device")
    for first in (2000, 4500):
        quat[first : first + 70] = np.nan
    assert not swapped(time, quat, real, Alignment(0.0, 0.0, 0.0), np.eye(3)).any()


def test_a_gap_of_the_gyroscope_is_no_swap():
    """It was summed up straight across what it had not seen."""
    real = recorded()
    rate = np.linalg.norm(real.gyro, axis=1)
    fast = real.time[np.argmax(np.convolve(rate, np.ones(100), mode="same"))]
    torn = real.select(np.abs(real.time - fast) > 1.0)
    seen = captured(swaps=False)
    assert not swapped(seen.time, seen.quat, torn, Alignment(0.0, 0.0, 0.0), np.eye(3)).any()
