"""Which rows do not belong to a linear fit."""

import numpy as np
import pytest

from calib.solvers.outliers import between_variance, find_outliers


def problem(
    n: int, rng: np.random.Generator, sigma: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    jacobian = rng.standard_normal((n, 4))
    residual = jacobian @ [1.0, -2.0, 3.0, 0.5] + sigma * rng.standard_normal(n)
    return residual, jacobian, np.full(n, sigma**2)


def test_two_outliers_of_one_size_do_not_hide_each_other() -> None:
    rng = np.random.default_rng(3)
    residual, jacobian, variance = problem(20, rng)
    jacobian[5] = jacobian[4]  # side by side, they pull the fit together
    residual[4:6] = jacobian[4:6] @ [1.0, -2.0, 3.0, 0.5] + 30.0
    assert np.flatnonzero(find_outliers(residual, jacobian, variance)).tolist() == [4, 5]


@pytest.mark.parametrize("n", [12, 40, 200, 2000])
def test_clean_rows_stay(n: int) -> None:
    rng = np.random.default_rng(n)
    lost = 0
    for _ in range(40):
        residual, jacobian, variance = problem(n, rng)
        if n > 1000:  # there the residuals are those of a fit that was made before
            residual = residual - jacobian @ np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        lost += find_outliers(residual, jacobian, variance).any()
    assert lost <= 3


def test_noise_that_is_larger_than_said_is_no_outlier() -> None:
    rng = np.random.default_rng(5)
    lost = 0
    for _ in range(40):
        residual, jacobian, variance = problem(30, rng)
        lost += find_outliers(residual, jacobian, variance / 100).any()
    assert lost <= 3


def test_a_row_that_alone_determines_something_cannot_be_judged() -> None:
    rng = np.random.default_rng(6)
    residual, jacobian, variance = problem(20, rng)
    jacobian = np.column_stack((jacobian, np.eye(20)[0]))
    residual[0] += 1e3
    assert not find_outliers(residual, jacobian, variance).any()


def test_many_rows_are_judged_at_once() -> None:
    rng = np.random.default_rng(7)
    residual = rng.standard_normal(5000)
    residual[::10] += 20.0
    out = find_outliers(residual, np.zeros((5000, 0)), np.ones(5000))
    assert out[::10].all()
    assert out.sum() <= 502


def test_between_variance_is_what_was_put_in() -> None:
    rng = np.random.default_rng(8)
    known = rng.uniform(0.1, 2.0, 100_000)
    residual = rng.standard_normal(100_000) * np.sqrt(known + 3.0)
    assert between_variance(residual, known, 100_000) == pytest.approx(3.0, rel=0.03)
    assert between_variance(0.5 * np.sqrt(known), known, 100_000) == 0.0
    assert between_variance(np.zeros(3), np.zeros(3), 3) == 0.0
