"""Attitude closure of turns: what the gyroscope says that gravity did, and what it really did.

With the true rate ``w = inv(G) (w_m - b)``, ``G = I + S + M``, the rotation of a turn is the
solution ``R`` of ``dR/dt = R skew(w)`` from identity at its start, and gravity's direction obeys
``u_before = R u_after``. A change of the rate by ``dw(t)`` turns the prediction by the small
rotation ``phi = integral of R(t) dw(t) dt``, resolved in the frame at the start. Since
``dw = -inv(G) (dG w + db)``, the sensitivity to every parameter follows from four integrals a
turn, ``integral of R w_j dt`` (j = x, y, z) and ``integral of R dt``: no finite differences, and no
loop over samples.

References
----------
.. [1] Titterton, Weston, "Strapdown Inertial Navigation Technology", 2nd ed., section 11.3
   (attitude error propagation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.recording import Recording
from calib.rotation import (
    cumulative_quat_segments,
    mat_from_quat,
    quat_from_rotvec,
    quat_multiply,
)
from calib.turns import Turns
from calib.types import BoolArray, FloatArray, IntArray

FINEST_STEP = 1 / 500
"""Steps shorter than this, s, are summed: no hand turns a sensor measurably within one."""


@dataclass(frozen=True, eq=False)
class TurnSteps:
    """The steps between samples of m turns; ``[first[i], first[i + 1])`` are turn i's.

    Parameters
    ----------
    angle : (n, 3) array, rad
        Trapezoidal integral of the measured rate over each step.
    step : (n,) array, s
        Its true duration.
    roughness : (n, 3) array, rad²
        What the trapezoid may miss between samples, see `roughness`.
    first : (m + 1,) array of int
    """

    angle: FloatArray
    step: FloatArray
    roughness: FloatArray
    first: IntArray

    @classmethod
    def of(cls, recording: Recording, turns: Turns, *, gain: FloatArray | None = None) -> TurnSteps:
        """Integrate the steps of some turns; very fine ones are summed (`FINEST_STEP`).

        `gain` (n - 1,) multiplies the steps between the recording's n samples, 1 if None: the share
        of the rate, and of its bias and noise, that is taken for motion.
        """
        length = turns.stop - turns.start - 1
        first = np.concatenate([[0], np.cumsum(length)])
        begin = np.arange(first[-1]) + np.repeat(turns.start - first[:-1], length)
        step = recording.time[begin + 1] - recording.time[begin]
        angle = 0.5 * step[:, None] * (recording.gyro[begin] + recording.gyro[begin + 1])
        missed = roughness(recording.gyro[begin + 1] - recording.gyro[begin], step, first)
        if gain is not None:
            share = gain[begin]
            angle, step = share[:, None] * angle, share * step
            missed = share[:, None] ** 2 * missed
        width = int(FINEST_STEP / recording.interval) if recording.interval else 1
        if width > 1:
            # Groups of `width` steps, each turn's last one shorter.
            groups = -(-length // width)
            edges = np.concatenate([[0], np.cumsum(groups)])
            within = np.arange(edges[-1]) - np.repeat(edges[:-1], groups)
            starts = np.repeat(first[:-1], groups) + width * within
            angle, step = np.add.reduceat(angle, starts), np.add.reduceat(step, starts)
            missed = np.add.reduceat(missed, starts)
            first = edges
        return cls(angle, step, missed, first)

    def __len__(self) -> int:
        return len(self.first) - 1

    def select(self, which: BoolArray) -> TurnSteps:
        """Return the steps of some of the turns, a mask (m,)."""
        count = np.diff(self.first)
        keep = np.repeat(which, count)
        first = np.concatenate([[0], np.cumsum(count[which])])
        return TurnSteps(self.angle[keep], self.step[keep], self.roughness[keep], first)

    def total(self, values: FloatArray) -> FloatArray:
        """Return the sum of (n, ...) values over each turn, (m, ...)."""
        total: FloatArray = np.add.reduceat(values, self.first[:-1], axis=0)
        return total

    @property
    def duration(self) -> FloatArray:
        """Duration of each turn, (m,) s."""
        return self.total(self.step)


def roughness(change: FloatArray, step: FloatArray, first: IntArray) -> FloatArray:
    """Return the variance (n, 3) of what the trapezoid misses in each step, rad².

    A rate that jumps by D at an unknown moment of a step of h seconds makes an error of variance
    ``(D h)² / 12``. D² is judged from the change of slope at both ends of the step, half each; as a
    jump shows in three steps that way, half of the sum is taken. A knock that the sensor
    samples too slowly, and a gap, weigh by this; a smooth turn has next to none. White noise makes
    a level of its own, ``(h sigma)² / 4``, which is of the order of the noise of the integral.
    """
    slope = change / step[:, None]
    bend = np.zeros_like(slope)
    bend[1:] = np.diff(slope, axis=0) ** 2
    bend[first[:-1]] = 0.0
    after = np.append(bend[1:], np.zeros((1, 3)), axis=0)
    # Half (both ends) times half (three steps) of D² h² / 12, with D = bend h.
    return (bend + after) * step[:, None] ** 4 / 48


@dataclass(frozen=True, eq=False)
class Propagation:
    """Rotation of m turns and its sensitivities.

    Parameters
    ----------
    mat : (m, 3, 3) array
        ``R``: the frame at the end of each turn, seen from that at its start.
    rate_integrals : (m, 3, 3, 3) array
        ``[i, :, :, j]`` is the integral of ``R(t) w_j(t)`` over turn i, rad.
    mat_integral : (m, 3, 3) array
        The integral of ``R(t)``, s.
    middle : (n, 3, 3) array
        ``R`` in the middle of each step.
    """

    steps: TurnSteps
    mat: FloatArray
    rate_integrals: FloatArray
    mat_integral: FloatArray
    middle: FloatArray

    def missed(self, inverse: FloatArray) -> FloatArray:
        """Return the covariance (m, 3, 3), rad², of ``phi`` for what the trapezoid may miss.

        `inverse` (3, 3) takes the measured rate to the true one.
        """
        rotated = self.middle @ inverse
        weighted = rotated * self.steps.roughness[:, None, :]
        return self.steps.total(weighted @ rotated.transpose(0, 2, 1))

    def noise(self, density: FloatArray) -> FloatArray:
        """Return the covariance (m, 3, 3), rad², of ``phi`` for white noise in the true rate.

        `density` (3, 3), rad²/s, is how fast the covariance of its integral grows.
        """
        rotated = self.middle @ density @ self.middle.transpose(0, 2, 1)
        return self.steps.total(rotated * self.steps.step[:, None, None])


Kinematics = Callable[[FloatArray, IntArray], FloatArray]
"""From the rotation vectors of steps (n, 3) and where turns begin to the quaternions (n, 4) at the
end of each step, from identity at the beginning of its turn."""


def by_quaternions(rotvec: FloatArray, first: IntArray) -> FloatArray:
    """Chain the exact quaternion of each step."""
    return cumulative_quat_segments(quat_from_rotvec(rotvec), first)


def propagate(
    steps: TurnSteps,
    matrix: FloatArray,
    bias: FloatArray,
    *,
    kinematics: Kinematics = by_quaternions,
) -> Propagation:
    """Integrate the turns with the gyroscope's ``I + S + M`` and bias ((3,), or one per turn).

    Each step's rotation vector is its angle plus the coning term ``a_before x a / 12``.

    References
    ----------
    .. [1] Savage, "Strapdown Inertial Navigation Integration Algorithm Design Part 1", J. Guidance
       21(1), 1998, the coning integral from this and the previous increment.
    """
    count = np.diff(steps.first)
    bias = np.repeat(np.broadcast_to(bias, (len(steps), 3)), count, axis=0)
    angle = (steps.angle - bias * steps.step[:, None]) @ np.linalg.inv(matrix).T
    rotvec = angle.copy()
    rotvec[1:] += np.cross(angle[:-1], angle[1:]) / 12
    rotvec[steps.first[:-1]] = angle[steps.first[:-1]]
    half = kinematics(rotvec, steps.first)
    last = half[steps.first[1:] - 1]
    half = quat_multiply(half, quat_from_rotvec(-0.5 * rotvec))
    middle = mat_from_quat(half)
    return Propagation(
        steps,
        mat_from_quat(last),
        np.stack([steps.total(middle * angle[:, None, None, j]) for j in range(3)], axis=-1),
        steps.total(middle * steps.step[:, None, None]),
        middle,
    )


def closure_residual(before: FloatArray, predicted: FloatArray) -> FloatArray:
    """Return the rotation vectors (m, 3), rad, that take `predicted` to `before`, unit vectors."""
    axis = np.cross(predicted, before)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, np.sum(before * predicted, axis=-1))
    return axis * np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 1.0)[:, None]


def horizontal_basis(up: FloatArray) -> FloatArray:
    """Return two orthonormal vectors (m, 2, 3) perpendicular to unit vectors (m, 3)."""
    helper = np.eye(3)[np.argmin(np.abs(up), axis=-1)]
    first = np.cross(up, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(up, first)], axis=1)
