"""Rotations against scipy's own and against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.rotation import (
    cumulative_quat,
    integrate_rate,
    mat_from_quat,
    mat_from_rotvec,
    quat_from_mat,
    quat_from_rotvec,
    rotate,
    rotvec_from_mat,
    rotvec_slope,
    skew,
)


def test_matrices_agree_with_scipy() -> None:
    rotvec = np.random.default_rng(0).normal(0, 2, (50, 3))
    expected = Rotation.from_rotvec(rotvec).as_matrix()
    np.testing.assert_allclose(mat_from_rotvec(rotvec), expected, atol=1e-14)
    np.testing.assert_allclose(mat_from_quat(quat_from_mat(expected)), expected, atol=1e-14)


def test_rotation_vectors_come_back() -> None:
    rotvec = np.random.default_rng(3).uniform(-1.7, 1.7, (5, 10, 3))
    np.testing.assert_allclose(rotvec_from_mat(mat_from_rotvec(rotvec)), rotvec, atol=1e-13)
    np.testing.assert_allclose(rotvec_from_mat(mat_from_rotvec(rotvec[0, 0])), rotvec[0, 0])


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b))


def test_running_product_equals_the_loop() -> None:
    quat = quat_from_rotvec(np.random.default_rng(2).normal(0, 0.5, (137, 3)))
    rotation = Rotation.identity()
    for k, out in enumerate(mat_from_quat(cumulative_quat(quat))):
        rotation = rotation * Rotation.from_quat(quat[k, [1, 2, 3, 0]])
        np.testing.assert_allclose(out, rotation.as_matrix(), atol=1e-12)


def test_integral_of_a_coning_motion_converges() -> None:
    # A sensor whose z axis describes a cone; its orientation is known in closed form.
    def error(n: int) -> float:
        time = np.linspace(0, 2, n)
        half, speed = 0.1, 2 * np.pi
        spin = Rotation.from_rotvec(np.outer(speed * time, [0, 0, 1]))
        tilt = Rotation.from_rotvec([half, 0, 0])
        truth = (spin * tilt * spin.inv()).as_matrix()
        axis = np.array([0, 0, speed])
        rate = np.einsum("nji,j->ni", truth, axis) - axis
        mats = truth[0] @ mat_from_quat(integrate_rate(time, rate))
        return float(np.abs(mats[-1] - truth[-1]).max())

    assert error(201) < 1e-4
    assert error(101) / error(201) > 3.5


def test_vectors_turn_as_by_the_matrix() -> None:
    rng = np.random.default_rng(1)
    quat = rng.normal(size=(20, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    vec = rng.normal(size=(20, 3))
    expected = np.einsum("nij,nj->ni", mat_from_quat(quat), vec)
    np.testing.assert_allclose(rotate(quat, vec), expected, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-5, 0.6, 3.0])
def test_a_small_turn_moves_a_rotation_vector_by_its_slope(size: float) -> None:
    rng = np.random.default_rng(1)
    vector = rng.normal(size=3)
    vector *= size / np.linalg.norm(vector)
    turn = 1e-6 * rng.normal(size=3)
    moved = (Rotation.from_rotvec(turn) * Rotation.from_rotvec(vector)).as_rotvec()
    expected = vector + rotvec_slope(vector) @ turn
    np.testing.assert_allclose(moved, expected, atol=1e-11)
