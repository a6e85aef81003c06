"""Orientations of a simulation: those of its motion, up to a heading that nothing tells."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_against, diagnose_reference
from calib.mismatch.reference.oriented import oriented, oriented_at_rests
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses

GRAVITY = 9.80665


def moved(seed: int, noise: NoiseModel, rate: float) -> tuple[Recording, Motion]:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=16, pose_duration=(2.0, 3.0))
    return simulate(motion, SensorModel(), noise, rng=rng, rate=rate), motion


def in_a_field(real: Recording, motion: Motion, size: float) -> Recording:
    """Return a recording of which gyro.y follows the room, by some degrees per second."""
    gyro = real.gyro.copy()
    heading = motion.state(real.time).mat_ns
    assert heading is not None
    gyro[:, 1] += np.radians(size) * np.tanh(3.0 * heading[:, 0, 1])
    return replace(real, gyro=gyro)


@pytest.mark.parametrize("seed", [1, 2])
def test_orientations_are_those_of_the_motion_up_to_a_heading(seed: int) -> None:
    simulation, motion = moved(seed, NoiseModel(), 100.0)
    truth = oriented(RecordingTruth(simulation, GRAVITY))
    at = simulation.time[50:-50]
    found, true = truth.state(at).mat_ns, motion.state(at).mat_ns
    assert found is not None
    assert true is not None
    apart = found @ np.swapaxes(true, 1, 2)
    # One turn about the vertical, all along.
    np.testing.assert_allclose(apart[:, 2, 2], 1.0, atol=1e-4)
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=0.02)


def test_a_gyroscope_that_is_off_leads_nowhere() -> None:
    simulation, _ = moved(1, NoiseModel(), 100.0)
    off = replace(simulation, gyro=simulation.gyro + np.radians([0.3, -0.2, 0.3]))
    assert oriented(RecordingTruth(off, GRAVITY)).quat is None


def test_forces_that_tell_nothing_lead_nowhere() -> None:
    simulation, _ = moved(1, NoiseModel(), 100.0)
    none = replace(simulation, accel=0.0 * simulation.accel)
    assert oriented(RecordingTruth(none, GRAVITY)).quat is None


@pytest.mark.long
def test_a_field_of_the_room_is_followed_beside_a_simulation() -> None:
    simulation, motion = moved(4, NoiseModel(), 80.0)
    real = in_a_field(moved(4, CONSUMER, 100.0)[0], motion, 0.03)
    found = diagnose_against(real, simulation, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == ("orientation", ("gyro.y",))


@pytest.mark.parametrize("seed", [3, 5])
def test_another_imu_is_oriented_by_its_rests_up_to_a_heading(seed: int) -> None:
    other, motion = moved(seed, CONSUMER, 100.0)
    truth = oriented_at_rests(RecordingTruth(other, GRAVITY))
    at = other.time[50:-50]
    found, true = truth.state(at).mat_ns, motion.state(at).mat_ns
    assert found is not None
    assert true is not None
    apart = found @ np.swapaxes(true, 1, 2)
    rested = np.concatenate([np.arange(a, b) for a, b in _rests(other)]) - 50
    rested = rested[(rested >= 0) & (rested < len(at))]
    np.testing.assert_allclose(apart[rested, 2, 2], 1.0, atol=1e-3)
    np.testing.assert_allclose(
        apart[rested], np.broadcast_to(apart[0], apart[rested].shape), atol=0.1
    )


def _rests(recording: Recording) -> list[tuple[int, int]]:
    poses = find_poses(recording)
    return list(zip(poses.start.tolist(), poses.stop.tolist(), strict=True))


@pytest.mark.parametrize("wrong", ["rates", "rests"])
def test_another_imu_of_which_rates_do_not_lead_from_rest_to_rest_is_not(wrong: str) -> None:
    other, _ = moved(3, CONSUMER, 100.0)
    if wrong == "rates":
        other = replace(other, gyro=other.gyro[:, [1, 2, 0]])
    else:
        first = find_poses(other).stop[0]
        other = other.slice(0, int(first))
    assert oriented_at_rests(RecordingTruth(other, GRAVITY)).quat is None


@pytest.mark.long
def test_a_field_of_the_room_is_followed_beside_another_imu() -> None:
    other, motion = moved(4, CONSUMER, 80.0)
    rng = np.random.default_rng(5)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    found = diagnose_reference(in_a_field(real, motion, 0.05), other, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == ("orientation", ("gyro.y",))
    # The Earth turns both.
    assert "earth_rate" not in found.hidden
