"""The published improved least squares: the small products dropped, and equation 4's reading."""

from __future__ import annotations

import numpy as np

from calib.errors import InsufficientMotionError
from calib.fit import Fit
from calib.model import Triad
from calib.poses import Poses
from calib.solvers.base import AccelSolver
from calib.solvers.quadric import algebraic_fit, fit_quadric
from calib.types import FloatArray


def solve(poses: Poses, *, gravity: float) -> Fit:
    """Estimate accelerometer bias, scale factor and misalignment as published.

    Model: ``measured = (I + S + M) @ true + bias``, M strictly lower triangular, ``|true| = g``.

    Equation 3 drops k21² + k31² beside k11², k31 k32 beside k21 k22, and k32² beside k22², and
    equation 4 reads the bias as ``b_i = d_i s_i`` and each m from a single element of
    ``K = inv(I + S + M)``. Equation 4 prints ``k21 = m1 / s_y`` and its like; the inverse of
    a lower triangular matrix has ``k21 = -m1 / (s_x s_y)`` and, to first order,
    ``k31 = -m2 / (s_x s_z)`` and ``k32 = -m3 / (s_y s_z)``, which are used here. Likewise the bias
    columns of equation 3 have a minus sign here, so that d is ``K b``.

    What is dropped is of second order in misalignment and of first order in misalignment times
    bias: it stays as a bias of the estimate however small the noise. Use ``exact`` instead.

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
    .. [1] S. Ranjbaran, A. Roudbari, S. Ebadollahi, JECEI 6(1), 2018, eqs. (3) and (4).
    """
    quadric = fit_quadric(poses.accel)
    k, d = simplified_factors(*quadric.in_raw_units(), gravity=gravity)
    s = 1.0 / np.diag(k)
    matrix = np.diag(s)
    for i, j in ((1, 0), (2, 0), (2, 1)):
        matrix[i, j] = -k[i, j] * s[i] * s[j]
    return algebraic_fit(
        "published", poses, quadric, Triad.from_matrix(matrix, d * s), gravity=gravity
    )


def simplified_factors(
    matrix: FloatArray, linear: FloatArray, constant: float, *, gravity: float
) -> tuple[FloatArray, FloatArray]:
    """Return K (lower triangular) and d of equation 3, with its small products dropped."""
    k = np.zeros((3, 3))
    d = np.zeros(3)
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise _no_ellipsoid()
    # In units of k33, which the last line finds from the constant.
    k[2] = matrix[2, 0], matrix[2, 1], 1.0
    k[1, 1] = np.sqrt(matrix[1, 1])
    k[1, 0] = matrix[1, 0] / k[1, 1]
    k[0, 0] = np.sqrt(matrix[0, 0])
    d[2] = linear[2]
    d[1] = (linear[1] - k[2, 1] * d[2]) / k[1, 1]
    d[0] = (linear[0] - k[1, 0] * d[1] - k[2, 0] * d[2]) / k[0, 0]
    square = float(d @ d) - constant
    if square <= 0:
        raise _no_ellipsoid()
    k33 = gravity / np.sqrt(square)
    return k * k33, d * k33


def _no_ellipsoid() -> InsufficientMotionError:
    return InsufficientMotionError(
        "the readings at rest lie on no ellipsoid: too few directions for this noise, or they were "
        "not taken at rest; record more poses in all directions"
    )


ACCEL_SOLVER = AccelSolver(
    "published", "the paper's equations 3 and 4, with their simplifications", solve
)
