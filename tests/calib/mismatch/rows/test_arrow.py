"""The arrow: its factor and slopes are those of the whole covariance, which is never made."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from calib.mismatch.noise.noise import covariance, expected_levels, range_basis
from calib.mismatch.rows.arrow import Arrow, Factor, _factor
from calib.mismatch.rows.rows import Component, Rows

from ..bench import problem


def drawn(seed: int = 1) -> tuple[Rows, np.ndarray]:
    _, self_mode = problem()
    rows = self_mode.rows()
    spread = np.random.default_rng(seed).normal(size=len(rows.components))
    return rows, expected_levels(rows) * np.exp(spread)


def windows() -> Rows:
    """Return rows as a comparison has them: no turns, and errors that three channels share."""
    rows, _ = drawn()
    rows = rows.without(rows.channel < 0)
    triad = np.flatnonzero(rows.channel[: rows.n_dense] < 3)[::2]
    components = [c for c in rows.components if len(c.index)]
    variance = np.linspace(1e-6, 2e-6, len(triad))
    shared = Component.alone("accel motion", triad, variance, expected=1.0, spread=2.5)
    return replace(rows, components=(*components, shared))


def everywhere() -> Rows:
    """Return rows of which each has an error of its own, too."""
    rows, _ = drawn()
    n = rows.n_dense
    own = Component.alone("all", np.arange(n), np.diag(rows.white), expected=1.0, spread=2.5)
    return replace(rows, components=(*rows.components, own))


def angles() -> Rows:
    """Return rows whose channels err together, in white noise and slowly; two of them do not."""
    rows = windows()
    n, rng = rows.n_dense, np.random.default_rng(11)
    felt = rng.normal(size=(n, 12)) * np.sqrt(np.diag(rows.white))[:, None]
    felt[np.isin(rows.channel[:n], [1, 4])] = 0.0
    slow = Component("slow", np.arange(n), sparse.csr_matrix(felt), np.eye(12), 0.5, 2.0)
    return replace(rows, white=rows.white + felt @ felt.T, components=(*rows.components, slow))


KINDS = pytest.mark.parametrize(
    "rows",
    [drawn()[0], windows(), everywhere(), angles()],
    ids=["turns", "windows", "everywhere", "angles"],
)


def test_what_errs_together_is_one_block_and_a_column_spreads_no_further():
    rows = angles()
    assert rows.together.tolist() == [0, 1, 0, 0, 4, 0]
    assert windows().together.tolist() == [0, 1, 2, 3, 4, 5]
    dense = rows.channel[: rows.n_dense]
    for channels in ([1], [0], [4, 5]):
        column = np.where(np.isin(rows.channel, channels), 1.0, 0.0)
        white = rows.arrow.factorise(expected_levels(rows)).solve(column[: rows.n_dense])
        touched = rows.touched(channels)
        assert set(np.flatnonzero(np.abs(white) > 1e-12)) <= set(touched.tolist())
        assert set(np.flatnonzero(column)) <= set(touched.tolist())
        assert len(touched) < len(rows.channel)
    assert set(np.flatnonzero(dense == 1)) == set(rows.touched([1])[rows.touched([1]) < len(dense)])


@KINDS
def test_the_factor_is_that_of_the_whole_covariance(rows):
    rng = np.random.default_rng(2)
    levels = expected_levels(rows) * np.exp(rng.normal(size=len(rows.components)))
    whole = np.linalg.cholesky(covariance(rows, levels))
    factor = rows.arrow.factorise(levels)
    scale = np.abs(whole).max(axis=1)[:, None]
    np.testing.assert_allclose(factor.dense() / scale, whole / scale, atol=1e-12)
    assert factor.log_det == pytest.approx(2 * np.log(np.diag(whole)).sum())
    assert factor.solve(np.zeros((rows.n_dense, 0))).shape == (rows.n_dense, 0)
    assert factor.solve_transposed(np.zeros((rows.n_dense, 0))).shape == (rows.n_dense, 0)
    for values in (rng.normal(size=rows.n_dense), rng.normal(size=(rows.n_dense, 3))):
        there = np.linalg.solve(whole, values)
        np.testing.assert_allclose(factor.solve(values), there, rtol=1e-8, atol=1e-10 * there.max())
        back = np.linalg.solve(whole.T, values)
        np.testing.assert_allclose(
            factor.solve_transposed(values), back, rtol=1e-8, atol=1e-10 * back.max()
        )


@KINDS
def test_slopes_are_those_of_the_restricted_likelihood(rows):
    levels = expected_levels(rows)
    mean = range_basis(np.hstack((rows.baseline, rows.nuisance))[: rows.n_dense])
    y = rows.residual[: rows.n_dense]
    inverse = np.linalg.inv(covariance(rows, levels))
    projector = inverse - inverse @ mean @ np.linalg.solve(
        mean.T @ inverse @ mean, mean.T @ inverse
    )
    factor = rows.arrow.factorise(levels)
    white = range_basis(factor.solve(mean))
    left = factor.solve(y)
    left = left - white @ (white.T @ left)
    py, trace, pull = rows.arrow.slopes(factor, white, left)
    np.testing.assert_allclose(py, projector @ y, rtol=1e-6, atol=1e-9 * np.abs(py).max())
    for k, c in enumerate(rows.components):
        part = np.zeros_like(projector)
        part[np.ix_(c.index, c.index)] = c.matrix
        assert trace[k] == pytest.approx((projector * part).sum(), rel=1e-6)
        pulled = part @ projector @ y
        np.testing.assert_allclose(pull[:, k], pulled, rtol=1e-6, atol=1e-9 * np.abs(pulled).max())


def test_turns_must_feel_the_drift_of_a_channel_in_one_way():
    rows, _ = drawn()
    first, second, *others = rows.components
    other = replace(second, response=sparse.csr_matrix(2.0 * second.response))
    with pytest.raises(ValueError, match="felt alike"):
        Arrow.of(rows.white, rows.channel[: rows.n_dense], (first, other, *others))


def test_a_unit_factor_changes_nothing():
    values = np.random.default_rng(3).normal(size=(4, 2))
    unit = Factor.unit(4)
    np.testing.assert_array_equal(unit.solve(values), values)
    np.testing.assert_array_equal(unit.dense(), np.eye(4))
    assert unit.log_det == 0.0


def test_columns_that_are_nearly_dependent_have_the_basis_of_those_that_are_not():
    rng = np.random.default_rng(4)
    plain = rng.normal(size=(60, 5))
    near = plain @ rng.normal(size=(5, 2)) + 1e-7 * rng.normal(size=(60, 2))
    for columns, rank in ((plain, 5), (np.hstack((plain, plain[:, :2])), 5), (near, 2)):
        basis = range_basis(columns * np.geomspace(1e-6, 1e6, columns.shape[1]))
        np.testing.assert_allclose(basis.T @ basis, np.eye(rank), atol=1e-13)
        left = columns - basis @ (basis.T @ columns)
        assert np.abs(left).max() < 1e-8 * np.abs(columns).max()
    both = np.hstack((plain, near))
    basis = range_basis(both)
    assert basis.shape[1] == 7
    np.testing.assert_allclose(basis.T @ basis, np.eye(7), atol=1e-13)


def test_a_covariance_that_rounding_has_spoilt_is_factored_as_near_as_can_be():
    """Two rows see one large error: what is left of their difference is below the last digit."""
    large, rng = 1e9, np.random.default_rng(5)
    seen = rng.normal(size=(6, 2))
    exact = large * seen @ seen.T + 1e-9 * np.eye(6)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(exact - 1e-7 * np.eye(6))
    lower = _factor(exact - 1e-7 * np.eye(6))
    assert lower @ lower.T == pytest.approx(exact, abs=1e-10 * large)
    with pytest.raises(np.linalg.LinAlgError):
        _factor(np.diag([1.0, -1.0]))
