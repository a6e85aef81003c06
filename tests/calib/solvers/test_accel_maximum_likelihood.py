"""The default accelerometer method: noise, bumped poses, and what is not determined."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calib.errors import InsufficientMotionError
from calib.fit import Fit
from calib.model import Triad
from calib.poses import Poses
from calib.solvers.accel_maximum_likelihood import _rows, solve
from calib.solvers.quadric import NAMES, parameters_of
from calib.types import FloatArray

GRAVITY = 9.80665
TRIAD = Triad.from_matrix(
    np.array([[1.1, 0, 0], [0.01, 0.95, 0], [0.02, 0.03, 1.2]]), np.array([0.3, -0.6, 0.3])
)
TRUTH = parameters_of(TRIAD.matrix, TRIAD.bias)
FACES = np.vstack((np.eye(3), -np.eye(3)))


def readings(direction: FloatArray, rng: np.random.Generator, sigma: float) -> FloatArray:
    true = GRAVITY * direction / np.linalg.norm(direction, axis=1)[:, None]
    return TRIAD.distort(true) + sigma * rng.standard_normal(direction.shape)


def fit(accel: FloatArray, sigma: float) -> Fit:
    return solve(Poses.from_vectors(accel, sigma=sigma), gravity=GRAVITY)


def normalised_error(result: Fit) -> float:
    error = result.values - TRUTH
    return float(error @ np.linalg.solve(result.covariance, error)) / len(error)


@pytest.mark.parametrize("sigma", [1e-9, 0.01, 0.5])
def test_normalised_errors_are_near_one(sigma: float) -> None:
    rng = np.random.default_rng(2)
    found = [
        normalised_error(fit(readings(rng.standard_normal((60, 3)), rng, sigma), sigma))
        for _ in range(60)
    ]
    assert 0.75 < np.mean(found) < 1.3  # 540 degrees of freedom: 0.06 is one standard deviation


def test_poses_that_differ_beyond_their_noise_widen_the_covariance() -> None:
    rng = np.random.default_rng(3)
    found = []
    for _ in range(60):
        direction = rng.standard_normal((40, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        accel = readings(direction, rng, 1e-3) + 5e-3 * direction * rng.standard_normal((40, 1))
        found.append(normalised_error(fit(accel, 1e-3)))
    assert 0.75 < np.mean(found) < 1.3


def test_poses_of_unequal_noise_are_weighed() -> None:
    rng = np.random.default_rng(4)
    sigma = np.where(np.arange(60) % 2, 1e-3, 0.2)
    errors = []
    for _ in range(30):
        accel = readings(rng.standard_normal((60, 3)), rng, 0.0)
        accel += sigma[:, None] * rng.standard_normal((60, 3))
        poses = Poses.from_vectors(accel, sigma=1.0)
        covariance = sigma[:, None, None] ** 2 * np.eye(3)
        poses = Poses(*(*vars(poses).values(),)[:5], covariance, poses.gyro_covariance)
        result = solve(poses, gravity=GRAVITY)
        errors.append(normalised_error(result))
        assert result.standard_errors[0] < 1e-3  # as the thirty quiet ones alone would give
    assert 0.7 < np.mean(errors) < 1.35


def test_a_clipped_axis_that_was_corrected_has_a_covariance_of_rank_two() -> None:
    rng = np.random.default_rng(5)
    poses = Poses.from_vectors(readings(rng.standard_normal((60, 3)), rng, 1e-3), sigma=1e-3)
    skewed = np.array([[1.0, 0.0], [0.3, 1.0], [0.1, -0.7]])
    flat = np.broadcast_to(1e-6 * skewed @ skewed.T, (60, 3, 3))
    result = solve(replace(poses, accel_covariance=flat), gravity=GRAVITY)
    assert_allclose(result.values, TRUTH, atol=0.01)


@pytest.mark.parametrize("bumped", [[3], [3, 17], [3, 9, 17]])
def test_bumped_poses_are_named_and_left_out(bumped: list[int]) -> None:
    rng = np.random.default_rng(5)
    direction = rng.standard_normal((30, 3))
    clean = readings(direction, rng, 1e-3)
    accel = clean.copy()
    accel[bumped] *= 1.02  # 20 mg along gravity
    result = fit(accel, 1e-3)
    assert [e.interval[0] for e in result.excluded] == bumped
    rest = fit(np.delete(clean, bumped, axis=0), 1e-3)
    assert_allclose(result.values, rest.values, atol=1e-9)
    assert result.degrees_of_freedom == 30 - len(bumped) - 9


def test_clean_poses_are_kept() -> None:
    rng = np.random.default_rng(6)
    kept = [
        len(fit(readings(rng.standard_normal((25, 3)), rng, 1e-3), 1e-3).excluded)
        for _ in range(100)
    ]
    assert np.count_nonzero(kept) <= 4


def undetermined(direction: FloatArray) -> tuple[set[str], Fit]:
    result = fit(readings(direction, np.random.default_rng(8), 1e-4), 1e-4)
    known = ~np.isnan(result.standard_errors)
    error = (result.values - TRUTH)[known] / result.standard_errors[known]
    assert np.abs(error).max() < 4
    assert all(n in result.undetermined for n, k in zip(NAMES, known, strict=True) if not k)
    return {name.removeprefix("accel.") for name in result.undetermined}, result


def test_six_faces_leave_the_misalignments_open() -> None:
    names, result = undetermined(FACES)
    assert names == {"misalignment.yx", "misalignment.zx", "misalignment.zy"}
    assert len(result.advice) == 3
    assert all("equally far up" in line for line in result.advice)


def test_a_missing_face_is_asked_for() -> None:
    names, result = undetermined(np.delete(FACES, 4, axis=0))
    assert {"bias.y", "scale_factor_error.y"} <= names
    assert result.advice[0] == "add a pose with -Y up"


def test_poses_in_a_plane_say_nothing_across_it() -> None:
    angle = np.linspace(0, 6, 25)
    names, _ = undetermined(np.column_stack((np.cos(angle), np.sin(angle), 0 * angle)))
    assert names == {"bias.z", "scale_factor_error.z", "misalignment.zx", "misalignment.zy"}


def test_what_is_advised_determines_everything() -> None:
    _, result = undetermined(FACES)
    added = []
    for line in result.advice:
        words = line.removeprefix("add a pose with ").split()
        axes = [w for w in words if w[-1] in "XYZ"]
        added.append(sum(np.eye(3)["XYZ".index(a[1])] * float(a[0] + "1") for a in axes))
    names, _ = undetermined(np.vstack((FACES, added)))
    assert not names


def test_one_pose_is_refused_with_advice() -> None:
    with pytest.raises(InsufficientMotionError, match=r"1 pose .*add a pose with"):
        fit(readings(FACES[:1], np.random.default_rng(0), 1e-3), 1e-3)


def test_jacobian_is_the_derivative_of_the_length() -> None:
    rng = np.random.default_rng(9)
    accel = readings(rng.standard_normal((12, 3)), rng, 0.0)

    def length(values: FloatArray) -> FloatArray:
        matrix = np.eye(3)
        matrix[(0, 1, 2, 1, 2, 2), (0, 1, 2, 0, 0, 1)] += values[3:]
        return np.linalg.norm((accel - values[:3]) @ np.linalg.inv(matrix).T, axis=1)

    step = 1e-6
    numeric = np.column_stack(
        [(length(TRUTH + step * e) - length(TRUTH - step * e)) / (2 * step) for e in np.eye(9)]
    )
    covariance = np.broadcast_to(np.eye(3), (12, 3, 3))
    for project in (False, True):  # without noise the readings are on the sphere already
        *_, jacobian = _rows(accel, covariance, TRUTH, GRAVITY, project=project)
        assert_allclose(jacobian.T, numeric, atol=1e-8)
