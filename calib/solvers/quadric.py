"""What the accelerometer methods share: the algebraic fit of a quadric, and the making of a `Fit`.

With ``T = I + S + M`` (lower triangular) and ``K = inv(T)``, readings at rest obey
``|K (a - b)|² = g²``. Multiplied out and divided by k33² (the coefficient of z²), that is linear in
nine unknowns, whatever their number of readings: everything is read off the 10 x 10 matrix of
moments ``sum(row.T @ row)``.

References
----------
.. [1] S. Ranjbaran, A. Roudbari, S. Ebadollahi, JECEI 6(1), 2018, eqs. (1) to (4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calib.errors import InsufficientMotionError
from calib.fit import Exclusion, Fit
from calib.model import Triad
from calib.poses import Poses
from calib.types import FloatArray

NAMES = (
    "accel.bias.x",
    "accel.bias.y",
    "accel.bias.z",
    "accel.scale_factor_error.x",
    "accel.scale_factor_error.y",
    "accel.scale_factor_error.z",
    "accel.misalignment.yx",
    "accel.misalignment.zx",
    "accel.misalignment.zy",
)
UNITS = ("m/s²",) * 3 + ("1",) * 3 + ("rad",) * 3
ROWS, COLUMNS = (0, 1, 2, 1, 2, 2), (0, 1, 2, 0, 0, 1)
"""Where the last six parameters stand in T: sx, sy, sz, m1, m2, m3."""
CHUNK = 8192
"""Readings per block of the design matrix: 10 columns of them stay in the second-level cache."""
ENOUGH = 1e-8
"""Smallest eigenvalue of the scaled moments that still determines: (condition number)**-2."""


@dataclass(frozen=True, eq=False)
class Quadric:
    """The algebraic fit ``u.T Q u - 2 v.T u + c = 0``; ``u = (a - centre) / size``, Q[2, 2] = 1."""

    matrix: FloatArray
    linear: FloatArray
    constant: float
    centre: FloatArray
    size: float
    moments: FloatArray
    condition_number: float

    def in_raw_units(self) -> tuple[FloatArray, FloatArray, float]:
        """Return Q, v and c for ``u = a``."""
        matrix = self.matrix
        linear = self.linear * self.size + matrix @ self.centre
        constant = (
            self.constant * self.size**2
            + 2 * self.size * float(self.linear @ self.centre)
            + float(self.centre @ matrix @ self.centre)
        )
        return matrix, linear, constant


def fit_quadric(accel: FloatArray) -> Quadric:
    """Return the quadric through (n, 3) readings: least squares in nine unknowns.

    Raises
    ------
    InsufficientMotionError
        If the readings do not determine it.
    """
    n = len(accel)
    if n < 9:
        raise InsufficientMotionError(
            f"{n} poses seen; this method needs at least 9 in different directions: record more, "
            "or use maximum_likelihood, which gives what these determine"
        )
    # Any centre and size near the readings' own condition the moments: of a thousand, to be quick.
    few = accel[:: max(1, n // 1000)]
    centre = 0.5 * (few.min(axis=0) + few.max(axis=0))
    size = float(np.sqrt(np.square(few - centre).sum(axis=1).mean())) or 1.0
    moments = _moments(accel, centre, 1.0 / size)
    unit = 1.0 / np.sqrt(np.maximum(np.diag(moments), np.finfo(float).tiny))
    scaled = moments * unit[:, None] * unit
    values, vectors = np.linalg.eigh(scaled[:9, :9])
    if values[0] < ENOUGH * values[-1]:
        raise InsufficientMotionError(
            f"the {n} poses do not determine an ellipsoid (condition number "
            f"{np.sqrt(values[-1] / max(values[0], 1e-300)):.0e}): record poses in all directions, "
            "not in a plane or a cone, or use maximum_likelihood, which gives what these determine"
        )
    x = -unit[:9] * (vectors @ ((vectors.T @ scaled[:9, 9]) / values)) / unit[9]
    matrix = np.array([[x[0], x[1], x[2]], [x[1], x[3], x[4]], [x[2], x[4], 1.0]])
    return Quadric(
        matrix, x[5:8], float(x[8]), centre, size, moments, float(np.sqrt(values[-1] / values[0]))
    )


def _moments(accel: FloatArray, centre: FloatArray, factor: float) -> FloatArray:
    """Return the (10, 10) moments of the rows [xx, 2xy, 2xz, yy, 2yz, -2x, -2y, -2z, 1, zz]."""
    n = len(accel)
    moments = np.zeros((10, 10))
    row = np.empty((10, min(n, CHUNK)))
    for begin in range(0, n, CHUNK):
        u = (accel[begin : begin + CHUNK] - centre).T * factor
        a = row[:, : u.shape[1]]
        x, y, z = u
        np.multiply(u, -2.0, out=a[5:8])
        np.multiply(x, x, out=a[0])
        np.multiply(a[5], -y, out=a[1])
        np.multiply(a[5], -z, out=a[2])
        np.multiply(y, y, out=a[3])
        np.multiply(a[6], -z, out=a[4])
        a[8] = 1.0
        np.multiply(z, z, out=a[9])
        moments += a @ a.T
    return moments


def lower_factor(matrix: FloatArray) -> FloatArray:
    """Return the lower triangular K, positive diagonal, with ``K.T @ K = matrix``.

    Raises
    ------
    InsufficientMotionError
        If `matrix` is not positive definite: the readings lie on no ellipsoid.
    """
    try:
        factor = np.linalg.cholesky(matrix[::-1, ::-1])
    except np.linalg.LinAlgError as e:
        raise InsufficientMotionError(
            "the readings at rest lie on no ellipsoid: too few directions for this noise, or they "
            "were not taken at rest; record more poses in all directions"
        ) from e
    return np.asarray(factor[::-1, ::-1].T, np.float64)


def parameters_of(matrix: FloatArray, bias: FloatArray) -> FloatArray:
    """Return the nine values in the order of `NAMES`."""
    values = matrix[ROWS, COLUMNS] - np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    return np.concatenate((bias, values))


def triad_of(values: FloatArray) -> Triad:
    """Return the triad of nine values in the order of `NAMES`."""
    matrix = np.eye(3)
    matrix[ROWS, COLUMNS] += values[3:]
    return Triad.from_matrix(matrix, values[:3])


def algebraic_fit(
    method: str, poses: Poses, quadric: Quadric, triad: Triad, *, gravity: float
) -> Fit:
    """Return the `Fit` of an algebraic method.

    To first order in the noise the algebraic fit is least squares in ``|K (a - b)| - g`` with equal
    weights, so its covariance is ``s² inv(J.T J)``; ``J.T J`` follows from the moments. s² is
    that of the residuals, but not less than the poses' own covariances make of it.
    """
    matrix = triad.matrix
    inverse = solve_triangular(matrix, np.eye(3), lower=True)
    residuals = _lengths(poses.accel, inverse, triad.bias) - gravity
    freedom = len(poses) - 9
    every = poses.accel_covariance
    common = every[0] if every.strides[0] == 0 else every.mean(axis=0)
    expected = np.trace(inverse @ common @ inverse.T) / 3
    seen = float(residuals @ residuals) / freedom if freedom else 0.0
    columns = _jacobian_in_moments(quadric, inverse, triad.bias) / gravity
    information = columns.T @ quadric.moments @ columns
    covariance = max(expected, seen) * np.linalg.inv(information)
    return make_fit(
        method,
        poses,
        triad,
        covariance,
        residuals,
        degrees_of_freedom=freedom,
        condition_number=quadric.condition_number,
    )


def _lengths(accel: FloatArray, inverse: FloatArray, bias: FloatArray) -> FloatArray:
    """Return ``|K (a - b)|`` of (n, 3) readings, in blocks."""
    shift = (inverse @ bias)[:, None]
    out = np.empty(len(accel))
    for begin in range(0, len(accel), CHUNK):
        true = inverse @ accel[begin : begin + CHUNK].T - shift
        true *= true
        np.sqrt(true[0] + true[1] + true[2], out=out[begin : begin + CHUNK])
    return out


def _jacobian_in_moments(quadric: Quadric, inverse: FloatArray, bias: FloatArray) -> FloatArray:
    """Return (10, 9): the Jacobian times |f| as combinations of the design's columns."""
    # f_j = sum_k K_jk (size u_k + centre_k - b_k): coefficients of (u, 1).
    true = np.column_stack((inverse * quadric.size, inverse @ (quadric.centre - bias)))
    normal = inverse.T @ true
    ones = np.array([0.0, 0.0, 0.0, 1.0])
    out = np.zeros((10, 9))
    for p in range(9):
        left = normal[p] if p < 3 else normal[ROWS[p - 3]]
        right = ones if p < 3 else true[COLUMNS[p - 3]]
        q = -0.5 * (np.outer(left, right) + np.outer(right, left))
        # rows: xx, 2xy, 2xz, yy, 2yz, -2x, -2y, -2z, 1, zz
        out[:, p] = [q[0, 0], q[0, 1], q[0, 2], q[1, 1], q[1, 2], *-q[:3, 3], q[3, 3], q[2, 2]]
    return out


def make_fit(
    method: str,
    poses: Poses,
    triad: Triad,
    covariance: FloatArray,
    residuals: FloatArray,
    *,
    degrees_of_freedom: int,
    condition_number: float,
    undetermined: tuple[str, ...] = (),
    advice: tuple[str, ...] = (),
    excluded: tuple[Exclusion, ...] = (),
) -> Fit:
    """Return the `Fit` of the nine parameters; residuals (n,) are ``|K (a - b)| - g``."""
    return Fit(
        method,
        triad,
        NAMES,
        parameters_of(triad.matrix, triad.bias),
        UNITS,
        covariance,
        residuals[:, None],
        "m/s²",
        poses.interval,
        degrees_of_freedom,
        condition_number,
        undetermined,
        advice,
        excluded,
    )
