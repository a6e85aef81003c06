"""The noise model: levels are recovered, and the closed forms agree with brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.factors import SCALES, SHARES, log_shares
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.contrast import contrast_likelihood, contrast_variance
from calib.mismatch.noise.coupling import drift_in_contrasts, lean_in_contrasts
from calib.mismatch.noise.noise import (
    NEAR,
    PACKAGE,
    WITHIN,
    Felt,
    Weighing,
    _basis_beside,
    _beneath,
    _factored,
    _parted,
    covariance,
    estimate_levels,
    expected_levels,
    find_levels,
    level_basis,
    level_likelihood,
    make_whitener,
    prior_precision,
    range_basis,
    rows_of_levels,
    spread_of_variance,
)
from calib.mismatch.noise.sensornoise import LEAN, shrunk
from calib.mismatch.rows.rows import Component

from ..bench import drawn, problem


def test_levels_are_recovered():
    _, self_mode = problem()
    rows = self_mode.rows()
    levels = expected_levels(rows)
    names = [c.name for c in rows.components]
    true = 30.0
    for axis in "xyz":
        levels[names.index(f"gyro.{axis} flicker")] *= true
    mean = np.hstack((rows.baseline, rows.nuisance))
    rng = np.random.default_rng(1)
    found = []
    for _ in range(6):
        fit = estimate_levels(drawn(rows, levels, rng), mean, expected_levels(rows))
        found += [
            fit.values[names.index(f"gyro.{a} flicker")]
            / rows.components[names.index(f"gyro.{a} flicker")].expected
            for a in "xyz"
        ]
    # The prior pulls towards 1 by a known amount; half of the logarithm must come back.
    assert np.median(found) > np.sqrt(true)
    assert np.median(found) < 2 * true


def test_levels_are_found_where_turns_close_badly():
    _, self_mode = problem()
    rows = self_mode.rows()
    names = [c.name for c in rows.components]
    mean = np.hstack((rows.baseline, rows.nuisance))
    rng = np.random.default_rng(4)
    for size in (1e3, 1e3, 1e5, 1e5):
        levels = expected_levels(rows)
        for name in ("attitude", "velocity by effort"):
            levels[names.index(name)] *= size
        bad = drawn(rows, levels, rng)
        known = estimate_levels(bad, mean, levels)
        found = find_levels(bad, mean, expected_levels(rows))
        assert found.log_likelihood > known.log_likelihood - 0.5


def test_the_maximum_is_reached_to_what_evidence_needs():
    """Steps end where what is left of their gains is small, not where one gains little."""
    _, self_mode = problem()
    rows = self_mode.rows()
    mean = np.hstack((rows.baseline, rows.nuisance))
    start = expected_levels(rows)
    found = estimate_levels(rows, mean, start)
    closer = estimate_levels(rows, mean, found.values)
    assert found.log_likelihood > level_likelihood(rows, level_basis(rows, mean), start) + 1.0
    assert closer.log_likelihood - NEAR < found.log_likelihood <= closer.log_likelihood
    # A last step is taken without a look at where it leads: what it promises is there.
    there = level_likelihood(rows, level_basis(rows, mean), closer.values)
    assert closer.log_likelihood == pytest.approx(there, abs=0.2 * NEAR)


def test_the_likelihood_of_levels_is_that_of_all_rows_and_so_is_its_slope():
    _, self_mode = problem()
    rows = self_mode.rows()
    usual = expected_levels(rows)
    rows = drawn(rows, usual, np.random.default_rng(11))
    mean = np.hstack((rows.baseline, rows.nuisance))
    told = rows_of_levels(rows)
    assert 0.9 * len(rows.residual) < len(told) <= len(rows.residual)
    basis, measured = level_basis(rows, mean), rows.residual[told]

    def brute(levels):
        n = len(rows.residual)
        whole = np.zeros((n, n))
        whole[: rows.n_dense, : rows.n_dense] = covariance(rows, levels)
        rest = rows.white_diagonal + levels @ drift_in_contrasts(rows)
        whole[rows.n_dense :, rows.n_dense :] = np.diag(rest)
        lower = np.linalg.cholesky(whole[np.ix_(told, told)])
        x, y = (np.linalg.solve(lower, v) for v in (basis, measured))
        left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
        log_det = 2 * np.log(np.diag(lower)).sum() + np.linalg.slogdet(x.T @ x)[1]
        return -0.5 * (log_det + left @ left)

    one = usual * np.exp(np.random.default_rng(12).normal(size=len(usual)))
    weighing = Weighing.of(rows, one)
    likelihood, *found = _factored(weighing, _beneath(rows, basis))
    white, left = _parted(*found)
    assert likelihood == pytest.approx(brute(one), abs=1e-6)
    py, trace, vpy = weighing.slopes(rows, white, left)
    slope = 0.5 * (vpy.T @ py - trace) * one
    for i in (1, 2, 4, len(usual) - 3):
        step = np.where(np.arange(len(usual)) == i, 1e-4, 0.0)
        seen = (brute(one * np.exp(step)) - brute(one * np.exp(-step))) / 2e-4
        assert slope[i] == pytest.approx(seen, abs=1e-3)


def test_bayes_factors_agree_with_the_densities():
    _, self_mode = problem()
    rows = self_mode.rows()
    levels = expected_levels(rows)
    empty = np.zeros((len(rows.residual), 0))
    whitener = make_whitener(rows, levels, contrast_variance(rows), empty)
    y = whitener.project(rows.residual)[:30]
    whole = np.zeros(len(rows.residual))
    whole[:30] = y
    z = np.random.default_rng(2).normal(size=(len(rows.residual), 2))
    z[30:] = 0.0
    stack = Stack(len(z))
    unit = type("Unit", (), {"whiten": staticmethod(lambda v: v), "basis": empty})()
    index = stack.columns.add(z)
    stack.add(Candidate("both", index, 1.0, True, ("accel.x",)))
    stack.add(Candidate("first", index[:1], 1.0, True, ("accel.x",)))
    found = stack.log_bayes_factors(unit, whole)
    assert SHARES.sum() == pytest.approx(1.0)
    null = multivariate_normal(np.zeros(30), np.eye(30)).logpdf(y)
    for value, columns in zip(found, (z[:30], z[:30, :1]), strict=True):
        each = [
            multivariate_normal(np.zeros(30), np.eye(30) + s**2 * columns @ columns.T).logpdf(y)
            for s in SCALES
        ]
        power = np.array([np.square(columns).sum() / columns.shape[1]])
        shares = np.exp(log_shares(power, np.ones(1, bool)))[:, 0]
        expected = np.log(np.sum(shares * np.exp(np.array(each) - null)))
        np.testing.assert_allclose(value, expected, rtol=1e-8)


def test_the_noise_of_contrasts_is_that_outside_of_what_is_set_apart():
    _, self_mode = problem()
    rows = self_mode.rows()
    rng = np.random.default_rng(5)
    residual = np.sqrt(3.0 * rows.white_diagonal) * rng.normal(size=len(rows.white_diagonal))
    loud = (rows.channel[rows.n_dense :] == 4) & (rows.segment[rows.n_dense :] % 3 == 0)
    residual[loud] *= 6.0
    rows = replace(rows, residual=np.append(np.zeros(rows.n_dense), residual))
    assert loud.any()
    factor = {
        kind: np.median((variance / rows.white_diagonal)[loud])
        for kind, variance in (
            ("all", contrast_variance(rows)),
            ("outside", contrast_variance(rows, apart=loud)),
        )
    }
    assert 2.0 < factor["outside"] < 4.5
    assert factor["all"] > 1.3 * factor["outside"]
    other = rows.channel[rows.n_dense :] != 4
    both = contrast_variance(rows), contrast_variance(rows, apart=loud)
    assert np.array_equal(both[0][other], both[1][other])
    # The likelihood prefers what made them.
    quiet, even = (contrast_likelihood(rows, v) for v in (both[1], rows.white_diagonal))
    assert quiet > even


def test_few_contrasts_are_judged_by_all_of_their_triad():
    """Of two rests nobody can tell what repeats in them, and what the sensor or its holder does."""
    _, self_mode = problem()
    rows = self_mode.rows()
    few = np.isin(rows.segment, np.flatnonzero(rows.is_rest)[:2])
    few[: rows.n_dense] = True
    rows = rows.without(~few)
    at = rows.channel[rows.n_dense :]
    residual = np.zeros(len(rows.residual))
    residual[rows.n_dense :] = np.sqrt(rows.white_diagonal) * np.where(at == 3, 8.0, 0.0)
    variance = contrast_variance(replace(rows, residual=residual)) / rows.white_diagonal
    assert np.all(variance[at < 3] == 1.0)
    # A third of them, 64 each, and six that are as expected.
    assert np.allclose(variance[at >= 3], (4 * 64 + 6) / (12 + 6))


def test_contrasts_of_a_triad_are_judged_alike_without_those_of_the_other():
    """Which order each is of was guessed from how many there are."""
    _, self_mode = problem()
    rows = self_mode.rows()
    rng = np.random.default_rng(3)
    contrast = np.arange(len(rows.residual)) >= rows.n_dense
    size = np.append(np.zeros(rows.n_dense), np.sqrt(rows.white_diagonal))
    rows = rows.with_residual(size * rng.normal(0.0, 3.0, len(size)))
    assert contrast.sum() % 24 == 0
    alone = rows.without(contrast & (rows.channel >= 3))
    accel = rows.channel[contrast] < 3
    np.testing.assert_array_equal(contrast_variance(alone), contrast_variance(rows)[accel])


@pytest.mark.parametrize("level", [0.0, 2e-7])
def test_axes_along_gravity_and_short_rests_see_less_of_a_lean(level):
    """A hand sways: what it does to an axis goes with the axis, and with how long the rest is."""
    _, self_mode = problem()
    rows = self_mode.rows()
    start = rows.n_dense
    lean = level * lean_in_contrasts(rows)
    true = rows.white_diagonal + lean
    rng = np.random.default_rng(12)
    ratios = []
    for _ in range(20):
        noise = np.sqrt(true) * rng.standard_normal(len(true))
        seen = rows.with_residual(np.append(rows.residual[:start], noise))
        ratios.append(contrast_variance(seen) / true)
    accel = rows.channel[start:] < 3
    for some in (accel & (lean <= np.median(lean[accel])), accel & (lean > np.median(lean[accel]))):
        if some.any():
            assert 0.9 < np.median(np.array(ratios)[:, some]) < 1.25


def test_levels_of_a_sensor_that_leans_are_found():
    """Not the other maximum, where all of its drift is far from what is expected."""
    _, self_mode = problem()
    rows = self_mode.rows()
    mean = np.hstack((rows.baseline, rows.nuisance))
    levels = expected_levels(rows)
    leans = [i for i, c in enumerate(rows.components) if c.group == LEAN]
    levels[leans] *= 1e4
    rng = np.random.default_rng(8)
    for _ in range(4):
        found = find_levels(drawn(rows, levels, rng), mean, expected_levels(rows))
        gyros = np.log10(found.values[leans[1:]] / levels[leans[1:]])
        assert np.abs(gyros).max() < 1.0


@pytest.mark.parametrize(("size", "error"), [(0.0, 0.1), (30.0, 0.9), (1000.0, 0.2)])
def test_likelihood_is_averaged_over_the_prior_of_a_level(size, error):
    _, self_mode = problem()
    rows = self_mode.rows()
    component = next(c for c in rows.components if c.name == "attitude by angle")
    rows = replace(rows, components=(component,))
    mean = np.hstack((rows.baseline, rows.nuisance))
    basis = level_basis(rows, mean)
    levels = np.array([max(size, 1e-3) * component.expected])
    rows = drawn(rows, levels, np.random.default_rng(7))
    fit = estimate_levels(rows, mean, expected_levels(rows))
    logs = np.linspace(-8, 8, 321) * component.spread
    each = [level_likelihood(rows, basis, component.expected * np.exp(np.array([u]))) for u in logs]
    density = np.exp(np.array(each) - fit.log_likelihood) / (component.spread * np.sqrt(2 * np.pi))
    averaged = np.log(density.sum() * (logs[1] - logs[0]))
    # Where a level is but half determined, its likelihood has a long tail, which Laplace misses.
    assert fit.log_share == pytest.approx(averaged, abs=error)
    # A level that is determined takes a smaller share of its prior than one that is not.
    assert fit.log_share < (-0.8 if size else 0.05)


def test_a_variance_from_n_rows_is_as_uncertain_as_that_of_so_many_squares():
    _, self_mode = problem()
    rows = self_mode.rows()
    n = rows.n_dense
    part = Component.alone("all", np.arange(n), np.ones(n), expected=1.0, spread=1.4)
    rng = np.random.default_rng(3)
    mean, y = rng.normal(size=(n, 4)), rng.normal(size=n)
    basis = range_basis(mean)
    left = y - basis @ (basis.T @ y)
    level = float(left @ left) / (n - 4)
    residual = np.append(y, np.zeros(len(rows.residual) - n))
    rows = replace(rows, residual=residual, white=1e-12 * np.eye(n), components=(part,))
    influence = np.zeros((len(rows.residual), 4))
    influence[:n] = mean @ np.linalg.inv(mean.T @ mean)
    variance = level * np.square(influence).sum(axis=0)
    found = spread_of_variance(rows, mean, np.array([level]), influence, variance)
    # The prior knows the logarithm to 1.4.
    assert found == pytest.approx((0.5 * (n - 4) + 1.4**-2) ** -0.5, rel=1e-6)
    # Where other noise, that is known, is most of a variance, it is known better.
    more = spread_of_variance(rows, mean, np.array([level]), influence, 3 * variance)
    assert more == pytest.approx(found / 3)
    # Beside a prior the variance is smaller than its parts: its spread is bounded by theirs.
    held = spread_of_variance(rows, mean, np.array([level]), influence, 1e-6 * variance)
    assert held == pytest.approx(found)


def test_levels_of_loud_rests_are_drawn_to_what_they_share_and_no_further():
    rng = np.random.default_rng(9)
    count = 14
    error = np.full(40, 3.0 / count)

    def seen(true):
        values = rng.normal(size=(len(true), count + 1)) * np.sqrt(true)[:, None]
        return np.square(np.diff(values, axis=1)).mean(axis=1) / 2

    alike = np.full(40, 100.0)
    found = np.array([shrunk(seen(alike), error) for _ in range(50)])
    assert found.mean() == pytest.approx(100.0, rel=0.05)
    assert np.log(found).std() < 0.6 * np.log(seen(np.full(2000, 100.0))).std()
    # What counts is how much a rest weighs: as much as it should, on average.
    assert np.mean(100.0 / found) == pytest.approx(1.0, abs=0.1)
    unlike = np.geomspace(10.0, 1e4, 40)
    ratio = np.array([shrunk(seen(unlike), error) / unlike for _ in range(50)])
    assert np.exp(np.log(ratio).mean(axis=0)) == pytest.approx(1.0, abs=0.5)


def test_columns_that_noise_makes_alike_have_a_likelihood():
    """Whitened they differ by 1e-10: squared, by nothing that a double holds."""

    class Drowned:
        log_det = 0.0

        def solve(self, values):
            return Felt(values.dense * np.array([[1.0], [1e-10], [1.0]]), values.contrast)

    basis = np.array([[1.0, 1.0], [1.0, -1.0], [0.0, 0.0]]) / np.sqrt(2.0)
    both = Felt.of(np.column_stack((basis, [3.0, 0.0, 2.0])), 3)
    likelihood, *found = _factored(Drowned(), both)
    mean, left = _parted(*found)
    assert np.allclose(mean.times(mean), np.eye(2))
    assert np.allclose(left, [0.0, 0.0, 2.0])
    # The determinant of the whitened columns is 1e-10.
    assert likelihood == pytest.approx(-0.5 * (2 * np.log(1e-10) + 4.0))


def test_no_residual_has_a_likelihood():
    _, self_mode = problem()
    rows = self_mode.rows()
    rows = rows.with_residual(np.zeros(len(rows.residual)))
    basis = level_basis(rows, np.hstack((rows.baseline, rows.nuisance)))
    weighing = Weighing.of(rows, expected_levels(rows))
    likelihood, *found = _factored(weighing, _beneath(rows, basis))
    white = weighing.solve(Felt.of(basis, rows.n_dense))
    _, log_det = np.linalg.slogdet(white.times(white))
    assert likelihood == pytest.approx(-0.5 * (weighing.log_det + log_det))
    assert not _parted(*found)[1].any()


def test_a_walk_is_told_less_by_flicker_than_flicker_of_another_axis():
    """Where an Allan plot begins to rise differs between parts by a factor of ten in time."""
    rows = problem()[1].rows()
    place = {c.name: i for i, c in enumerate(rows.components)}
    prior = np.linalg.inv(prior_precision(rows))

    def apart(one: str, other: str) -> float:
        step = np.zeros(len(prior))
        step[place[one]], step[place[other]] = 1.0, -1.0
        return float(np.sqrt(step @ prior @ step))

    alike = apart("gyro.x flicker", "gyro.y flicker")
    assert alike == pytest.approx(np.sqrt(2) * WITHIN)
    assert np.exp(2 * apart("gyro.x walk", "gyro.x flicker")) > 10 > np.exp(2 * alike)
    # And less than by the walk of another axis of the same part.
    together = apart("gyro.x walk", "gyro.y walk")
    assert together < apart("gyro.x walk", "gyro.y flicker")
    assert together == pytest.approx(alike)


def test_a_gyroscope_that_drifts_far_says_that_its_package_may():
    """Rests show of an accelerometer's drift hardly more than its length."""
    rows = problem()[1].rows()
    names = [c.name for c in rows.components]
    prior = np.linalg.inv(prior_precision(rows))
    one, other, lean = (names.index(n) for n in ("gyro.x walk", "accel.y walk", "accel lean"))
    # A correlation of what they share, and none with what is no drift.
    own = prior[one, one] - WITHIN**2
    assert prior[one, other] == pytest.approx(PACKAGE * own)
    assert prior[one, lean] == prior[other, lean] == 0.0
    assert np.linalg.eigvalsh(prior).min() > 0.1 * WITHIN**2
    # Where a walk of the gyroscope is plain, that of the accelerometer is expected to be larger.
    levels = expected_levels(rows)
    far = [i for i, name in enumerate(names) if name.startswith("gyro") and "walk" in name]
    levels[far] *= 100.0
    mean = np.hstack((rows.baseline, rows.nuisance))
    near = [i for i, name in enumerate(names) if name.startswith("accel") and "walk" in name]
    found = [
        estimate_levels(drawn(rows, levels, np.random.default_rng(k)), mean, expected_levels(rows))
        for k in range(4)
    ]
    ratio = np.array([fit.values[near] / expected_levels(rows)[near] for fit in found])
    assert np.median(ratio) > 1.5


def test_what_is_known_of_a_part_is_integrated_out_where_rows_do_not_tell():
    rng = np.random.default_rng(9)
    white = rng.normal(size=(40, 5))
    white[:, 1] *= 1e-3
    white[:, 2] = white[:, 0] + 0.02 * rng.normal(size=40)
    spread = np.array([0.5, 2.0, 0.5])
    basis = _basis_beside(white, spread)
    # Of what nobody knows beforehand the prior is as wide as may be.
    wide = np.concatenate((spread, [1e6, 1e6]))
    covariance = np.eye(40) + (white * wide**2) @ white.T
    left = np.eye(40) - basis @ basis.T
    assert left == pytest.approx(np.linalg.inv(covariance), abs=2e-3)
    assert np.linalg.matrix_rank(basis) == 5
    # What rows tell far better than that, or alone, is projected out.
    for known in (np.full(3, 1e6), np.full(3, np.inf), np.zeros(0)):
        plain, beside = range_basis(white), _basis_beside(white, known)
        np.testing.assert_allclose(beside @ beside.T, plain @ plain.T, atol=1e-10)


def test_a_basis_beside_another_one_has_what_is_new_and_no_rounding():
    rng = np.random.default_rng(12)
    first, more = rng.normal(size=(60, 7)), rng.normal(size=(60, 4))
    known = range_basis(first)
    again = np.hstack((more, 1e9 * first @ rng.normal(size=(7, 3)), np.zeros((60, 1))))
    found = range_basis(again, known)
    assert found.shape == (60, 11)
    assert (found[:, :7] == known).all()
    np.testing.assert_allclose(found.T @ found, np.eye(11), atol=1e-12)
    whole = range_basis(np.hstack((first, more)))
    np.testing.assert_allclose(found @ found.T, whole @ whole.T, atol=1e-10)
    assert range_basis(more[:, :0], known).shape == known.shape


def test_products_leave_out_what_contrasts_do_not_feel():
    rng = np.random.default_rng(13)
    columns = rng.normal(size=(50, 6))
    columns[30:, :4] = 0.0
    felt = Felt.of(columns, 30)
    assert felt.first == 4
    assert (felt.whole == columns).all()
    np.testing.assert_allclose(felt.times(felt), columns.T @ columns)
    lower = np.linalg.cholesky(columns.T @ columns)
    found = felt.times_inverse(lower)
    assert found.first == 4
    np.testing.assert_allclose(found.times(found), np.eye(6), atol=1e-12)
    # A residual is the last, though it be nothing.
    assert Felt.of(np.zeros((50, 3)), 30).contrast.shape == (20, 1)
