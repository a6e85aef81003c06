"""Stretches in which an accelerometer reads far less than gravity."""

import numpy as np

from calib.weightless import find_weightless

UP = np.array([0.0, 0.0, 9.80665])


def test_what_lasts_longer_than_a_fall_is_found() -> None:
    rng = np.random.default_rng(1)
    accel = UP + 0.03 * rng.standard_normal((6000, 3))
    accel[2000:3000] -= 0.9 * UP
    ((start, stop),) = find_weightless(accel, 0.01)
    assert abs(start - 2000) <= 50
    assert abs(stop - 3000) <= 50


def test_falls_spins_and_shaking_are_none() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 60.0, 0.01)
    dropped = np.tile(UP, (6000, 1))
    dropped[3000:3100] = 0.0
    spun = 9.80665 * np.stack((np.sin(12 * time), np.cos(12 * time), 0 * time), axis=1)
    shaken = UP + 25.0 * rng.standard_normal((6000, 3))
    for accel in (dropped, spun, shaken):
        assert find_weightless(accel, 0.01) == []


def test_short_and_unclocked_recordings_have_none() -> None:
    assert find_weightless(np.zeros((10, 3)), 0.01) == []
    assert find_weightless(np.zeros((1000, 3)), 0.0) == []
