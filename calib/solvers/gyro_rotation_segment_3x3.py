"""Gyroscope by attitude closure: bias, scale and full misalignment from turns about any axes.

Model, per sample: ``w_m = (I + S + M) w + b + n``, M full 3x3 (zero diagonal), so that the
corrected rate is in the accelerometer's frame.

Two kinds of equations are solved together, by Gauss-Newton with analytic sensitivities:

- at each pose ``mean(w_m) = b + noise``;
- for each turn ``u_before = R(b, S, M) u_after``, where ``u`` is gravity's direction from the
  calibrated accelerometer and R the rotation integrated from the corrected rate: two equations a
  turn, as heading is free. See `calib.closure` for R and its derivatives.

The noise of a turn is that of the two directions, of the integrated rate, and an inflation
``tau²`` for what the model lacks, estimated by restricted maximum likelihood. Two turns that meet
at a pose share its direction's error: the weight matrix knows that. A turn or a pose that does not
fit is given a free shift of its own, which leaves it out and keeps the rest: without a bumped pose,
the turns before and after it still close as one. A pose in a hand that sways is followed to its
ends (`calib.directions`).

The bias is its mean over the recording. Its covariance is that of the bias at any one moment of the
recording: where the means of the poses scatter significantly beyond their noise, the variance of
that scatter is in it, as a drift does not average out for whoever uses the bias later. What the
bias was before and after the recording it does not know. In a turn the bias is that of the poses
beside it. The covariance is for the accelerometer as given; ``accel_sensitivity`` carries the
accelerometer's errors into it.

References
----------
.. [1] Ranjbaran, Roudbari, Ebadollahi, JECEI 6(1), 2018, eqs. (12) to (14): the per-axis method
   that this one generalises.
.. [2] Patterson, Thompson, "Recovery of inter-block information when block sizes are unequal",
   Biometrika 58(3), 1971: restricted maximum likelihood.
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


def solve(
    recording: Recording,
    poses: Poses,
    turns: Turns,
    accel: Triad,
    *,
    gravity: float,
    options: Mapping[str, object],
) -> Fit:
    """Solve bias, scale factor error and misalignment of the gyroscope from attitude closure.

    Parameters
    ----------
    recording : Recording
    poses, turns : Poses, Turns
    accel : Triad
        The accelerometer's calibration; its frame is the one that the gyroscope is aligned to.
    gravity : float, m/s²
        Not needed: only its direction is used.
    options : mapping
        None are known.

    Returns
    -------
    Fit
        Residuals (m, 2) in rad: the closure error of each turn that was used, in the horizontal
        plane. ``intervals`` says when these turns were.

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
        model=np.ones(12, bool),
        static_bias_only=False,
    )


GYRO_SOLVER = GyroSolver(
    "rotation_segment_3x3",
    "bias, scale and full misalignment to the accelerometer from turns about any axes (default)",
    solve,
)
