"""The closure equations of a recording's turns, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.closure import (
    Directions,
    Kinematics,
    Propagation,
    TurnSteps,
    by_quaternions,
    closure_residual,
    horizontal_basis,
    propagate,
)
from calib.model import Triad
from calib.rotation import skew
from calib.turns import Turns
from calib.types import BoolArray, FloatArray

LeftOut = tuple[tuple[str, int], ...]
"""Each ``turn`` and ``pose`` that does not fit, by index."""


def unpack(values: FloatArray) -> Triad:
    """Return the triad of twelve values in the order of `Triad.parameters`."""
    matrix = np.diag(1.0 + values[3:6])
    matrix[_OFF] = values[6:]
    return Triad.from_matrix(matrix, values[:3])


_OFF = (np.array([0, 0, 1, 1, 2, 2]), np.array([1, 2, 0, 2, 0, 1]))
_ROW = np.concatenate([np.arange(3), _OFF[0]])
COLUMN = np.concatenate([np.arange(3), _OFF[1]])
"""Which component of the true rate each of the nine matrix parameters multiplies."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Closure residuals of m turns at one set of parameters.

    Parameters
    ----------
    residual : (2m,) array, rad
        Two horizontal components a turn.
    jacobian : (2m, 12) array
        Zero for parameters that the closures do not estimate.
    bias_jacobian : (2m, 3) array
    covariance : (2m, 2m) array, rad²
        From the directions at the poses and the integrated noise of the rate.
    inflation : (2, m, 2, 2) array
        Shapes of the excess: 1 rad² for every component, and what the trapezoid may miss (rad²).
    pose_shift : (2m, k, 2) array
        Derivative to two rotations of the direction at each pose.
    """

    residual: FloatArray
    jacobian: FloatArray
    bias_jacobian: FloatArray
    covariance: FloatArray
    inflation: FloatArray
    pose_shift: FloatArray

    def total_covariance(self, scale: FloatArray) -> FloatArray:
        """Return the covariance with (2,) multiples of the inflation added."""
        total = self.covariance.copy()
        rows = np.arange(len(total)).reshape(-1, 2)
        total[rows[:, :, None], rows[:, None, :]] += np.tensordot(scale, self.inflation, 1)
        return total

    def shifts(self, left_out: Sequence[tuple[str, int]]) -> FloatArray:
        """Return a free shift of two components for each turn or pose that is left out."""
        size = len(self.residual)
        columns = [np.zeros((size, 0))]
        for kind, i in left_out:
            turn = np.eye(size)[:, 2 * i : 2 * i + 2]
            columns.append(turn if kind == "turn" else self.pose_shift[:, i])
        return np.concatenate(columns, axis=1)


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
    deviation : (m, 3) array, rad/s
        Of the bias during each turn from the mean bias.
    estimated : (12,) array of bool
        Parameters that the closures estimate; the others stay as they are.
    bias_covariance : (3, 3) array
        Of the bias, where the closures do not estimate it.
    kinematics : function
        How steps are chained to an attitude.
    """

    steps: TurnSteps
    turns: Turns
    directions: Directions
    noise: FloatArray
    deviation: FloatArray
    estimated: BoolArray
    bias_covariance: FloatArray
    kinematics: Kinematics = by_quaternions

    def select(self, which: BoolArray) -> ClosureSystem:
        """Return the system of some of the turns."""
        return replace(
            self,
            steps=self.steps.select(which),
            turns=self.turns.select(which),
            deviation=self.deviation[which],
        )

    def linearise(self, values: FloatArray) -> Linearised:
        """Propagate every turn with these parameters (12,) and differentiate."""
        triad, m, k = unpack(values), len(self.turns), len(self.directions.up)
        inverse = np.asarray(np.linalg.inv(triad.matrix), np.float64)
        motion = propagate(
            self.steps,
            triad.matrix,
            triad.bias + self.deviation,
            kinematics=self.kinematics,
        )
        up, cov = self.directions.up, self.directions.covariance
        before, after = self.turns.before, self.turns.after
        predicted = np.einsum("mij,mj->mi", motion.mat, up[after])
        basis = horizontal_basis(up[before])

        integrals = np.concatenate([motion.mat_integral[..., None], motion.rate_integrals], axis=-1)
        # d(phi)/d(parameter) = -integral(R w_j) inv(G)[:, i], and the same with 1 for the bias.
        source = np.concatenate([np.zeros(3, int), 1 + COLUMN])
        row = np.concatenate([np.arange(3), _ROW])
        phi = -np.einsum("maip,ip->map", integrals[..., source], inverse[:, row])
        jacobian = -np.einsum("mea,map->mep", basis, phi).reshape(2 * m, -1)

        # A rotation of either direction about the basis vectors at its own pose.
        at_pose = horizontal_basis(up)
        blocks = np.zeros((m, 2, k, 2))
        index = np.arange(m)
        blocks[index, :, before] = basis @ at_pose[before].transpose(0, 2, 1)
        blocks[index, :, after] = -basis @ motion.mat @ at_pose[after].transpose(0, 2, 1)
        shift = blocks.reshape(2 * m, 2 * k)
        # Covariance of those rotations: a rotation r moves up by cross(r, up).
        turn = at_pose @ skew(up)
        rotation = turn @ cov @ turn.transpose(0, 2, 1)
        moved = (shift.reshape(2 * m, k, 1, 2) @ rotation).reshape(2 * m, 2 * k)
        covariance = moved @ shift.T
        covariance += jacobian[:, :3] @ self.bias_covariance @ jacobian[:, :3].T

        noise, missed = self._rate_noise(motion, inverse)
        across = basis.transpose(0, 2, 1)
        rows = 2 * index[:, None] + np.arange(2)
        covariance[rows[:, :, None], rows[:, None, :]] += basis @ noise @ across
        residual = np.einsum("mea,ma->me", basis, closure_residual(up[before], predicted))
        return Linearised(
            residual.ravel(),
            jacobian * self.estimated,
            jacobian[:, :3],
            covariance,
            np.stack([np.broadcast_to(np.eye(2), (m, 2, 2)), basis @ missed @ across]),
            shift.reshape(2 * m, k, 2),
        )

    def _rate_noise(
        self, motion: Propagation, inverse: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the covariances (m, 3, 3) of white noise and of what the trapezoid may miss."""
        noise = motion.noise(inverse @ self.noise @ inverse.T)
        missed = motion.missed(inverse)
        # White noise alone makes a quarter of its own size look like roughness.
        level, floor = np.trace(missed, axis1=1, axis2=2), 0.25 * np.trace(noise, axis1=1, axis2=2)
        missed *= np.clip(1 - floor / np.maximum(level, 1e-30), 0, 1)[:, None, None]
        return noise, missed
