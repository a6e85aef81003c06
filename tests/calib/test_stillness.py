"""Statistics of short blocks and windows."""

import numpy as np
import pytest
from scipy.ndimage import median_filter

from calib.stillness import moving_median


@pytest.mark.parametrize("number", [1, 2, 3, 10, 11, 12, 9000])
def test_moving_medians_are_those_of_a_median_filter(number: int) -> None:
    values = np.random.default_rng(number).normal(size=(number, 3))
    width = min(11, number)
    expected = median_filter(values, size=(width, 1), mode="nearest")
    np.testing.assert_array_equal(moving_median(values, width), expected)
