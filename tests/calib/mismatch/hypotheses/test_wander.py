"""What wanders in a window: the evidence of all windows at once is that of each alone."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch.hypotheses.factors import log_bayes_factor
from calib.mismatch.hypotheses.wander import wandering


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("correlation", [1e-3, 4.0, 1e3])
def test_evidence_is_that_of_the_process_with_its_covariance(channels, correlation):
    rng = np.random.default_rng(5)
    each = rng.integers(1, 4, 9)
    first = np.concatenate(([0], np.cumsum(each)))
    middle = np.sort(rng.uniform(0.0, 40.0, first[-1]))
    columns = rng.normal(size=(60, len(middle), channels))
    y = 2.0 * rng.normal(size=60)
    flat = columns.reshape(60, -1)
    gram = (flat.T @ flat).reshape(len(middle), channels, len(middle), channels)
    match = (y @ flat).reshape(len(middle), channels)
    found = wandering(gram, match, middle, first, correlation=correlation, longest=5)
    assert np.isfinite(found).sum() == sum(min(b, 5) for b in range(1, 10))
    for a, b in ((0, 1), (3, 4), (1, 6), (4, 9)):
        own = slice(first[a], first[b])
        lag = np.abs(np.subtract.outer(middle[own], middle[own]))
        root = np.linalg.cholesky(np.exp(-lag / correlation) + 1e-12 * np.eye(len(lag)))
        whole = np.concatenate([columns[:, own, c] @ root for c in range(channels)], axis=1)
        assert found[a, b] == pytest.approx(log_bayes_factor(whole, y), abs=1e-3)
