"""Gyroscope by static bias, then scale from Euler angles between static poses.

Model, per axis: ``w_m = s w + b + n``. The bias is the mean rate at rest. The scale factors are
those for which gravity's direction, carried from pose to pose by the Euler angles' differential
equation (paper, eq. 9), agrees with the accelerometer's (eq. 8)::

    d(roll)/dt  = w_x + (w_y sin(roll) + w_z cos(roll)) tan(pitch)
    d(pitch)/dt = w_y cos(roll) - w_z sin(roll)
    d(yaw)/dt   = (w_y sin(roll) + w_z cos(roll)) / cos(pitch)

The equation is singular at a pitch of 90 degrees, where a turn may well end. So the angles are
counted from a new base every few steps, before the sensor can have turned by a radian, and the
bases are chained. All blocks of a recording are integrated at once, by Runge-Kutta's fourth order.

As in the ``quaternion`` method, each turn is weighed by its noise.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.fit import Fit
from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.rotation import cumulative_quat_segments, quat_multiply
from calib.solvers._closure_solver import solve_closures
from calib.solvers.base import GyroSolver
from calib.solvers.gyro_quaternion import DIAGONAL
from calib.turns import Turns
from calib.types import FloatArray, IntArray

LARGEST = 1.0
"""The sensor turns less than this, rad, from one base to the next."""
LONGEST = 32
"""Steps from one base to the next, at most."""
SUBSTEP = 0.1
"""Steps that turn by more than this, rad, are divided."""


def solve(
    recording: Recording,
    poses: Poses,
    turns: Turns,
    accel: Triad,
    *,
    gravity: float,
    options: Mapping[str, object],
) -> Fit:
    """Solve bias and scale factor error of the gyroscope; see the module for the method.

    Parameters
    ----------
    recording : Recording
    poses, turns : Poses, Turns
    accel : Triad
        The accelerometer's calibration.
    gravity : float, m/s²
        Not needed: only its direction is used.
    options : mapping
        None are known.

    Returns
    -------
    Fit
        Residuals (m, 2) in rad: the closure error of each turn that was used.

    Raises
    ------
    InsufficientMotionError
        If there is no pose.
    NotConvergedError
        If the equations do not settle.
    """
    return solve_closures(
        recording,
        poses,
        turns,
        accel,
        method=GYRO_SOLVER.name,
        model=DIAGONAL,
        static_bias_only=True,
        kinematics=by_euler_angles,
    )


def by_euler_angles(rotvec: FloatArray, first: IntArray) -> FloatArray:
    """Return the quaternions (n, 4) at the end of each step, from identity at each turn's start.

    Over a step of unit length the rate is `rotvec` (n, 3), rad.
    """
    largest = float(np.sqrt((rotvec**2).sum(axis=1).max(initial=0.0)))
    width = int(np.clip(LARGEST / max(largest, 1e-9), 1, LONGEST))
    count = np.diff(first)
    blocks = -(-count // width)
    # The block that each step is in, and its place there: (blocks, width), padded with rest.
    within = np.arange(first[-1]) - np.repeat(first[:-1], count)
    block = np.repeat(np.cumsum(blocks) - blocks, count) + within // width
    place = within % width
    rate = np.zeros((int(blocks.sum()), width, 3))
    rate[block, place] = rotvec
    substeps = max(1, int(np.ceil(largest / SUBSTEP)))
    angles = np.zeros((len(rate), 3))
    ends = np.empty_like(rate)
    for k in range(width):
        for _ in range(substeps):
            angles = _runge_kutta(angles, rate[:, k], 1 / substeps)
        ends[:, k] = angles
    quat = _quat_from_euler(ends)
    edges = np.concatenate([[0], np.cumsum(blocks)])
    bases = cumulative_quat_segments(quat[:, -1], edges)
    # A block's base is the end of the one before; a turn begins from identity.
    bases = np.roll(bases, 1, axis=0)
    bases[edges[:-1]] = [1.0, 0.0, 0.0, 0.0]
    return quat_multiply(bases[block], quat[block, place])


def _runge_kutta(angles: FloatArray, rate: FloatArray, step: float) -> FloatArray:
    k1 = euler_rates(angles, rate)
    k2 = euler_rates(angles + 0.5 * step * k1, rate)
    k3 = euler_rates(angles + 0.5 * step * k2, rate)
    k4 = euler_rates(angles + step * k3, rate)
    return angles + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def euler_rates(angles: FloatArray, rate: FloatArray) -> FloatArray:
    """Return d(roll, pitch, yaw)/dt, (n, 3): the paper's equation 9."""
    sin, cos = np.sin(angles[:, :2]), np.cos(angles[:, :2])
    level = sin[:, 0] * rate[:, 1] + cos[:, 0] * rate[:, 2]
    return np.stack(
        [
            rate[:, 0] + level * sin[:, 1] / cos[:, 1],
            cos[:, 0] * rate[:, 1] - sin[:, 0] * rate[:, 2],
            level / cos[:, 1],
        ],
        axis=1,
    )


def _quat_from_euler(angles: FloatArray) -> FloatArray:
    """Return quaternions (..., 4) of roll, pitch, yaw: the frame turned by z, then y, then x."""
    half = 0.5 * angles
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(half), -1, 0), np.moveaxis(np.cos(half), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


GYRO_SOLVER = GyroSolver(
    "euler", "static bias, then scale from Euler angles between static poses", solve
)
