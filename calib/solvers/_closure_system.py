"""The closure equations of a recording's turns, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.closure import (
    Kinematics,
    Propagation,
    TurnSteps,
    by_quaternions,
    closure_residual,
    horizontal_basis,
    propagate,
)
from calib.directions import Directions
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


def direction_sensitivity(directions: Directions, accel: Triad, gravity: float) -> FloatArray:
    """Return how errors of the accelerometer's twelve parameters turn each direction, (k, 2, 12).

    With ``G = I + S + M``, ``f = inv(G) (a_m - b)`` changes by ``-inv(G) (dG f + db)``; the two
    components are rotations about the horizontal basis at the pose.
    """
    up, inverse = directions.up, np.asarray(np.linalg.inv(accel.matrix), np.float64)
    size = np.concatenate([np.full((len(up), 3), 1 / gravity), up[:, COLUMN]], axis=1)
    change = -inverse[:, np.concatenate([np.arange(3), _ROW])] * size[:, None, :]
    turned: FloatArray = horizontal_basis(up) @ skew(up) @ change
    return turned


_OFF = (np.array([0, 0, 1, 1, 2, 2]), np.array([1, 2, 0, 2, 0, 1]))
_ROW = np.concatenate([np.arange(3), _OFF[0]])
COLUMN = np.concatenate([np.arange(3), _OFF[1]])
"""Which component of the true rate each of the nine matrix parameters multiplies."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Closure residuals of m turns at one set of parameters.

    Parameters
    ----------
    system : ClosureSystem
    residual : (2m,) array, rad
        Two horizontal components a turn.
    jacobian : (2m, 12) array
        Zero for parameters that the closures do not estimate.
    bias_jacobian : (2m, 3) array
    pose_shift : (2m, k, 2) array
        Derivative to two rotations of the direction at each pose.
    motion : Propagation
    basis : (m, 2, 3) array
    inverse : (3, 3) array
        Takes the measured rate to the true one.
    """

    system: ClosureSystem
    residual: FloatArray
    jacobian: FloatArray
    bias_jacobian: FloatArray
    pose_shift: FloatArray
    motion: Propagation
    basis: FloatArray
    inverse: FloatArray

    @cached_property
    def rate_noise(self) -> FloatArray:
        """Covariance (m, 2, 2) of the white noise of the rate, integrated, rad²."""
        noise = self.motion.noise(self.inverse @ self.system.noise @ self.inverse.T)
        return self.basis @ noise @ self.basis.transpose(0, 2, 1)

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance (2m, 2m) of the known noise: of the directions, the rate, and the bias."""
        directions = self.system.directions
        size, k = len(self.residual), len(directions.up)
        # A rotation r moves up by cross(r, up).
        turn = horizontal_basis(directions.up) @ skew(directions.up)
        rotation = turn @ directions.covariance @ turn.transpose(0, 2, 1)
        moved = (self.pose_shift[:, :, None, :] @ rotation).reshape(size, 2 * k)
        covariance = moved @ self.pose_shift.reshape(size, 2 * k).T
        covariance += self.bias_jacobian @ self.system.bias_covariance @ self.bias_jacobian.T
        return _add_blocks(covariance, self.rate_noise)

    @cached_property
    def inflation(self) -> FloatArray:
        """Shapes (2, m, 2, 2) of the excess: 1 rad² each, and what the trapezoid may miss, rad²."""
        missed = self.basis @ self.motion.missed(self.inverse) @ self.basis.transpose(0, 2, 1)
        # White noise alone makes a quarter of its own size look like roughness.
        level = np.trace(missed, axis1=1, axis2=2)
        floor = 0.25 * np.trace(self.rate_noise, axis1=1, axis2=2)
        missed *= np.clip(1 - floor / np.maximum(level, 1e-30), 0, 1)[:, None, None]
        return np.stack([np.broadcast_to(np.eye(2), missed.shape), missed])

    def total_covariance(self, scale: FloatArray) -> FloatArray:
        """Return the covariance with (2,) multiples of the inflation added."""
        return _add_blocks(self.covariance.copy(), np.tensordot(scale, self.inflation, 1))

    def shifts(self, left_out: Sequence[tuple[str, int]]) -> FloatArray:
        """Return a free shift of two components for each turn or pose that is left out."""
        size = len(self.residual)
        columns = np.zeros((size, len(left_out), 2))
        for k, (kind, i) in enumerate(left_out):
            if kind == "turn":
                columns[2 * i : 2 * i + 2, k] = np.eye(2)
            else:
                columns[:, k] = self.pose_shift[:, i]
        return columns.reshape(size, -1)


def _add_blocks(matrix: FloatArray, blocks: FloatArray) -> FloatArray:
    """Add (m, 2, 2) blocks on the diagonal of a (2m, 2m) matrix, in place."""
    rows = np.arange(len(matrix)).reshape(-1, 2)
    matrix[rows[:, :, None], rows[:, None, :]] += blocks
    return matrix


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
        up = self.directions.up
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
        residual = np.einsum("mea,ma->me", basis, closure_residual(up[before], predicted))
        return Linearised(
            self,
            residual.ravel(),
            jacobian * self.estimated,
            jacobian[:, :3],
            blocks.reshape(2 * m, k, 2),
            motion,
            basis,
            inverse,
        )
