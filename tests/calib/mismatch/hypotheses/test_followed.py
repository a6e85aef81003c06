"""What a residual may follow that no catalogue has a name for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.hypotheses.followed import LEVEL, sign_of
from calib.mismatch.hypotheses.rivals import SIGN

from ..bench import left_of, motion_of, problem, recording, with_added


@pytest.mark.parametrize("count", [0.01, 0.02])
@pytest.mark.long
def test_what_a_host_cuts_towards_zero_is_no_cube(count: float) -> None:
    real = recording(seed=8, poses=20)
    cut = replace(real, accel=count * np.trunc(real.accel / count))
    assert left_of(cut) == [(SIGN, ("accel.x", "accel.y", "accel.z"))]


@pytest.mark.long
def test_a_dead_zone_of_one_axis_goes_by_its_sign() -> None:
    real = recording(seed=8, poses=20)
    assert left_of(with_added(real, {"accel.y": 0.01 * np.sign(real.accel[:, 1])})) == [
        (SIGN, ("accel.y",))
    ]


@pytest.mark.parametrize(
    ("channel", "axis", "size"), [("accel.x", 1, 0.03), ("gyro.x", 2, 5e-4), ("gyro.z", 0, 5e-4)]
)
@pytest.mark.long
def test_what_heat_makes_of_gravity_is_no_bias_that_follows_temperature(
    channel: str, axis: int, size: float
) -> None:
    real = recording(seed=8, poses=24)
    assert real.temperature is not None
    warm = (real.temperature - real.temperature.mean()) / np.ptp(real.temperature)
    felt = size * warm * motion_of(real).gravity_direction[:, axis]
    assert left_of(with_added(real, {channel: felt})) == [
        ("temperature and direction of gravity", (channel,))
    ]


def test_a_sign_is_that_of_what_is_read_with_its_bias() -> None:
    _, made = problem()
    rows = made.rows()
    bias = made.twin.model.accel.bias
    assert np.abs(bias).max() > 0.1
    for c in range(3):
        read = rows.state.force[:, c] + bias[c]
        clear = np.abs(read) > 0.2
        np.testing.assert_allclose(sign_of(rows, c)[clear, 0], np.sign(read[clear]), atol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize(("axis", "level"), [(2, 3.4), (0, -5.0)])
def test_a_step_at_a_level_of_an_output_is_no_asymmetry(axis: int, level: float) -> None:
    real = recording(seed=8, poses=24)
    channel = f"accel.{'xyz'[axis]}"
    step = 0.012 * (real.accel[:, axis] > level)
    assert left_of(with_added(real, {channel: step})) == [(LEVEL, (channel,))]
