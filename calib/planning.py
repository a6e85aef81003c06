r"""Which pose or turn to record next: the one that lowers the worst standard error most.

The information that a recording holds on the 21 parameters (accelerometer: bias, scale factor
error, three misalignments; gyroscope: bias, scale factor error, six misalignments) is added up
from linearised equations, at the nominal sensor:

- a pose with up direction u (unit, frame s) has one equation, ``|a| = g``::

      u . (db_a + g (S_a + M_a) u) / sigma_pose

- its gyroscope reads its own bias, three equations: ``db_g / sigma_static``;
- a turn with rotation ``mat_0t`` from its start ends at the up direction that the accelerometer
  sees, two equations, across up at the start (heading is free)::

      u0 x integral of mat_0t (db_g + (S_g + M_g) w) dt / sigma_turn

An action is a turn from the present pose about an axis of the sensor, then a rest: one new pose and
one turn. Actions are compared by the largest ratio of standard error to target that they leave; a
weak prior (100 times the target) keeps what is not yet determined finite.

References
----------
.. [1] A. C. Atkinson, A. N. Donev, R. D. Tobias, Optimum Experimental Designs, with SAS, 2007,
   chapter 12 (sequential design by exchange of the information matrix).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from calib.recording import AXES
from calib.rotation import mat_from_rotvec, skew
from calib.types import FloatArray

_ACCEL_PAIRS = ((1, 0), (2, 0), (2, 1))
_GYRO_PAIRS = tuple((i, j) for i in range(3) for j in range(3) if i != j)
NAMES = (
    *(f"accel.bias.{a}" for a in AXES),
    *(f"accel.scale_factor_error.{a}" for a in AXES),
    *(f"accel.misalignment.{AXES[i]}{AXES[j]}" for i, j in _ACCEL_PAIRS),
    *(f"gyro.bias.{a}" for a in AXES),
    *(f"gyro.scale_factor_error.{a}" for a in AXES),
    *(f"gyro.misalignment.{AXES[i]}{AXES[j]}" for i, j in _GYRO_PAIRS),
)
"""The parameters that are planned for, in the order of the information matrix."""

PRIOR_OVER_TARGET = 100.0


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of one equation of each kind.

    ``pose`` in m/s² (noise of the mean and how well a pose repeats), ``static`` in rad/s,
    ``turn`` in rad.
    """

    pose: float
    static: float
    turn: float


@dataclass(frozen=True, eq=False)
class Action:
    """Turn about `axis` (unit, frame s) by `angle` (rad, right-hand), then rest.

    ``up`` is where up is, in frame s, once it rests.
    """

    axis: FloatArray
    angle: float
    up: FloatArray


@dataclass(frozen=True, eq=False)
class Choice:
    """The best next action, why, and what it will bring.

    ``worst`` is the parameter that is farthest from its target now, ``ratio_before`` its standard
    error over the target, ``ratio_after`` the largest such ratio that the action leaves.
    """

    action: Action
    worst: str
    ratio_before: float
    ratio_after: float


def pose_information(up: FloatArray, *, gravity: float, accuracy: Accuracy) -> FloatArray:
    """Return the (21, 21) information of one pose: |a| = g, and the gyroscope at rest."""
    rows = np.zeros((4, len(NAMES)))
    rows[0, :3] = up
    rows[0, 3:6] = gravity * up**2
    rows[0, 6:9] = [gravity * up[i] * up[j] for i, j in _ACCEL_PAIRS]
    rows[0] /= accuracy.pose
    rows[1:, 9:12] = np.eye(3) / accuracy.static
    return rows.T @ rows


def turn_information(
    up: FloatArray,
    time: FloatArray,
    mat_0t: FloatArray,
    rate: FloatArray,
    *,
    accuracy: Accuracy,
) -> FloatArray:
    """Return the (21, 21) information of one turn, from rest to rest.

    Parameters
    ----------
    up : (3,) array
        Up in frame s at the start.
    time : (n,) array, s
    mat_0t : (n, 3, 3) array
        From frame s at each time to frame s at the start.
    rate : (n, 3) array, rad/s
    """
    columns = np.zeros((len(time), 3, len(NAMES)))
    columns[:, :, 9:12] = mat_0t
    columns[:, :, 12:15] = mat_0t * rate[:, None, :]
    for k, (i, j) in enumerate(_GYRO_PAIRS):
        columns[:, :, 15 + k] = mat_0t[:, :, i] * rate[:, None, j]
    rows = skew(up) @ np.trapezoid(columns, time, axis=0) / accuracy.turn
    return rows.T @ rows


def action_information(
    action: Action, up: FloatArray, *, turn_time: float, gravity: float, accuracy: Accuracy
) -> FloatArray:
    """Return the (21, 21) information that an action from the pose `up` would bring."""
    time = np.linspace(0.0, turn_time, 33)
    rate = np.broadcast_to(action.axis * action.angle / turn_time, (len(time), 3))
    mats = mat_from_rotvec(rate * time[:, None])
    return turn_information(up, time, mats, rate, accuracy=accuracy) + pose_information(
        action.up, gravity=gravity, accuracy=accuracy
    )


def prior_information(targets: Mapping[str, float]) -> FloatArray:
    """Return the weak prior, as if each parameter were known to 100 times its target."""
    sigma = PRIOR_OVER_TARGET * np.array([targets[name] for name in NAMES])
    return np.diag(sigma**-2.0)


def standard_errors(information: FloatArray) -> dict[str, float]:
    """Return the standard error of each parameter, from an information matrix."""
    # Scaled to unit diagonal: the parameters differ by many orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale))
    return dict(zip(NAMES, (scale * np.sqrt(np.diag(covariance))).tolist(), strict=True))


def candidate_actions(up: FloatArray, *, angles: Sequence[float]) -> list[Action]:
    """Return turns that a hand can do from the pose `up`.

    About each axis of the sensor and each diagonal of its faces, both ways, by each of `angles`;
    not about an axis within 25° of up, where gravity does not see the turn.
    """
    actions = []
    for direction in product((-1, 0, 1), repeat=3):
        if not 1 <= np.abs(direction).sum() <= 2:
            continue
        axis = np.array(direction, np.float64)
        axis /= np.linalg.norm(axis)
        if abs(axis @ up) > np.cos(np.radians(25)):
            continue
        for angle in angles:
            mat = mat_from_rotvec(axis * angle)
            actions.append(Action(axis, angle, mat.T @ up))
    return actions


def next_action(
    information: FloatArray,
    up: FloatArray,
    *,
    targets: Mapping[str, float],
    actions: Sequence[Action],
    turn_time: float,
    gravity: float,
    accuracy: Accuracy,
) -> Choice:
    """Return the action that leaves the smallest worst ratio of standard error to target.

    Ties (the worst is out of reach of any one action) are broken by the sum of squared ratios.

    Raises
    ------
    ValueError
        If there are no `actions`.
    """
    if not actions:
        raise ValueError("`actions` is empty: there is nothing to choose from")
    prior = prior_information(targets)
    before = _ratios(information + prior, targets)
    worst = int(np.argmax(before))
    best: tuple[float, float, Action] | None = None
    for action in actions:
        gain = action_information(
            action, up, turn_time=turn_time, gravity=gravity, accuracy=accuracy
        )
        ratios = _ratios(information + prior + gain, targets)
        score = (round(float(ratios.max()), 6), float(ratios @ ratios))
        if best is None or score < best[:2]:
            best = (*score, action)
    assert best is not None
    return Choice(best[2], NAMES[worst], float(before[worst]), best[0])


def six_face_information(*, gravity: float, accuracy: Accuracy, turn_time: float) -> FloatArray:
    """Return what one round of the usual routine brings: six faces, 90° turns between them."""
    x, y, z = np.eye(3)
    total = np.zeros((len(NAMES), len(NAMES)))
    up = z
    for axis in (x, x, x, y, z, z):
        if abs(axis @ up) > 0.5:
            axis = np.roll(axis, 1)
        mat = mat_from_rotvec(axis * np.pi / 2)
        action = Action(axis, np.pi / 2, mat.T @ up)
        total += action_information(
            action, up, turn_time=turn_time, gravity=gravity, accuracy=accuracy
        )
        up = action.up
    return total


def _ratios(information: FloatArray, targets: Mapping[str, float]) -> FloatArray:
    errors = standard_errors(information)
    return np.array([errors[name] / targets[name] for name in NAMES])
