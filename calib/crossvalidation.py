"""What a calibration is worth on poses that it has not seen."""

from __future__ import annotations

import numpy as np

from calib.poses import Poses
from calib.solvers.base import AccelSolver
from calib.types import FloatArray


def leave_one_out(poses: Poses, solver: AccelSolver, *, gravity: float) -> FloatArray:
    """Return, for each pose, ``|corrected mean| - gravity`` by the fit of all the others, m/s².

    Parameters
    ----------
    poses : Poses
        One more than the solver needs.
    solver : AccelSolver
    gravity : float, m/s²

    Returns
    -------
    (k,) array, m/s²

    Raises
    ------
    InsufficientMotionError
        If the poses without one do not determine the fit.
    """
    every = np.arange(len(poses))
    out = np.empty(len(poses))
    for k in every:
        fit = solver.solve(poses.select(every != k), gravity=gravity)
        out[k] = np.linalg.norm(fit.triad.correct(poses.accel[k : k + 1])) - gravity
    return out
