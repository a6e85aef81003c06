"""Static bias and closure equations of a gyroscope as one weighted, robust least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from calib.closure import (
    Directions,
    TurnSteps,
    closure_residual,
    horizontal_basis,
    propagate,
)
from calib.errors import NotConvergedError
from calib.model import Triad
from calib.rotation import skew
from calib.solvers._determined import TOLERANCE, determined
from calib.turns import Turns
from calib.types import FloatArray

SIGNIFICANCE = 0.01
"""Chance that anything at all is left out of a recording in which nothing is wrong."""

START_PRIOR = np.array([0.1] * 3 + [0.1] * 3 + [0.05] * 6)
"""How far from the start value a part may be: rad/s, 1, rad. Only the order in which turns are
taken in depends on it; the answer does not."""

UNAMBIGUOUS = 0.5
"""Turns whose predicted closure is less certain than this, rad, wait for the others."""


def unpack(values: FloatArray) -> Triad:
    """Return the triad of twelve values in the order of `Triad.parameters`."""
    matrix = np.diag(1.0 + values[3:6])
    matrix[_OFF] = values[6:]
    return Triad.from_matrix(matrix, values[:3])


_OFF = (np.array([0, 0, 1, 1, 2, 2]), np.array([1, 2, 0, 2, 0, 1]))
_ROW = np.concatenate([np.arange(3), _OFF[0]])
_COLUMN = np.concatenate([np.arange(3), _OFF[1]])


@dataclass(frozen=True, eq=False)
class Linearised:
    """Closure residuals of m turns at one set of parameters.

    Parameters
    ----------
    residual : (2m,) array, rad
        Two horizontal components a turn.
    jacobian : (2m, 12) array
    covariance : (2m, 2m) array, rad²
        From the directions at the poses and the integrated noise of the rate.
    pose_shift : (2m, k, 2) array
        Derivative to two rotations of the direction at each pose.
    """

    residual: FloatArray
    jacobian: FloatArray
    covariance: FloatArray
    pose_shift: FloatArray


@dataclass(frozen=True, eq=False)
class ClosureSystem:
    """The closure equations of a recording.

    Parameters
    ----------
    steps : TurnSteps
    turns : Turns
    directions : Directions
        At the poses.
    noise : (3, 3) array, rad²/s
        Growth of the integrated rate's covariance with time.
    """

    steps: TurnSteps
    turns: Turns
    directions: Directions
    noise: FloatArray

    def linearise(self, values: FloatArray) -> Linearised:
        """Propagate every turn with these parameters (12,) and differentiate."""
        triad, m, k = unpack(values), len(self.turns), len(self.directions.up)
        inverse = np.linalg.inv(triad.matrix)
        motion = propagate(self.steps, triad.matrix, triad.bias)
        up, cov = self.directions.up, self.directions.covariance
        before, after = self.turns.before, self.turns.after
        predicted = np.einsum("mij,mj->mi", motion.mat, up[after])
        basis = horizontal_basis(up[before])

        integrals = np.concatenate([motion.mat_integral[..., None], motion.rate_integrals], axis=-1)
        # d(phi)/d(parameter) = -integral(R w_j) inv(G)[:, i], and the same with 1 for the bias.
        source = np.concatenate([np.zeros(3, int), 1 + _COLUMN])
        row = np.concatenate([np.arange(3), _ROW])
        phi = -np.einsum("maip,ip->map", integrals[..., source], inverse[:, row])
        jacobian = -np.einsum("mea,map->mep", basis, phi)

        # A rotation of either direction about the basis vectors at its own pose.
        at_pose = horizontal_basis(up)
        own = basis @ at_pose[before].transpose(0, 2, 1)
        other = -basis @ motion.mat @ at_pose[after].transpose(0, 2, 1)
        shift = np.zeros((m, 2, k, 2))
        index = np.arange(m)
        shift[index, :, before], shift[index, :, after] = own, other
        pose_shift = shift.reshape(2 * m, k, 2)
        # Covariance of those rotations: a rotation r moves up by cross(r, up).
        turn = at_pose @ skew(up)
        rotation = turn @ cov @ turn.transpose(0, 2, 1)
        covariance = np.einsum("aki,kij,bkj->ab", pose_shift, rotation, pose_shift, optimize=True)
        angle = basis @ motion.noise(inverse @ self.noise @ inverse.T) @ basis.transpose(0, 2, 1)
        rows = 2 * index[:, None] + np.arange(2)
        covariance[rows[:, :, None], rows[:, None, :]] += angle
        residual = np.einsum("mea,ma->me", basis, closure_residual(up[before], predicted))
        return Linearised(residual.ravel(), jacobian.reshape(2 * m, -1), covariance, pose_shift)


@dataclass(frozen=True, eq=False)
class Information:
    """A Gaussian belief about the parameters: precision (12, 12) and mean (12,)."""

    precision: FloatArray
    mean: FloatArray


@dataclass(frozen=True, eq=False)
class ClosureFit:
    """Parameters from closures and a static bias, and how they came about.

    Parameters
    ----------
    values : (12,) array
    information : (12, 12) array
        Of the data; what was left out adds nothing to it.
    linearised : Linearised
        At the solution.
    inflation : float, rad
        Standard deviation ``tau`` added to each closure component.
    left_out : tuple of (kind, index)
        Each ``turn`` and ``pose`` that does not fit.
    """

    values: FloatArray
    information: FloatArray
    linearised: Linearised
    inflation: float
    left_out: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class _Judgement:
    """Inflation ``tau`` (rad), and the turns and poses that do not fit."""

    tau: float
    left_out: tuple[tuple[str, int], ...] = ()


def fit_closures(system: ClosureSystem, static: Information) -> ClosureFit:
    """Fit the twelve parameters; shifts for turns and poses that do not fit are found by test."""
    values = _start(system, static)
    judgement = _Judgement(0.0)
    for _ in range(10):
        values, lin = _gauss_newton(system, static, values, judgement)
        previous, judgement = judgement, _judge(system, lin, static)
        noise = np.median(np.diag(lin.covariance)) + judgement.tau**2
        settled = abs(judgement.tau**2 - previous.tau**2) < 0.01 * noise
        if settled and judgement.left_out == previous.left_out:
            break
    _, jacobian = _whiten(lin, judgement)
    information = jacobian.T @ jacobian + static.precision
    return ClosureFit(values, information, lin, judgement.tau, judgement.left_out)


def _start(system: ClosureSystem, static: Information) -> FloatArray:
    """Return values near enough to the solution for Gauss-Newton on every turn at once.

    Turns of several revolutions say what they say modulo one revolution, so they wait until the
    others have made their prediction certain.
    """
    values = static.mean.copy()
    prior = np.diag(START_PRIOR**-2.0) + static.precision
    covariance = np.linalg.inv(prior)
    used = np.zeros(len(system.turns), bool)
    while not used.all():
        lin = system.linearise(values)
        predicted = lin.jacobian @ covariance @ lin.jacobian.T
        spread = np.sqrt(np.diag(predicted).reshape(-1, 2).sum(axis=1))
        new = used | (spread < UNAMBIGUOUS)
        if (new == used).all():
            new[np.argmin(np.where(used, np.inf, spread))] = True
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
    return values


def _gauss_newton(
    system: ClosureSystem,
    static: Information,
    values: FloatArray,
    judgement: _Judgement,
) -> tuple[FloatArray, Linearised]:
    for _ in range(30):
        lin = system.linearise(values)
        residual, jacobian = _whiten(lin, judgement)
        information = jacobian.T @ jacobian + static.precision
        free = determined(information, TOLERANCE).free
        # What is not determined goes to its prior value, 0, with the others following.
        target = np.where(free, 0.0, -values)
        gradient = jacobian.T @ (residual + jacobian @ target)
        gradient += static.precision @ (values + target - static.mean)
        step = target
        step[free] = -np.linalg.solve(information[np.ix_(free, free)], gradient[free])
        values = values + step
        if np.max(step**2 * np.diag(information)) < 1e-6:
            return values, lin
    raise NotConvergedError(
        "the gyroscope's equations did not settle in 30 steps; check that the gyroscope's axes and "
        "unit are those of the accelerometer, and that the turns lie between the poses"
    )


def _shifts(lin: Linearised, left_out: Sequence[tuple[str, int]]) -> FloatArray:
    """Return a free shift of both components for each turn and pose that is left out."""
    size = len(lin.residual)
    columns = [np.zeros((size, 0))]
    for kind, i in left_out:
        turn = np.eye(size)[:, 2 * i : 2 * i + 2]
        columns.append(turn if kind == "turn" else lin.pose_shift[:, i])
    return np.concatenate(columns, axis=1)


def _whiten(lin: Linearised, judgement: _Judgement) -> tuple[FloatArray, FloatArray]:
    """Whiten residual and Jacobian, and project the shifts away."""
    size = len(lin.residual)
    factor = np.linalg.cholesky(lin.covariance + judgement.tau**2 * np.eye(size))
    shifts = _shifts(lin, judgement.left_out)
    stacked = np.column_stack([lin.residual, lin.jacobian, shifts])
    white = solve_triangular(factor, stacked, lower=True)
    kept, shifted = np.split(white, [1 + lin.jacobian.shape[1]], axis=1)
    if shifted.shape[1]:
        q = np.linalg.qr(shifted)[0]
        kept = kept - q @ (q.T @ kept)
    return kept[:, 0], kept[:, 1:]


def _judge(system: ClosureSystem, lin: Linearised, static: Information) -> _Judgement:
    """Estimate the inflation, and test every turn and pose at the family-wise `SIGNIFICANCE`.

    Forward with a scale that outliers do not move, then backward with the final scale. Each test
    asks how much a free shift of two components would lower the weighted sum of squares.
    """
    turns = len(system.turns)
    inner = np.intersect1d(system.turns.before, system.turns.after)
    candidates = [("turn", i) for i in range(turns)] + [("pose", int(k)) for k in inner]
    columns = np.stack([_shifts(lin, [c]) for c in candidates])
    threshold = chi2.isf(SIGNIFICANCE / len(candidates), 2)
    chosen: list[int] = []
    tau = _robust_inflation(lin, static)
    while len(chosen) < turns // 3:
        gains = _gains(lin, static, tau, columns[chosen], columns)
        best = int(np.argmax(gains))
        if gains[best] < threshold:
            break
        chosen.append(best)
    while True:
        tau = _inflation(lin, np.concatenate([*columns[chosen], np.zeros((2 * turns, 0))], axis=1))
        if not chosen:
            break
        gains = np.array(
            [
                _gains(lin, static, tau, columns[[c for c in chosen if c != k]], columns[[k]])[0]
                for k in chosen
            ]
        )
        if gains.min() >= threshold:
            break
        chosen.pop(int(np.argmin(gains)))
    return _Judgement(tau, tuple(sorted(candidates[c] for c in chosen)))


def _gains(
    lin: Linearised,
    static: Information,
    tau: float,
    shifts: FloatArray,
    columns: FloatArray,
) -> FloatArray:
    """Return how much each of (t, 2m, 2) columns lowers the sum of squares, (t,).

    The parameters and `shifts` (j, 2m, 2) are free in all of them.
    """
    size, p = lin.jacobian.shape
    design = np.concatenate([lin.jacobian, *shifts], axis=1)
    weight = np.linalg.inv(lin.covariance + tau**2 * np.eye(size))
    information = design.T @ weight @ design
    # A trace of the tolerance keeps what is not determined from being singular.
    information[:p, :p] += static.precision + 1e-6 * np.diag(TOLERANCE**-2.0)
    weighted = weight @ design
    projected = weight - weighted @ np.linalg.solve(information, weighted.T)
    score = columns.transpose(0, 2, 1) @ (projected @ lin.residual)
    inner = columns.transpose(0, 2, 1) @ projected @ columns
    # A column that the others already explain has nothing left to gain.
    alone = columns.transpose(0, 2, 1) @ weight @ columns
    able = np.linalg.eigvalsh(inner)[:, 0] > 1e-6 * np.linalg.eigvalsh(alone)[:, 1]
    inner[~able] = np.eye(2)
    gains: FloatArray = np.einsum(
        "ti,ti->t", score, np.linalg.solve(inner, score[..., None])[..., 0]
    )
    return np.where(able, gains, 0.0)


def _inflation(lin: Linearised, shifts: FloatArray) -> float:
    """Restricted maximum-likelihood estimate of ``tau``, rad.

    What the parameters and shifts can explain is projected away.
    """
    size = len(lin.residual)
    design = np.column_stack([lin.jacobian, shifts])
    u, singular, _ = np.linalg.svd(design, full_matrices=True)
    rank = int((singular > 1e-9 * max(singular.max(initial=0.0), 1e-300)).sum())
    null = u[:, rank:]
    if size - rank < 2:
        return 0.0
    values, vectors = np.linalg.eigh(null.T @ lin.covariance @ null)
    values = np.maximum(values, 1e-18)
    energy = (vectors.T @ (null.T @ lin.residual)) ** 2

    def cost(log_tau: float) -> float:
        total = values + np.exp(2 * log_tau)
        return float(np.sum(np.log(total) + energy / total))

    grid = np.linspace(np.log(1e-6), np.log(1.0), 60)
    costs = [cost(g) for g in grid]
    best = int(np.argmin(costs))
    if best == 0:
        return 0.0
    low, high = grid[best - 1], grid[min(best + 1, len(grid) - 1)]
    return float(np.exp(minimize_scalar(cost, bounds=(low, high), method="bounded").x))


def _robust_inflation(lin: Linearised, static: Information) -> float:
    """Estimate ``tau`` from the median turn of a robust fit, rad."""
    size = len(lin.residual)
    blocks = lin.covariance.reshape(size // 2, 2, size // 2, 2)
    index = np.arange(size // 2)
    noise = 0.5 * np.trace(blocks[index, :, index, :], axis1=1, axis2=2)
    weight = np.ones(size // 2)
    prior = static.precision + 1e-6 * np.diag(TOLERANCE**-2.0)
    tau2 = 0.0
    for _ in range(20):
        w = np.repeat(weight / (noise + tau2), 2)
        information = lin.jacobian.T @ (w[:, None] * lin.jacobian) + prior
        step = -np.linalg.solve(information, lin.jacobian.T @ (w * lin.residual))
        fitted = (lin.residual + lin.jacobian @ step).reshape(-1, 2)
        energy = (fitted**2).sum(axis=1)
        # The median of chi-square with two degrees of freedom is 1.386; a fit of p parameters to
        # n equations takes p / n of it away.
        taken = 1 - min(0.8, 9 / size)
        tau2 = max(0.0, float(np.median(energy / (1.386 * taken) - noise)))
        weight = 1 / (1 + energy / (4 * 2 * (noise + tau2)))
    return float(np.sqrt(tau2))
