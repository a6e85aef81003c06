"""Drift as the other channels let one expect it."""

from __future__ import annotations

import numpy as np

from calib.mismatch.noise.noise import expected_levels, prior_precision
from calib.mismatch.noise.sensornoise import DRIFT
from calib.mismatch.noise.usual import RAISED, usual_levels

from ..bench import problem

CHANNEL = "gyro.y"


def test_drift_of_one_channel_is_told_by_that_of_the_others():
    _, made = problem()
    rows = made.rows()
    expected = expected_levels(rows)
    own = np.array([c.group in DRIFT and c.name.startswith(CHANNEL) for c in rows.components])
    raised = np.where(own, 20.0 * expected, expected)
    usual = usual_levels(rows, raised, (CHANNEL,))
    assert usual is not None
    assert (usual[~own] == raised[~own]).all()
    np.testing.assert_allclose(usual[own], expected[own], rtol=1e-6)
    # What the covariance of all logarithms says of these, given the others.
    covariance = np.linalg.inv(prior_precision(rows))
    others = np.where(own, 20.0, 3.0) * expected
    told = covariance[np.ix_(own, ~own)] @ np.linalg.solve(
        covariance[np.ix_(~own, ~own)], np.full((~own).sum(), np.log(3.0))
    )
    usual = usual_levels(rows, others, (CHANNEL,))
    assert usual is not None
    np.testing.assert_allclose(usual[own], expected[own] * np.exp(told), rtol=1e-6)


def test_drift_that_is_hardly_raised_is_as_it_is():
    _, made = problem()
    rows = made.rows()
    expected = expected_levels(rows)
    assert usual_levels(rows, 0.9 * RAISED * expected, (CHANNEL,)) is None
    own = np.array([CHANNEL in c.name for c in rows.components])
    assert usual_levels(rows, np.where(own, 0.01, 1.0) * expected, (CHANNEL,)) is None
