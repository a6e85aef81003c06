"""Gyroscope by rotation segments: the method that the paper proposes, axis by axis.

Each segment is a turn about one sensitive axis i between two poses. Gravity's direction, from the
calibrated accelerometer, turns about that axis by ``alpha``, and per segment::

    alpha = x1 * integral(w_m) - x2 * T,     x1 = 1 / s,  x2 = b / s

T is the true duration and the integral runs over the true sample times, so neither a constant speed
nor even sampling is assumed. (x1, x2) is a linear least-squares problem for each axis.

Conventions: here, as everywhere in `calib`, ``w_m = s w + b`` (the paper's equation 5). The paper's
equation 13, ``alpha = S (w_m - b) T``, uses the inverse of that S, and the second column of its
equation 14 must be ``-T`` for the unknowns ``(S, S b)`` that stand beside it. ``x1`` is the paper's
S of equations 13 and 14, and ``x2`` its ``S b``.

An axis that was vertical while it turned moves nothing that gravity shows: such segments are not
used, and the axis is named if no others are left. Turns about no single axis are not used either.
A turn by hand is never about one axis alone, and the equation holds for that only. What the whole
measured rotation would have turned gravity by, less its integral about the axis, is what the
equation leaves out; its square counts as variance of that segment, and so does what the scale
factors of the other axes may change about it.
Where the segments about an axis are too few or too alike to give both unknowns, the bias at rest
joins them as a segment without a rotation.
The angle of gravity is known modulo one turn; the gyroscope's own integral chooses the turn.

References
----------
.. [1] Ranjbaran, Roudbari, Ebadollahi, JECEI 6(1), 2018, eqs. (12) to (14).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.closure import TurnSteps, propagate
from calib.directions import Directions, pose_directions
from calib.fit import Exclusion, Fit
from calib.model import Triad
from calib.poses import Poses
from calib.recording import AXES, Recording
from calib.solvers._gyro_determined import GYRO_NAMES, GYRO_UNITS, TOLERANCE, condition_number
from calib.solvers._static_bias import noise_growth, static_bias
from calib.solvers.base import GyroSolver
from calib.solvers.outliers import between_variance, find_outliers
from calib.turns import Turns
from calib.types import BoolArray, FloatArray, IntArray

ALONE = np.cos(np.radians(20.0))
"""A segment is about one axis if that axis's share of the angle's length is at least this."""
OTHERS = 0.03
"""Scale factor error of the other axes, that nobody knows yet: what consumer parts promise."""
SINGULAR = 1e7
"""Condition number from which on a scale and a bias cannot be told apart."""
LEAST = 1e-3
"""Turn that gravity saw, as part of the gyroscope's own, below which it saw none: no factor."""
LEVEL = 0.5
"""Gravity must lean at least this much (sine) away from the axis for its angle to be read."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Turns about one axis.

    Parameters
    ----------
    axis : (m,) array of int
        The axis that each turn is about, -1 for none.
    level : (m,) array of bool
        Whether the axis was level enough for gravity to show the angle.
    alpha : (m,) array, rad
        The angle that the accelerometer saw about that axis, unwrapped.
    variance : (m,) array, rad²
        Of ``alpha``, and of what a turn that is not about one axis alone adds to it.
    integral_variance : (m,) array, rad²
        Of the integral about that axis.
    integral : (m, 3) array, rad
        Of the measured rate.
    duration : (m,) array, s
    """

    axis: IntArray
    level: BoolArray
    alpha: FloatArray
    variance: FloatArray
    integral_variance: FloatArray
    integral: FloatArray
    duration: FloatArray


def find_segments(
    steps: TurnSteps, turns: Turns, directions: Directions, bias: FloatArray, noise: FloatArray
) -> Segments:
    """Read each turn as a rotation about one axis, if it is one.

    Parameters
    ----------
    steps, turns, directions
        Of the recording.
    bias : (3,) array, rad/s
        At rest; only to tell the axis, to count revolutions, and for what other axes add.
    noise : (3,) array, rad²/s
        Growth of the variance of each integral.
    """
    integral, duration = steps.total(steps.angle), steps.duration
    angle = integral - bias * duration[:, None]
    size = np.abs(angle)
    axis = np.argmax(size, axis=1)
    index = np.arange(len(axis))
    alone = size[index, axis] >= ALONE * np.linalg.norm(angle, axis=1)
    before = _across(directions.up[turns.before], axis)
    after = _across(directions.up[turns.after], axis)
    variance = sum(
        np.einsum("mi,mij,mj->m", seen.gradient, directions.covariance[pose], seen.gradient)
        for seen, pose in ((before, turns.before), (after, turns.after))
    )
    # u_before = R(axis, alpha) u_after, so the azimuth grows backwards in time.
    turned = angle[index, axis]
    alpha = _nearest(before.azimuth - after.azimuth, turned)
    mat = propagate(steps, np.eye(3), np.broadcast_to(bias, (len(axis), 3))).mat
    whole = _across(np.einsum("mij,mj->mi", mat, directions.up[turns.after]), axis)
    added = _nearest(whole.azimuth - after.azimuth, turned) - turned
    variance += added**2 + OTHERS**2 * np.maximum((angle**2).sum(axis=1) - turned**2, 0.0)
    level = np.minimum(before.lean, after.lean) >= LEVEL
    return Segments(
        np.where(alone, axis, -1),
        level,
        alpha,
        variance,
        noise[axis] * duration,
        integral,
        duration,
    )


class _Across(NamedTuple):
    """A direction seen along the axis of each turn.

    Azimuth (m,), rad, its derivative (m, 3) by the direction, and how far from the axis it leans
    (m,), a sine.
    """

    azimuth: FloatArray
    gradient: FloatArray
    lean: FloatArray


def _across(up: FloatArray, axis: IntArray) -> _Across:
    # Components across the axis, in right-handed order.
    index, j, k = np.arange(len(axis)), (axis + 1) % 3, (axis + 2) % 3
    first, second = up[index, j], up[index, k]
    length2 = first**2 + second**2
    # d(azimuth) = (u_j du_k - u_k du_j) / length²
    gradient = np.zeros_like(up)
    gradient[index, j], gradient[index, k] = -second, first
    gradient /= np.maximum(length2, 1e-12)[:, None]
    return _Across(np.arctan2(second, first), gradient, np.sqrt(length2))


def _nearest(angle: FloatArray, turned: FloatArray) -> FloatArray:
    """Return an angle in the revolution in which it is nearest to another one."""
    return np.asarray(angle + 2 * np.pi * np.round((turned - angle) / (2 * np.pi)))


def solve(
    recording: Recording,
    poses: Poses,
    turns: Turns,
    accel: Triad,
    *,
    gravity: float,
    options: Mapping[str, object],
) -> Fit:
    """Solve bias and scale factor error of each axis; see the module for the equations.

    Parameters
    ----------
    recording : Recording
    poses, turns : Poses, Turns
    accel : Triad
        The accelerometer's calibration.
    gravity : float, m/s²
        Not needed: only its direction is used.
    options : mapping
        None are known.

    Returns
    -------
    Fit
        Residuals (m, 1) in rad: ``alpha - (x1 integral - x2 T)`` of each segment that was used.

    Raises
    ------
    InsufficientMotionError
        If there is no pose.
    """
    steps = TurnSteps.of(recording, turns)
    rest = static_bias(recording, poses)
    noise = np.diag(noise_growth(recording, poses))
    segments = find_segments(steps, turns, pose_directions(poses, accel), rest.bias, noise)
    values, covariance = np.zeros(6), np.full((6, 6), np.nan)
    residual = np.full(len(turns), np.nan)
    excluded: list[Exclusion] = []
    advice: list[str] = []
    conditions = [1.0]
    freedom = 0
    for i, axis in enumerate(AXES):
        rows = np.flatnonzero((segments.axis == i) & segments.level)
        design = np.stack([segments.integral[rows, i], -segments.duration[rows]], axis=1)
        alpha = segments.alpha[rows]
        wander = (rest.wander[i] * segments.duration[rows]) ** 2
        variance = np.stack([segments.variance[rows], segments.integral_variance[rows] + wander])
        answer = _line(design, alpha, variance)
        mine = np.array([i, 3 + i])
        if answer is None or (answer.errors > TOLERANCE[mine]).any():
            # A second of rest is a segment without a rotation.
            answer = _line(
                np.append(design, [[rest.bias[i], -1.0]], axis=0),
                np.append(alpha, 0.0),
                np.append(variance, [[0.0], [rest.covariance[i, i]]], axis=1),
            )
        if answer is None or (answer.errors > TOLERANCE[mine]).any():
            values[i], covariance[i, i] = rest.bias[i], rest.covariance[i, i]
            advice.append(_advice(axis, segments, i))
            continue
        values[mine] = answer.bias, answer.scale - 1
        covariance[np.ix_(mine, mine)] = answer.covariance
        kept = answer.kept[: len(rows)]
        residual[rows[kept]] = answer.residual[: kept.sum()]
        conditions.append(answer.condition_number)
        freedom += int(answer.kept.sum()) - 2
        excluded += [
            Exclusion(
                (float(turns.interval[k, 0]), float(turns.interval[k, 1])),
                0.0,
                f"the segment disagrees with the others about axis {axis}",
            )
            for k in rows[~kept]
        ]
    covariance[:3, :3] += np.diag(rest.wander**2)
    undetermined = tuple(
        name for name, v in zip(GYRO_NAMES[:6], np.diag(covariance), strict=True) if np.isnan(v)
    )
    # Axes share no equation.
    known = np.isfinite(np.diag(covariance))
    covariance[np.isnan(covariance) & np.outer(known, known)] = 0.0
    used = np.isfinite(residual)
    return Fit(
        method=GYRO_SOLVER.name,
        triad=Triad(values[:3], values[3:]),
        names=GYRO_NAMES[:6],
        values=values,
        units=GYRO_UNITS[:6],
        covariance=covariance,
        residuals=residual[used, None],
        residual_unit="rad",
        intervals=turns.interval[used],
        degrees_of_freedom=freedom,
        condition_number=max(conditions),
        undetermined=undetermined,
        advice=tuple(advice),
        excluded=tuple(excluded),
    )


@dataclass(frozen=True, eq=False)
class _Line:
    """One axis: bias and scale with covariance (2, 2), and how the segments fit."""

    bias: float
    scale: float
    covariance: FloatArray
    residual: FloatArray
    kept: BoolArray
    condition_number: float

    @property
    def errors(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance))


def _line(design: FloatArray, alpha: FloatArray, variance: FloatArray) -> _Line | None:
    """Solve ``alpha = x1 integral - x2 T`` for one axis; None if it is not determined.

    `variance` (2, m) is that of alpha and that of the integral, which counts by ``x1²``.
    """
    if len(alpha) < 2 or np.linalg.cond(design) > SINGULAR:
        return None
    ordinary, *_ = np.linalg.lstsq(design, alpha, rcond=None)
    total = variance[0] + ordinary[0] ** 2 * variance[1]
    total = np.maximum(total, SINGULAR**-2 * total.max())
    kept = ~find_outliers(alpha - design @ ordinary, design, total)
    freedom = int(kept.sum()) - 2
    if freedom < 0:
        return None
    a, y, known = design[kept], alpha[kept], total[kept]
    extra = 0.0
    for _ in range(10):
        weight = 1 / (known + extra)
        information = a.T @ (weight[:, None] * a)
        if not np.linalg.cond(information) < SINGULAR**2:
            return None
        x1, x2 = np.linalg.solve(information, a.T @ (weight * y))
        residual = y - a @ [x1, x2]
        new = between_variance(residual, known, freedom)
        if abs(new - extra) <= 1e-3 * (known.mean() + extra):
            break
        extra = new
    if abs(x1) < LEAST:
        return None
    # s = 1 / x1, b = x2 / x1.
    jacobian = np.array([[-x2 / x1**2, 1 / x1], [-1 / x1**2, 0.0]])
    covariance = jacobian @ np.linalg.inv(information) @ jacobian.T
    return _Line(x2 / x1, 1 / x1, covariance, residual, kept, condition_number(information))


def _advice(axis: str, segments: Segments, i: int) -> str:
    mine = segments.axis == i
    if mine.any() and not segments.level[mine].any():
        why = (
            f"axis {axis} was vertical while it turned, and gravity does not see that; remount the "
            f"sensor with {axis} horizontal"
        )
    elif mine.any():
        why = f"the {int(mine.sum())} turns about axis {axis} alone are too few or too alike"
    else:
        why = f"no turn was about axis {axis} alone"
    return (
        f"{why}; turn the sensor about {axis} while it is horizontal, by 90 degrees or more, both "
        "ways, at rest before and after, or use rotation_segment_3x3, which takes turns about any "
        "axes"
    )


GYRO_SOLVER = GyroSolver(
    "rotation_segment",
    "bias and scale, axis by axis, from the angle that the accelerometer sees (the paper's)",
    solve,
)
