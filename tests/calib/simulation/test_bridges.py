"""Bridges over holes."""

import numpy as np
import pytest

from calib.simulation.bridges import EASE, bridged, holes


def test_long_steps_are_holes_and_uneven_ones_are_none() -> None:
    time = np.array([0.0, 0.01, 0.02, 0.04, 0.05, 0.07, 0.08, 0.13, 0.14])
    assert np.flatnonzero(holes(time)).tolist() == [6]
    assert not holes(np.array([0.0, 1.0, 3.0, 4.0, 5.0])).any()
    assert holes(np.array([0.0, 1.0, 2.0, 5.0, 6.0])).sum() == 1


def test_nothing_is_bridged_where_nothing_is_missing() -> None:
    time, values = np.arange(5.0), np.ones((5, 1))
    found = bridged(time, values)
    assert found[0] is time
    assert found[1] is values
    assert len(bridged(time[:1], values[:1])[0]) == 1


@pytest.mark.parametrize("length", [0.04, 0.3, 5.0, 1e6])
def test_a_bridge_has_bounded_speed_and_acceleration(length: float) -> None:
    """It leaves with the speed at one edge, arrives with that at the other, and is even between."""
    before, after = np.arange(0.0, 1.001, 0.01), np.arange(0.0, 1.001, 0.01) + 1.0 + length
    time = np.concatenate((before, after))
    values = np.concatenate((2.0 * before, 5.0 - 3.0 * (after - after[0])))[:, None]
    at, found = bridged(time, values)
    assert len(at) < len(time) + 400
    np.testing.assert_array_equal(found[np.isin(at, time)], values)
    assert np.diff(at).min() > 0.004
    speed = np.diff(found[:, 0]) / np.diff(at)
    steady = 3.0 / length
    assert np.abs(speed).max() < 3.0 + 3.0 * steady
    change = np.diff(speed) / (0.5 * (at[2:] - at[:-2]))
    assert np.abs(change).max() < 1.2 * (3.0 + 2.0 * steady) / min(EASE, 0.5 * length)


def test_rows_alone_between_holes_stay_where_they_are() -> None:
    time = np.concatenate((np.arange(0.0, 1.0, 0.01), [2.0], [3.0, 3.01], 4.0 + np.arange(90) / 90))
    values = np.sin(time)[:, None]
    at, found = bridged(time, values)
    np.testing.assert_array_equal(found[np.isin(at, time)], values)
    assert np.abs(found).max() < 1.3
