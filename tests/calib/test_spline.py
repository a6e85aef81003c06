"""Splines, against SciPy's."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from calib.spline import spline_at, spline_between, spline_slopes


@pytest.mark.parametrize("points", [4, 5, 12, 300])
def test_values_and_slopes_are_those_of_scipy(points: int) -> None:
    rng = np.random.default_rng(points)
    time = 1e3 + np.cumsum(rng.uniform(0.5, 2.0, points))
    values = rng.normal(size=(points, 3))
    known = CubicSpline(time, values)
    at = np.concatenate((time, rng.uniform(time[0], time[-1], 50)))
    np.testing.assert_allclose(spline_at(time, values, at), known(at), atol=1e-9)
    np.testing.assert_allclose(spline_slopes(time, values), known(time, 1), atol=1e-9)


def test_rows_are_splines_of_their_own() -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.5, 2.0, (5, 8)), axis=1)
    values = rng.normal(size=(5, 8, 2))
    slopes = spline_slopes(time, values)
    gap = np.array([[0, 3], [1, 4], [2, 5], [3, 6], [6, 6]])
    row = np.arange(5)[:, None]
    at = 0.3 * time[row, gap] + 0.7 * time[row, gap + 1]
    found = spline_between(
        time.ravel(), values.reshape(-1, 2), slopes.reshape(-1, 2), 8 * row + gap, at
    )
    for k in range(5):
        known = CubicSpline(time[k], values[k])
        np.testing.assert_allclose(slopes[k], known(time[k], 1), atol=1e-9)
        np.testing.assert_allclose(found[k], known(at[k]), atol=1e-9)
