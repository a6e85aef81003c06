"""What closures scatter beyond their known noise, and which of them do not belong.

The covariance of the closures is ``C + tau² I + kappa² V``: C from the noise at rest, V what the
trapezoid may miss between samples, ``tau²`` whatever else the model lacks. The two multiples are
estimated by restricted maximum likelihood [1]_, by Fisher scoring.

References
----------
.. [1] Patterson, Thompson, "Recovery of inter-block information when block sizes are unequal",
   Biometrika 58(3), 1971.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from calib.solvers._closure_system import ClosureSystem, LeftOut, Linearised
from calib.solvers._gyro_determined import TOLERANCE
from calib.types import FloatArray, IntArray

SIGNIFICANCE = 0.01
"""Chance that anything at all is left out of a recording in which nothing is wrong."""


@dataclass(frozen=True, eq=False)
class Information:
    """A Gaussian belief about the parameters: precision (12, 12) and mean (12,)."""

    precision: FloatArray
    mean: FloatArray


@dataclass(frozen=True, eq=False)
class Judgement:
    """Multiples of the inflation (2,), and the turns and poses that do not fit."""

    scale: FloatArray
    left_out: LeftOut = ()

    def agrees(self, other: Judgement, lin: Linearised) -> bool:
        """Whether another judgement would give the same weights to within a per cent."""
        mine, theirs = (np.diag(lin.total_covariance(j.scale)) for j in (self, other))
        return self.left_out == other.left_out and bool(np.abs(mine / theirs - 1).max() < 0.02)


def judge(system: ClosureSystem, lin: Linearised, static: Information) -> Judgement:
    """Estimate the inflation, and test every turn and pose at the family-wise `SIGNIFICANCE`.

    Forward with a scale that outliers do not move, then backward with the final scale. Each test
    asks how much a free shift of two components would lower the weighted sum of squares.
    """
    turns = len(system.turns)
    if not turns:
        return Judgement(np.zeros(2))
    inner = np.intersect1d(system.turns.before, system.turns.after)
    candidates = [("turn", i) for i in range(turns)] + [("pose", int(k)) for k in inner]
    columns = lin.shifts(candidates)
    threshold = chdtri(2, SIGNIFICANCE / len(candidates))
    scale = _robust_scale(lin, static)
    chosen = _forward(lin, static, scale, columns, threshold, turns // 3)
    while True:
        pairs = columns[:, _pairs(chosen)]
        scale = _restricted_scale(lin, pairs, scale)
        if not chosen:
            break
        # How much each shift lowers the sum of squares beside the others: its Wald statistic.
        projected = _projected_weight(lin, static, scale)
        covariance: FloatArray = np.asarray(np.linalg.pinv(pairs.T @ projected @ pairs), float)
        fitted = (covariance @ (pairs.T @ (projected @ lin.residual))).reshape(-1, 2)
        blocks = _diagonal_blocks(covariance)
        gains = np.einsum("ti,ti->t", fitted, np.linalg.solve(blocks, fitted[..., None])[..., 0])
        if gains.min() >= threshold:
            break
        chosen.pop(int(np.argmin(gains)))
    return Judgement(scale, tuple(sorted(candidates[c] for c in chosen)))


def _forward(
    lin: Linearised,
    static: Information,
    scale: FloatArray,
    columns: FloatArray,
    threshold: float,
    most: int,
) -> list[int]:
    """Choose shifts (pairs of columns) one by one, while the best is beyond the threshold."""
    projected = _projected_weight(lin, static, scale)
    product, residual = projected @ columns, projected @ lin.residual
    alone = _diagonal_blocks(columns.T @ product)
    chosen: list[int] = []
    while len(chosen) < most:
        inner = np.einsum(
            "ati,atj->tij",
            columns.reshape(len(columns), -1, 2),
            product.reshape(len(columns), -1, 2),
        )
        score = (columns.T @ residual).reshape(-1, 2)
        # A column that the others already explain has nothing left to gain.
        able = np.linalg.eigvalsh(inner)[:, 0] > 1e-6 * np.linalg.eigvalsh(alone)[:, 1]
        inner[~able] = np.eye(2)
        solved = np.linalg.solve(inner, score[..., None])[..., 0]
        gains = np.where(able, np.einsum("ti,ti->t", score, solved), 0.0)
        best = int(np.argmax(gains))
        if gains[best] < threshold:
            break
        chosen.append(best)
        # With the chosen shift free, P becomes P - P m (m' P m)^-1 m' P.
        pair = _pairs([best])
        moved = product[:, pair]
        back = np.linalg.solve(inner[best], moved.T)
        residual = residual - moved @ (back @ lin.residual)
        product = product - moved @ (back @ columns)
    return chosen


def _pairs(chosen: list[int]) -> IntArray:
    return (2 * np.array(chosen, np.int64)[:, None] + np.arange(2)).ravel()


def _diagonal_blocks(matrix: FloatArray) -> FloatArray:
    """Return the 2x2 blocks (t, 2, 2) on the diagonal of a (2t, 2t) matrix."""
    t = len(matrix) // 2
    index = np.arange(t)
    return matrix.reshape(t, 2, t, 2)[index, :, index, :]


def _projected_weight(lin: Linearised, static: Information, scale: FloatArray) -> FloatArray:
    """Return the inverse covariance from which the parameters are projected away."""
    weight: FloatArray = np.asarray(np.linalg.inv(lin.total_covariance(scale)), float)
    weighted = weight @ lin.jacobian
    # A trace of the tolerance keeps what is not determined from being singular.
    prior = static.precision + 1e-6 * np.diag(TOLERANCE**-2.0)
    return weight - weighted @ np.linalg.solve(lin.jacobian.T @ weighted + prior, weighted.T)


def _restricted_scale(lin: Linearised, shifts: FloatArray, start: FloatArray) -> FloatArray:
    """Return the restricted maximum-likelihood multiples (2,) of the inflation.

    Fisher scoring: gradient ``(r P V_i P r - tr(P V_i)) / 2``, information
    ``tr(P V_i P V_j) / 2``, with P the weight from which parameters and shifts are projected away.
    """
    size = len(lin.residual)
    design = np.column_stack([lin.jacobian, shifts])
    u, singular, _ = np.linalg.svd(design, full_matrices=False)
    design = u[:, singular > 1e-9 * max(singular.max(initial=0.0), 1e-300)]
    if size - design.shape[1] < 3:
        return start
    scale = np.maximum(start, 0.0)
    blocks = lin.inflation
    present = np.trace(blocks, axis1=2, axis2=3).sum(axis=1) > 1e-6 * np.trace(lin.covariance)
    scale[~present] = 0.0
    for _ in range(30):
        weight = np.linalg.inv(lin.total_covariance(scale))
        weighted = weight @ design
        projected = weight - weighted @ np.linalg.solve(design.T @ weighted, weighted.T)
        pulled = (projected @ lin.residual).reshape(-1, 2)
        # P V_i with V_i in blocks of two, as (2m, 2m).
        products = (projected.reshape(size, -1, 2).transpose(1, 0, 2) @ blocks).transpose(
            0, 2, 1, 3
        )
        products = products.reshape(2, size, size)
        gradient = np.einsum("mi,cmij,mj->c", pulled, blocks, pulled)
        gradient -= np.trace(products, axis1=1, axis2=2)
        information = np.einsum("cij,dji->cd", products, products)
        free = present & ((scale > 0) | (gradient > 0))
        if not free.any():
            return scale
        step = np.zeros(2)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], gradient[free])
        new = np.maximum(scale + step, 0.1 * scale)
        # A multiple too small to matter is none.
        new[new * np.einsum("cmii->c", blocks) < 1e-3 * np.trace(lin.covariance)] = 0.0
        if np.abs(new - scale).max() <= 1e-3 * max(new.max(), 1e-30):
            return new
        scale = new
    return scale


def _robust_scale(lin: Linearised, static: Information) -> FloatArray:
    """Return multiples of the inflation from the median turn of a robust fit.

    The second is set to 1/4, a bandwidth of about the rate; the first follows from the median.
    """
    m = len(lin.residual) // 2
    blocks = _diagonal_blocks(lin.covariance) + 0.25 * lin.inflation[1]
    noise = 0.5 * np.trace(blocks, axis1=1, axis2=2)
    weight = np.ones(m)
    prior = static.precision + 1e-6 * np.diag(TOLERANCE**-2.0)
    tau2 = 0.0
    for _ in range(20):
        w = np.repeat(weight / (noise + tau2), 2)
        information = lin.jacobian.T @ (w[:, None] * lin.jacobian) + prior
        step = -np.linalg.solve(information, lin.jacobian.T @ (w * lin.residual))
        energy = ((lin.residual + lin.jacobian @ step).reshape(-1, 2) ** 2).sum(axis=1)
        # The median of chi-square with two degrees of freedom is 1.386; a fit of nine parameters
        # to 2 m equations takes its share of it away.
        taken = 1 - min(0.8, 9 / (2 * m))
        tau2 = max(0.0, float(np.median(energy / (1.386 * taken) - noise)))
        weight = 1 / (1 + energy / (8 * (noise + tau2)))
    return np.array([tau2, 0.25])
