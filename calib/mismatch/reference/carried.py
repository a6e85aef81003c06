"""What the gyroscope of another IMU gets wrong, as an arm carries it to the accelerometer.

The other one's rate ``w`` is off by ``e = b + E w``. Of what the two gyroscopes read only the
difference shows, which is the sensor's own bias, scale factor error and misalignment beside that
reference. But what an arm ``r`` makes the accelerometer feel follows from the rate itself::

    A(w) = skew(w)² + skew(dw/dt)          A(w - e) r = A(w) r + columns @ (b, E) + ...

A bias of half a degree per second at 180 dps and 10 cm is 5 mm/s² that follows the rate. Where an
arm is short little of that shows, and all of it could be an arm of another length: what is known of
such parts beforehand keeps it apart.

References
----------
.. [1] InvenSense, "MPU-6000 and MPU-6050 product specification", rev. 3.4, 2013, p. 12: sensitivity
   to 3 %, across axes to 2 %, output at no rate to 20 dps.
"""

from __future__ import annotations

import numpy as np

from calib.effects.base import Column, State, Term
from calib.model import SensorModel
from calib.recording import AXES, Recording
from calib.statics import find_poses
from calib.types import FloatArray

ARM = "accel_lever_arm"
SLUG = "reference_gyro"
NAMES = (
    *(f"{SLUG}.zero_rate.{a}" for a in AXES),
    *(
        f"{SLUG}.scale_factor_error.{a}" if a == b else f"{SLUG}.misalignment.{a}{b}"
        for a in AXES
        for b in AXES
    ),
)
"""The errors that are fitted: b, and the rows of E."""

SIZES = np.repeat([0.01, 0.01], [3, 9])
"""What they typically are (standard deviations): 0.6 dps beside what it reads at rest, and 1 %, as
data sheets state limits of two to three times that [1]_."""

UNSETTLED = 0.35
"""rad/s: what it may read at rest where it never is, the limit of a data sheet [1]_."""

SEEN = 5e-3
"""m: an arm shorter than that carries less than anybody sees."""


def expected(other: Recording, mat: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the errors (12,) of another IMU are expected, and how far they may be from it.

    ``mat`` (3, 3) takes its vectors to s.
    """
    errors, loose = np.zeros(len(NAMES)), SIZES.copy()
    poses = find_poses(other)
    if len(poses.start):
        errors[:3] = mat @ np.median(poses.gyro, axis=0)
    else:
        loose[:3] = UNSETTLED
    return errors, loose


def rough_arm(state: State, left: FloatArray) -> FloatArray:
    """Return the arm (3,) by which differences (n, 3) of forces shrink most; 0 if it is short."""
    means = left - left.mean(axis=0)
    matrix = state.gradient
    matrix = (matrix - matrix.mean(axis=0)).reshape(-1, 3)
    arm: FloatArray = np.linalg.lstsq(matrix, means.ravel(), rcond=1e-6)[0]
    return arm if np.linalg.norm(arm) > SEEN else np.zeros(3)


def carried(state: State, arm: FloatArray) -> list[Column]:
    """Return what one unit of each of `NAMES` takes from the force that an arm (3,) makes."""
    rate, turning = state.rate, state.rate_dot
    out: list[Column] = []
    zero = np.zeros_like(rate)
    for k in range(len(NAMES)):
        error, slope = zero.copy(), zero.copy()
        if k < 3:
            error[:, k] = 1.0
        else:
            i, j = divmod(k - 3, 3)
            error[:, i], slope[:, i] = rate[:, j], turning[:, j]
        # The derivative of w x (w x r) + dw/dt x r.
        force = np.cross(error, np.cross(rate, arm)) + np.cross(rate, np.cross(error, arm))
        force += np.cross(slope, arm)
        out.append({f"accel.{a}": -force[:, i] for i, a in enumerate(AXES)})
    return out


def true_force(state: State, arm: FloatArray, errors: FloatArray) -> FloatArray:
    """Return the force such that an arm in the measured rate makes of it what the true one would.

    Parameters
    ----------
    state : State
        As the other IMU has it, in the sensor's frame.
    arm : (3,) array, m
    errors : (12,) array
        Of `NAMES`.
    """
    if not (arm.any() and errors.any()):
        return state.force
    bias, matrix = errors[:3], errors[3:].reshape(3, 3)
    rate = state.rate - bias - state.rate @ matrix.T
    turning = state.rate_dot - state.rate_dot @ matrix.T

    def felt(w: FloatArray, slope: FloatArray) -> FloatArray:
        return np.asarray(np.cross(w, np.cross(w, arm)) + np.cross(slope, arm))

    return np.asarray(state.force + felt(rate, turning) - felt(state.rate, state.rate_dot))


def arm_of(model: SensorModel) -> FloatArray:
    """Return the lever arm of a model, (3,) m."""
    arm = np.zeros(3)
    for term in model.terms:
        if term.effect == ARM:
            arm += [term.parameters.get(f"r{a}", 0.0) for a in AXES]
    return arm


def arm_term(arm: FloatArray) -> Term:
    """Return the term of an arm, (3,) m."""
    return Term(ARM, {f"r{a}": float(v) for a, v in zip(AXES, arm, strict=True)})
