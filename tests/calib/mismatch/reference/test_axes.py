"""Axes of an accelerometer that another IMU, mounted at an angle, seems to turn."""

from functools import cache

import numpy as np
import pytest

from calib.mismatch import diagnose_reference
from calib.mismatch.reference import referencemode
from calib.mismatch.reference.against import OWN_AXES
from calib.mismatch.reference.carried import SIZES
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses

GRAVITY = 9.80665
TURN = mat_from_rotvec(np.array([0.3, -0.5, 0.4]))
SCALES = np.array([-0.012, 0.015, 0.003])


@cache
def motion() -> Motion:
    return bench_protocol(np.random.default_rng(2), poses=10, pose_duration=(2.0, 3.0))


def recorded() -> Recording:
    rng = np.random.default_rng(5)
    return simulate(motion(), SensorModel(), CONSUMER, rng=rng, rate=100.0)


def other(scales: np.ndarray) -> Recording:
    """Return another IMU at an angle, of which the accelerometer has these scale factor errors."""
    rng = np.random.default_rng(6)
    clean, noisy = (
        simulate(motion(), SensorModel(), noise, rng=rng, rate=150.0)
        for noise in (NoiseModel(), CONSUMER)
    )
    accel = clean.accel @ TURN.T * (1.0 + scales) + noisy.accel - clean.accel
    gyro = clean.gyro @ TURN.T + noisy.gyro - clean.gyro
    return Recording(clean.time, accel, gyro, "device")


def test_scale_factors_of_another_imu_at_an_angle_are_nothing_unexplained() -> None:
    """They were: of one channel of the accelerometer, by the direction of gravity."""
    found = diagnose_reference(recorded(), other(SCALES), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["reference_misalignment"]
    assert not found.unexplained
    assert found.summary[OWN_AXES]


@pytest.mark.parametrize(
    ("scales", "spread", "turned"),
    [(SCALES, SIZES, True), (SCALES, 1e-3 * SIZES, False), (0.0 * SCALES, SIZES, False)],
)
def test_only_what_the_other_one_s_errors_may_be_is_taken_for_them(
    scales: np.ndarray, spread: np.ndarray, turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(referencemode, "known_errors", lambda *_, **__: (0.0 * SIZES, spread))
    real = recorded()
    seen = look_at_samples(real, find_poses(real))
    problem, _ = compare_reference(real, other(scales), seen, gravity=GRAVITY)
    assert problem.own_axes is turned
