"""What the numbers of a finding must be for its name to stand."""

import pytest

from calib.calibration import Quantity
from calib.mismatch.search.explain import _is_whole


@pytest.mark.parametrize(
    ("value", "sigma", "whole"),
    [
        (1.02, 0.1, True),
        (-2.9, 0.1, True),
        (1.4, 0.05, False),
        (0.1, 0.1, False),
        (-115.0, 13.0, False),
    ],
)
def test_samples_are_lost_whole_or_not_at_all(value, sigma, whole):
    assert _is_whole(Quantity(value, sigma, "samples")) is whole
