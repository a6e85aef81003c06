"""Bayes factors in closed form, against the same by eigenvalues."""

import numpy as np
import pytest

from calib.mismatch.hypotheses.score import (
    ALL_AT_ONCE,
    SCALES,
    average_of_scales,
    log_bayes_factors,
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
