"""Splines through what is known of a motion."""

import numpy as np
import pytest

from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulation.kinematics import Turning
from calib.simulation.through import motion_through, path_through, path_under
from calib.types import FloatArray

TREMOR = 2 * np.pi * 10.0


def shaken(time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return orientations, positions and accelerations of a hand that trembles at 10 Hz."""
    wave = np.sin(TREMOR * time)[:, None]
    first = quat_from_rotvec(0.02 * wave * [1.0, 0.0, 0.0])
    slow = quat_from_rotvec(np.sin(3.0 * time)[:, None] * [0.0, 0.6, 0.8])
    position = 1e-3 * wave * [1.0, -2.0, 0.5]
    return quat_multiply(slow, first), position, -(TREMOR**2) * position


@pytest.mark.parametrize(("rate", "lost"), [(50.0, 5e-3), (100.0, 1e-4)])
def test_a_tremor_keeps_its_acceleration(rate: float, lost: float) -> None:
    """A cubic spline loses 9 % of it at 50 Hz, and 3 % at 100 Hz."""
    time = 7.0 + np.arange(0.0, 6.0, 1 / rate)
    quat, position, acceleration = shaken(time)
    quat[::3] *= -1  # the same orientations
    found = motion_through(time, quat, path_through(time, position))(time)
    inner = slice(20, -20)
    assert found.path is not None
    error = (found.path.acceleration - acceleration)[inner]
    assert np.abs(error).max() < lost * np.abs(acceleration).max()
    expected = _turning(time)
    for name in ("rate", "rate_dot"):
        true = getattr(expected, name)
        left = (getattr(found.turning, name) - true)[inner]
        assert np.abs(left).max() < lost * np.abs(true).max(), name


def _turning(time: FloatArray) -> Turning:
    """Return the same orientation's rate and angular acceleration, from very fine steps."""
    fine = np.arange(time[0] - 0.1, time[-1] + 0.1, 1e-3)
    quat, position, _ = shaken(fine)
    return motion_through(fine, quat, path_through(fine, position))(time).turning


def test_rate_is_the_change_of_orientation_and_rate_dot_that_of_rate() -> None:
    time = np.arange(0.0, 3.0, 0.02)
    quat, position, acceleration = shaken(time)
    motion = motion_through(time, quat, path_through(time, position))
    at, h = np.linspace(0.3, 2.7, 50), 1e-5
    before, now, after = (motion(at + step) for step in (-h, 0.0, h))
    slope = (after.turning.quat - before.turning.quat) / (2 * h)
    back = now.turning.quat * [1.0, -1.0, -1.0, -1.0]
    np.testing.assert_allclose(2 * quat_multiply(back, slope)[:, 1:], now.turning.rate, atol=1e-6)
    change = (after.turning.rate - before.turning.rate) / (2 * h)
    np.testing.assert_allclose(change, now.turning.rate_dot, atol=1e-4)
    under = motion_through(time, quat, path_under(time, acceleration))
    paths = [under(at + step).path for step in (-h, 0.0, h)]
    assert all(path is not None for path in paths)
    speed = (paths[2].position - paths[0].position) / (2 * h)
    np.testing.assert_allclose(speed, paths[1].velocity, atol=1e-6)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8, 9])
def test_few_points_have_a_spline_of_lower_degree(count: int) -> None:
    time = np.arange(float(count))
    quat = quat_from_rotvec(np.outer(0.1 * time, [0.0, 0.0, 1.0]))
    found = motion_through(time, quat, path_through(time, np.zeros((count, 3))))(time)
    np.testing.assert_allclose(found.turning.quat, quat, atol=1e-9)
    np.testing.assert_allclose(found.turning.rate[:, 2], 0.1, atol=1e-3)
