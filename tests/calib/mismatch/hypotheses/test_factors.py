"""Bayes factors in closed form, against the same by eigenvalues."""

import numpy as np
import pytest

from calib.mismatch.hypotheses.factors import (
    ALL_AT_ONCE,
    SCALES,
    SHARES,
    SHOWN,
    average_of_scales,
    log_bayes_factors,
    log_shares,
)


def by_eigenvalues(gram: np.ndarray, match: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    along = np.square(np.einsum("nij,ni->nj", vectors, match))
    square = np.square(SCALES)[:, None, None]
    strength = 1.0 + square * values
    return average_of_scales(0.5 * (square * along / strength - np.log(strength)).sum(axis=2))


@pytest.mark.parametrize("columns", [1, 2, 3, ALL_AT_ONCE, ALL_AT_ONCE + 1, 32])
def test_bayes_factors_are_those_by_eigenvalues(columns: int) -> None:
    rng = np.random.default_rng(columns)
    made = rng.normal(size=(20, 40, columns)) * np.exp(rng.normal(0.0, 1.0, (20, 1, columns)))
    made[3:6, :, -1] = made[3:6, :, 0]  # one column twice
    made[6] = 0.0
    y = 3.0 * rng.normal(size=(20, 40))
    y[7] = 0.0
    y[8] = made[8, :, 0]
    gram, match = np.swapaxes(made, 1, 2) @ made, np.einsum("nmk,nm->nk", made, y)
    found = log_bayes_factors(gram, match, np.zeros(len(gram), bool))
    np.testing.assert_allclose(found, by_eigenvalues(gram, match), rtol=1e-7, atol=1e-7)


def test_what_rounding_leaves_of_nothing_is_nothing() -> None:
    """The square of its length has no inverse in floating point."""
    gram = np.array([[[2.0, 1e-161, 0.0], [1e-161, 3.0, 1e-161], [0.0, 1e-161, 1.0]]])
    match = np.array([[1e-160, 1e-161, -1e-161]])
    found = log_bayes_factors(gram, match, np.zeros(len(gram), bool))
    np.testing.assert_allclose(found, by_eigenvalues(gram, match), rtol=1e-9)


def test_an_effect_is_sought_at_sizes_that_would_show_and_a_rival_at_any() -> None:
    power = np.array([1e-4, 1.0, 1e4, 1e9])
    effects, rivals = (np.exp(log_shares(power, np.full(4, kind))) for kind in (True, False))
    np.testing.assert_allclose(effects.sum(axis=0), 1.0)
    np.testing.assert_allclose(rivals, np.repeat(SHARES[:, None], 4, axis=1))
    strength = np.square(SCALES)[:, None] * power
    sought = (strength > SHOWN[0]) & (strength < SHOWN[1])
    for own, shares, others in zip(sought.T, effects.T, rivals.T, strict=True):
        if own.any():
            assert shares[own].sum() > others[own].sum()
            np.testing.assert_allclose(shares[own] / others[own], (shares[own] / others[own])[0])
        else:
            # Where none would show, or all by far, there is nothing to choose.
            np.testing.assert_allclose(shares, others)


def test_the_expectation_of_a_bayes_factor_is_one() -> None:
    """Whatever the weights: columns and noise alone decide of them."""
    rng = np.random.default_rng(3)
    column = 8.0 * np.eye(1, 12)[0]
    y = 3.0 * rng.normal(size=(400_000, 1))  # drawn three times as wide, and weighted
    weight = 3.0 * np.exp(-0.5 * np.square(y[:, 0]) * (1 - 1 / 9))
    gram = np.full((len(y), 1, 1), column @ column)
    factors = np.exp(log_bayes_factors(gram, 8.0 * y, np.ones(len(y), bool)))
    few = SHARES @ (np.square(8.0 * SCALES) < 100)  # larger ones are too rare to be drawn
    assert few - 0.2 < np.mean(weight * factors) < 1.05
