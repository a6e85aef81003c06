"""What rivals can explain at most is known before their columns are looked at."""

import numpy as np
import pytest
from scipy.special import logsumexp

from calib.mismatch.hypotheses.bound import TOGETHER, factors_that_count, most_explained
from calib.mismatch.hypotheses.factors import log_bayes_factor, most_told
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.search.accepted import contrast_noise, fitted
from calib.mismatch.search.ranking import make_stack

from ..bench import problem


@pytest.fixture(scope="module")
def scored():
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    mean, contrast = fitted(rows, []), contrast_noise(rows, [])
    return rows, stack, make_whitener(rows, expected_levels(rows), contrast, mean)


def beside(scored, name, size):
    """Return what is left beside what is fitted of noise, and of an effect of that size."""
    rows, stack, whitener = scored
    noise = np.random.default_rng(6).normal(size=len(rows.residual))
    y = noise - whitener.basis @ (whitener.basis.T @ noise)
    effect = max((c for c in stack if c.name == name), key=lambda c: len(c.index))
    return y + size * whitener.project(stack.of(effect).sum(axis=1))


@pytest.mark.parametrize("size", [0.0, 1.0, 30.0])
def test_no_rival_explains_more_than_its_bound(scored, size):
    rows, stack, whitener = scored
    y = beside(scored, "gyro_g_sensitivity", size)
    found = stack.log_bayes_factors(whitener, y)
    for channels in TOGETHER:
        own = stack.of_channels(channels, physical=False)
        assert own.any()
        assert found[own].max() <= most_explained(rows, whitener, y, channels)
    assert sum(stack.of_channels(c, physical=False).sum() for c in TOGETHER) == (
        len(stack) - stack.physical.sum()
    )


def test_no_combination_of_columns_explains_more_than_all_of_them():
    rng = np.random.default_rng(4)
    columns, y = 30.0 * rng.normal(size=(80, 9)), 3.0 * rng.normal(size=80)
    columns[:, 8] = columns[:, 0] - columns[:, 1]
    most = most_told(columns.T @ columns, y @ columns)
    # At last all that is along them, whatever it takes.
    along = columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    assert most == pytest.approx(0.5 * float(along @ along), rel=1e-6)
    for k in (1, 3, 9):
        for _ in range(20):
            assert log_bayes_factor(columns @ rng.normal(size=(9, k)), y) < most
    assert log_bayes_factor(along[:, None], y) < most
    assert most_told(-np.eye(2), np.ones(2)) == np.inf


def test_what_is_left_out_changes_no_digit(scored):
    rows, stack, whitener = scored
    for size, all_count in ((0.0, True), (30.0, False)):
        y = beside(scored, "gyro_g_sensitivity", size)
        every = stack.log_bayes_factors(whitener, y)
        found, which = factors_that_count(stack, rows, whitener, y)
        assert which.all() == all_count
        assert which[stack.physical].all()
        np.testing.assert_allclose(found[which], every[which], rtol=1e-9, atol=1e-9)
        assert (found[~which] == -np.inf).all()
        total = logsumexp(every + stack.weight)
        assert logsumexp(found + stack.weight) == pytest.approx(total, rel=1e-14)
