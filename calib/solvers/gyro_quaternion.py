"""Gyroscope by static bias, then scale from quaternions between static poses.

Model, per axis: ``w_m = s w + b + n``. The bias is the mean rate at rest. The scale factors are
those for which gravity's direction, carried from pose to pose by the quaternion's differential
equation (paper, eq. 10; its matrix is eq. 11), agrees with the accelerometer's (eq. 8). The
equation is integrated step by step in closed form, which has no singular attitude.

The paper minimises the plain sum of squares from a starting guess. Here each turn is weighed by its
noise, the search is Gauss-Newton with analytic derivatives, and turns that do not fit are left out.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.fit import Fit
from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.solvers._closure_solver import solve_closures
from calib.solvers.base import GyroSolver
from calib.turns import Turns

DIAGONAL = np.arange(12) < 6
"""The paper's model: bias and scale factors, no misalignment."""


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
    )


GYRO_SOLVER = GyroSolver(
    "quaternion", "static bias, then scale from quaternions between static poses", solve
)
