"""The paper's linear fit in nine unknowns with nothing dropped, in closed form."""

from __future__ import annotations

import numpy as np

from calib.errors import InsufficientMotionError
from calib.fit import Fit
from calib.model import Triad
from calib.poses import Poses
from calib.solvers.base import AccelSolver
from calib.solvers.quadric import Quadric, algebraic_fit, fit_quadric, lower_factor
from calib.types import FloatArray


def solve(poses: Poses, *, gravity: float) -> Fit:
    """Estimate accelerometer bias, scale factor and misalignment from static poses.

    Model: ``measured = (I + S + M) @ true + bias``, M strictly lower triangular, ``|true| = g``.

    With ``K = inv(I + S + M)`` and ``d = K b``, ``|K a - d|² = g²`` divided by k33² is linear in
    nine unknowns. Their symmetric 3 x 3 part is ``K.T K / k33²``; its factor is K exactly, and
    ``b = inv(K) d``. No starting guess, one pass over the data.

    Parameters
    ----------
    poses : Poses
        At least nine.
    gravity : float, m/s²

    Raises
    ------
    InsufficientMotionError
        If the poses do not determine all nine parameters.

    References
    ----------
    .. [1] S. Ranjbaran, A. Roudbari, S. Ebadollahi, JECEI 6(1), 2018, eqs. (1) to (3), before the
       small products are dropped.
    """
    quadric = fit_quadric(poses.accel)
    matrix, bias = ellipsoid(quadric, gravity=gravity)
    return algebraic_fit("exact", poses, quadric, Triad.from_matrix(matrix, bias), gravity=gravity)


def ellipsoid(quadric: Quadric, *, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return ``I + S + M`` and the bias of a fitted quadric."""
    centre = np.linalg.solve(quadric.matrix, quadric.linear)
    square = float(centre @ quadric.linear) - quadric.constant
    if square <= 0:
        raise InsufficientMotionError(
            "the readings at rest lie on no ellipsoid: too few directions for this noise, or they "
            "were not taken at rest; record more poses in all directions"
        )
    inverse = lower_factor(quadric.matrix) * (gravity / np.sqrt(square) / quadric.size)
    return np.linalg.inv(inverse) * np.tri(3), quadric.centre + quadric.size * centre


ACCEL_SOLVER = AccelSolver(
    "exact", "closed form, nothing dropped; fastest, biased where the noise is large", solve
)
