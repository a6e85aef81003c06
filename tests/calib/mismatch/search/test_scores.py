"""Evidence under levels of noise."""

import pytest

from calib.mismatch.noise.noise import (
    expected_levels,
)
from calib.mismatch.search.scores import _swap
from calib.recording import CHANNELS

from ..bench import problem


def test_levels_beside_an_effect_are_sought_from_closures_without_it():
    _, self_mode = problem()
    rows = self_mode.rows()
    base = expected_levels(rows)
    start = _swap(rows, base, 0.1 * base, ("gyro.x",))
    for component, ratio in zip(rows.components, start / base, strict=True):
        own = component.name.split(" ")[0] not in set(CHANNELS) - {"gyro.x"}
        assert ratio == pytest.approx(0.1 if own else 1.0), component.name
