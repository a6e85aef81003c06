"""Static bias and closure equations of a gyroscope as one weighted, robust least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calib.errors import NotConvergedError
from calib.solvers._closure_noise import Information, Judgement, judge
from calib.solvers._closure_system import COLUMN, ClosureSystem, LeftOut, Linearised
from calib.solvers._gyro_determined import TOLERANCE, determined
from calib.types import BoolArray, FloatArray

START_PRIOR = np.array([0.1] * 3 + [0.1] * 3 + [0.05] * 6)
"""How far from the start value a part may be: rad/s, 1, rad. Only the order in which turns are
taken in depends on it; the answer does not."""

UNAMBIGUOUS = 0.5
"""Turns whose predicted closure is less certain than this, rad, wait for the others."""


@dataclass(frozen=True, eq=False)
class ClosureFit:
    """Parameters from closures and a static bias, and how they came about.

    Parameters
    ----------
    values : (12,) array
    information : (12, 12) array
        Of the data; what was left out adds nothing to it.
    bias_gain : (12, 3) array
        How an error of a bias that the closures do not estimate moves the gradient; else zero.
    direction_gain : (12, k, 2) array
        How two rotations of the direction at each pose move the gradient.
    judgement : Judgement
        Noise beyond the known, and what was left out.
    used : (m,) array of bool
        Turns whose angle was certain enough to be compared with gravity at all.
    residuals : (2m,) array, rad
        Of the used turns, less the shifts of what was left out.
    """

    values: FloatArray
    information: FloatArray
    bias_gain: FloatArray
    direction_gain: FloatArray
    judgement: Judgement
    used: BoolArray
    residuals: FloatArray


def fit_closures(system: ClosureSystem, static: Information) -> ClosureFit:
    """Fit the twelve parameters; shifts for turns and poses that do not fit are found by test."""
    values, used = _start(system, static)
    system = system.select(used)
    judgement = Judgement(np.zeros(2))
    for _ in range(10):
        values, lin = _gauss_newton(system, static, values, judgement)
        previous, judgement = judgement, judge(system, lin, static)
        if judgement.agrees(previous, lin):
            break
    weight = np.linalg.inv(lin.total_covariance(judgement.scale))
    shifts = lin.shifts(judgement.left_out)
    fitted = np.linalg.solve(shifts.T @ weight @ shifts, shifts.T @ weight)
    weight = weight - weight @ shifts @ fitted
    return ClosureFit(
        values,
        lin.jacobian.T @ weight @ lin.jacobian + static.precision,
        lin.jacobian.T @ weight @ lin.bias_jacobian * ~system.estimated[:3],
        np.tensordot(lin.jacobian.T @ weight, lin.pose_shift, 1),
        judgement,
        used,
        lin.residual - shifts @ (fitted @ lin.residual),
    )


def _start(system: ClosureSystem, static: Information) -> tuple[FloatArray, BoolArray]:
    """Return values near enough to the solution for Gauss-Newton, and which turns to use.

    Turns of several revolutions say what they say modulo one revolution, so they wait until the
    others have made their prediction certain; a turn of which that never comes (a minute of
    shaking) cannot be used.
    """
    values = static.mean.copy()
    prior = np.diag(START_PRIOR**-2.0) + static.precision
    covariance = np.linalg.inv(prior)
    used = np.zeros(len(system.turns), bool)
    steps = system.steps
    bias = static.mean[:3] * steps.step[:, None]
    turned = np.abs(steps.total(np.abs(steps.angle - bias)))
    # Sensitivity to each parameter at most: angle about the axis it multiplies, or duration.
    reach = np.concatenate([np.tile(steps.duration[:, None], 3), turned[:, COLUMN]], axis=1)
    while not used.all():
        lin = system.linearise(values)
        spread = reach @ (system.estimated * np.sqrt(np.diag(covariance))) / np.sqrt(3)
        new = used | (spread < UNAMBIGUOUS)
        if (new == used).all():
            if used.any():
                break
            new[np.argmin(spread)] = True
        used = new
        rows = np.repeat(used, 2)
        for _ in range(3):
            # Only an approach: equal weights, of the size that a wrong model may leave.
            jacobian, residual = lin.jacobian[rows] / 0.01, lin.residual[rows] / 0.01
            information = prior + jacobian.T @ jacobian
            gradient = jacobian.T @ residual + prior @ (values - static.mean)
            step = -np.linalg.solve(information, gradient)
            values = values + step
            if np.abs(step / START_PRIOR).max() < 0.01:
                break
            lin = system.linearise(values)
        covariance = np.linalg.inv(information)
    return values, used


def _gauss_newton(
    system: ClosureSystem,
    static: Information,
    values: FloatArray,
    judgement: Judgement,
) -> tuple[FloatArray, Linearised]:
    lin = system.linearise(values)
    # The weights hardly change with the parameters: those of the start serve until it has settled.
    factor = np.asarray(np.linalg.cholesky(lin.total_covariance(judgement.scale)), float)
    free = np.ones(12, bool)
    for _ in range(30):
        residual, jacobian = _whiten(lin, factor, judgement.left_out)
        information = jacobian.T @ jacobian + static.precision
        # What was given up stays so, or two that cannot be told apart would take turns.
        free &= determined(information, TOLERANCE).free
        # What is not determined goes to its prior value, 0, with the others following.
        target = np.where(free, 0.0, -values)
        gradient = jacobian.T @ (residual + jacobian @ target)
        gradient += static.precision @ (values + target - static.mean)
        step = target
        step[free] = -np.linalg.solve(information[np.ix_(free, free)], gradient[free])
        values = values + step
        if np.max(step**2 * np.diag(information)) < 1e-6:
            return values, lin
        lin = system.linearise(values)
    raise NotConvergedError(
        "the gyroscope's equations did not settle in 30 steps; check that the gyroscope's axes and "
        "unit are those of the accelerometer, and that the turns lie between the poses"
    )


def _whiten(
    lin: Linearised, factor: FloatArray, left_out: LeftOut
) -> tuple[FloatArray, FloatArray]:
    """Whiten residual and Jacobian by a Cholesky factor, and project the shifts away."""
    stacked = np.column_stack([lin.residual, lin.jacobian, lin.shifts(left_out)])
    white = solve_triangular(factor, stacked, lower=True)
    kept, shifted = np.split(white, [1 + lin.jacobian.shape[1]], axis=1)
    if shifted.shape[1]:
        q = np.linalg.qr(shifted)[0]
        kept = kept - q @ (q.T @ kept)
    return kept[:, 0], kept[:, 1:]
