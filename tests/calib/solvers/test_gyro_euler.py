"""Euler angles against quaternions, through the singularity, and the paper's equation 9."""

import numpy as np
from scipy.spatial.transform import Rotation

from calib.closure import by_quaternions
from calib.rotation import mat_from_quat
from calib.solvers.gyro_euler import by_euler_angles, euler_rates


def test_euler_angles_pass_through_the_singularity() -> None:
    rng = np.random.default_rng(0)
    # Two turns that pitch by more than 90 degrees, and a shaken one with coarse steps.
    pitch = np.tile([0.0, 0.02, 0.0], (200, 1))
    wild = rng.normal(0, 0.4, (50, 3))
    rotvec = np.concatenate([pitch, pitch[:, [1, 0, 2]] + rng.normal(0, 0.01, (200, 3)), wild])
    first = np.array([0, 200, 400, 450])
    expected = mat_from_quat(by_quaternions(rotvec, first))
    np.testing.assert_allclose(mat_from_quat(by_euler_angles(rotvec, first)), expected, atol=2e-6)


def test_the_rates_are_those_of_the_angles() -> None:
    rng = np.random.default_rng(1)
    angles, rate = rng.uniform(-1, 1, (2, 20, 3))
    step = 1e-6
    turned = Rotation.from_euler("ZYX", angles[:, ::-1]) * Rotation.from_rotvec(rate * step)
    expected = (turned.as_euler("ZYX")[:, ::-1] - angles) / step
    np.testing.assert_allclose(euler_rates(angles, rate), expected, atol=1e-5)
