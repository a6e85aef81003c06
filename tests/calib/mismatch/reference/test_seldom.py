"""Sensors, and motion capture, that take few samples a second."""

from functools import cache

import numpy as np
import pytest

from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.reference.beside import motion_beside
from calib.mismatch.reference.seldom import bent, unresolved
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665
USUAL, FAST = (1.0, 2.5), (0.4, 0.9)
"""s of a turn."""


@cache
def motion(turn: tuple[float, float], tremor: float) -> Motion:
    rng = np.random.default_rng(1)
    return bench_protocol(
        rng, poses=8, first_pose=1.0, pose_duration=(2.0, 3.0), turn_duration=turn, tremor=tremor
    )


def recorded(moved: Motion, rate: float) -> Recording:
    return simulate(moved, SensorModel(), CONSUMER, rng=np.random.default_rng(2), rate=rate)


def captured(moved: Motion, rate: float) -> ReferenceMotion:
    rng = np.random.default_rng(3)
    time = np.arange(0.0, moved.duration, 1.0 / rate)
    turning, path = moved.kinematics(time)
    assert path is not None
    shake = quat_from_rotvec(rng.normal(0.0, np.radians(0.1), (len(time), 3)))
    position = path.position + rng.normal(0.0, 2e-4, path.position.shape)
    return ReferenceMotion(time, quat_multiply(turning.quat, shake), position)


@pytest.mark.parametrize(
    ("turn", "tremor", "own", "other", "which"),
    [
        (USUAL, 0.3, 10.0, 100.0, "the recording"),
        (USUAL, 0.3, 12.5, 100.0, "the recording"),
        (USUAL, 0.3, 100.0, 10.0, "the reference"),
        (FAST, 0.0, 10.0, 100.0, "the recording"),
        (FAST, 0.3, 25.0, 100.0, "the recording"),
        (FAST, 0.0, 20.0, 100.0, "the recording"),
    ],
)
def test_what_samples_are_too_few_for_is_not_judged(turn, tremor, own, other, which):
    """Scales, misalignment, products of rates, and the sign of an output were named."""
    moved = motion(turn, tremor)
    found = diagnose_reference(recorded(moved, own), captured(moved, other), gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert not found.findings
    assert f"{which} has too few a second" in found.missing[0]


@pytest.mark.parametrize(
    ("turn", "tremor", "own", "other"),
    [(USUAL, 0.3, 20.0, 100.0), (USUAL, 0.0, 100.0, 15.0), (FAST, 0.3, 50.0, 100.0)],
)
def test_what_they_are_enough_for_is_judged(turn, tremor, own, other):
    moved = motion(turn, tremor)
    found = diagnose_reference(recorded(moved, own), captured(moved, other), gravity=GRAVITY)
    assert found.verdict == "consistent"


def test_a_slow_recording_has_its_motion_all_the_same():
    moved = motion(USUAL, 0.3)
    found = motion_beside(recorded(moved, 10.0), captured(moved, 100.0), gravity=GRAVITY)
    assert found.motion.duration == pytest.approx(moved.duration, abs=2.0)


def test_what_gravity_bends_by_is_what_a_chord_leaves_of_a_circle():
    time, rate = np.arange(0.0, 20.0, 0.05), 4.0
    turned = np.where(time > 12.0, rate, 0.0)
    gyro = np.stack([turned, 0.0 * time, 0.0 * time], axis=1)
    angle = np.linspace(0.0, rate * 0.05, 1001)
    circle = GRAVITY * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    chord = circle[0] + (angle / angle[-1])[:, None] * (circle[-1] - circle[0])
    off = float(np.linalg.norm(circle - chord, axis=1).mean())
    still = Recording(time, np.zeros((len(time), 3)), gyro, "device")
    assert bent(still, GRAVITY) == pytest.approx(off, rel=0.02)


def test_what_is_not_resolved_is_that_beyond_the_band():
    time = np.arange(0.0, 60.0, 0.01)
    moves = np.where((time > 20.0) & (time < 40.0), 1.0, 0.0)
    slow, fast = 3.0 * np.sin(2.0 * time), 0.3 * np.sin(50.0 * time)
    gyro = np.stack([moves * (slow + fast), 0.0 * time, 0.0 * time], axis=1)
    recording = Recording(time, np.zeros_like(gyro), gyro, "device")
    assert unresolved(recording, 3.0) == pytest.approx(0.1, rel=0.15)
    assert unresolved(recording, 20.0) < 0.02
