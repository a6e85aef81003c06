"""Orientations of a simulation: those of its motion, up to a heading that nothing tells."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_against
from calib.mismatch.reference.oriented import oriented
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel

GRAVITY = 9.80665


def moved(seed: int, noise: NoiseModel, rate: float) -> tuple[Recording, Motion]:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=16, pose_duration=(2.0, 3.0))
    return simulate(motion, SensorModel(), noise, rng=rng, rate=rate), motion


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


def test_a_field_of_the_room_is_followed_beside_a_simulation() -> None:
    simulation, motion = moved(4, NoiseModel(), 80.0)
    real = moved(4, CONSUMER, 100.0)[0]
    gyro = real.gyro.copy()
    heading = motion.state(real.time).mat_ns
    assert heading is not None
    gyro[:, 1] += np.radians(0.03) * np.tanh(3.0 * heading[:, 0, 1])
    found = diagnose_against(replace(real, gyro=gyro), simulation, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == ("orientation", ("gyro.y",))
