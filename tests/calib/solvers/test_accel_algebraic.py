"""The two algebraic accelerometer methods."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calib.errors import InsufficientMotionError
from calib.model import Triad
from calib.poses import Poses
from calib.solvers import accel_solvers

GRAVITY = 9.80665
TRIAD = Triad.from_matrix(
    np.array([[1.1, 0, 0], [0.01, 0.95, 0], [0.02, 0.03, 1.2]]), np.array([0.3, -0.6, 0.3])
)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def readings(n: int, rng: np.random.Generator, sigma: float = 0.0, triad: Triad = TRIAD) -> Poses:
    direction = rng.standard_normal((n, 3))
    true = GRAVITY * direction / np.linalg.norm(direction, axis=1)[:, None]
    return Poses.from_vectors(
        triad.distort(true) + sigma * rng.standard_normal((n, 3)), sigma=sigma or 1e-9
    )


def test_exact_is_exact_without_noise(rng: np.random.Generator) -> None:
    fit = accel_solvers()["exact"].solve(readings(9, rng), gravity=GRAVITY)
    assert_allclose(fit.triad.matrix, TRIAD.matrix, atol=1e-10)
    assert_allclose(fit.triad.bias, TRIAD.bias, atol=1e-10)
    assert fit.degrees_of_freedom == 0


def test_published_is_exact_where_nothing_is_dropped(rng: np.random.Generator) -> None:
    diagonal = Triad(TRIAD.bias, TRIAD.scale_factor_error)
    fit = accel_solvers()["published"].solve(readings(30, rng, triad=diagonal), gravity=GRAVITY)
    assert_allclose(fit.triad.matrix, diagonal.matrix, atol=1e-10)
    assert_allclose(fit.triad.bias, TRIAD.bias, atol=1e-9)


def test_published_signs_are_right_to_first_order(rng: np.random.Generator) -> None:
    small = Triad.from_matrix(np.diag([1.1, 0.95, 1.2]) + 1e-4 * np.tri(3, k=-1), np.zeros(3))
    fit = accel_solvers()["published"].solve(readings(30, rng, triad=small), gravity=GRAVITY)
    assert_allclose(fit.triad.misalignment, small.misalignment, atol=1e-7)


@pytest.mark.parametrize("method", ["exact", "published"])
def test_too_few_or_flat_poses_are_refused(method: str, rng: np.random.Generator) -> None:
    solve = accel_solvers()[method].solve
    with pytest.raises(InsufficientMotionError, match="8 poses"):
        solve(readings(8, rng), gravity=GRAVITY)
    angle = np.linspace(0, 6, 40)
    flat = GRAVITY * np.column_stack((np.cos(angle), np.sin(angle), 0 * angle))
    with pytest.raises(InsufficientMotionError, match="do not determine"):
        solve(Poses.from_vectors(flat, sigma=1e-3), gravity=GRAVITY)
