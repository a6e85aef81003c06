"""The evidence of an alignment against scipy's own densities."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib.mismatch.hypotheses.factors import SCALES, SHARES
from calib.mismatch.reference.setupfindings import bayes_factor


@pytest.mark.parametrize("value", [[0.0, 0.0], [3e-3, -1e-3]])
def test_evidence_is_a_ratio_of_densities(value: list[float]) -> None:
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]]) * 1e-6
    typical = np.array([1e-2, 2e-3])
    none = multivariate_normal.pdf(value, cov=covariance)
    some = [
        multivariate_normal.pdf(value, cov=covariance + np.diag((s * typical) ** 2)) for s in SCALES
    ]
    found = bayes_factor(np.array(value), covariance, typical)
    assert found == pytest.approx(float(np.dot(SHARES, some)) / none, rel=1e-9)


def test_what_is_beyond_doubt_stays_finite() -> None:
    found = bayes_factor(np.array([1.0]), np.array([[1e-12]]), np.array([1.0]))
    assert 1e250 < found < np.inf
