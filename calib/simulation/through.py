"""Motion through what is known of it at some times: splines of degree 7.

Rate and acceleration are their exact derivatives. With p a spline through quaternions::

    q = p / |p|,  w = 2 Im(p* dp/dt) / |p|²,  dw/dt = (2 Im(p* d²p/dt²) - w d|p|²/dt) / |p|²
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from calib.rotation import quat_multiply
from calib.simulation.kinematics import Kinematics, Path, Turning
from calib.types import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

DEGREE = 7
"""Of the interpolating spline: a sinusoid at a fifth of the rate is off by 5e-6; by a cubic one 0.3
%, and its second derivative by a tenth."""


def spline_through(time: FloatArray, values: FloatArray) -> BSpline:
    """Return the spline, over time since the first, through (n, k) values at (n,) times.

    It has as high a degree as so few points allow.
    """
    from scipy.interpolate import make_interp_spline  # a third of a second to import

    return make_interp_spline(time - time[0], values, k=min(DEGREE, (len(time) - 2) | 1))


def one_sign(quat: FloatArray) -> FloatArray:
    """Return the quaternions with signs such that neighbours are near."""
    flip = np.where(np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0, -1.0, 1.0)
    return np.asarray(quat * np.concatenate([[1.0], np.cumprod(flip)])[:, None])


def turning_along(spline: BSpline, since: FloatArray) -> Turning:
    """Return how it turns along a spline through quaternions, (m,) s from its start."""
    p, slope, bend = (spline(since, nu=order) for order in range(3))
    square = np.einsum("ij,ij->i", p, p)[:, None]
    back = p * [1.0, -1.0, -1.0, -1.0]
    rate = 2 * quat_multiply(back, slope)[:, 1:] / square
    growth = 2 * np.einsum("ij,ij->i", p, slope)[:, None]
    rate_dot = (2 * quat_multiply(back, bend)[:, 1:] - rate * growth) / square
    return Turning(p / np.sqrt(square), rate, rate_dot)


def path_through(time: FloatArray, position: FloatArray) -> Callable[[FloatArray], Path]:
    """Return the path, over time since the first, through positions (n, 3) in frame n."""
    spline = spline_through(time, position)
    return lambda since: Path(spline(since), spline(since, nu=1), spline(since, nu=2))


def path_under(time: FloatArray, acceleration: FloatArray) -> Callable[[FloatArray], Path]:
    """Return the path, over time since the first, from rest under accelerations (n, 3)."""
    force = spline_through(time, acceleration)
    velocity, position = force.antiderivative(1), force.antiderivative(2)
    return lambda since: Path(position(since), velocity(since), force(since))


def motion_through(
    time: FloatArray, quat: FloatArray, path: Callable[[FloatArray], Path]
) -> Callable[[FloatArray], Kinematics]:
    """Return the motion through orientations (n, 4), along a path; as at its ends beyond them."""
    spline = spline_through(time, one_sign(quat))

    def at(when: FloatArray) -> Kinematics:
        since = np.clip(when, time[0], time[-1]) - time[0]
        return Kinematics(turning_along(spline, since), path(since))

    return at
