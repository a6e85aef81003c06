"""What another IMU, or a simulated one, gets wrong, as an arm carries it to the accelerometer.

The other one's rate ``w`` is off by ``e = b + E w``, and its force is ``(I + K) f`` and a bias. Of
what the two read only the difference shows, which is the sensor's own bias, scale factor error and
misalignment beside that reference. But what an arm ``r`` makes the accelerometer feel follows from
the rate itself, and has no part in the other's force. So the force of which the sensor's model
makes what it reads is that of the other one, and::

    (I + K) A(w - e) r          A(w) = skew(w)² + skew(dw/dt)

A bias of half a degree per second at 180 dps and 10 cm is 5 mm/s² that follows the rate; a scale
factor error of 3 % there is an axis of the accelerometer that sits 3 mm off the others. Where an
arm is short little of that shows, and all of it could be an arm of another length: what the other
one's own rests and turns tell of it, as those of any recording that is calibrated, and what is
known of such parts beforehand, keep it apart.

K is a lower triangle as the accelerometer's own matrix is: the frame in which they are compared is
the one in which that is so. The axes of the gyroscope may lie anyhow in it.

References
----------
.. [1] InvenSense, "MPU-6000 and MPU-6050 product specification", rev. 3.4, 2013, p. 12 and 13:
   sensitivity of both triads to 3 %, across axes to 2 %, output at no rate to 20 dps; a gyroscope
   is linear to 0.2 % of its full scale, an accelerometer to 0.5 %.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.calibrate import calibrate
from calib.effects.base import Column, State, Term
from calib.errors import ImuError
from calib.mismatch.reference.stilled import find_rests
from calib.mismatch.twin.twin import ACCEL_MISALIGNMENT
from calib.model import SensorModel
from calib.recording import AXES, Recording
from calib.types import FloatArray

ARM = "accel_lever_arm"
GYRO, ACCEL = "reference_gyro", "reference_accel"
GYRO_NAMES = (
    *(f"{GYRO}.zero_rate.{a}" for a in AXES),
    *(
        f"{GYRO}.scale_factor_error.{a}" if a == b else f"{GYRO}.misalignment.{a}{b}"
        for a in AXES
        for b in AXES
    ),
)
ACCEL_NAMES = (
    *(f"{ACCEL}.scale_factor_error.{a}" for a in AXES),
    *(f"{ACCEL}.misalignment.{p}" for p in ACCEL_MISALIGNMENT),
)
NAMES = (*GYRO_NAMES, *ACCEL_NAMES)
"""The errors that are fitted: b, the rows of E, and K."""

OF_GYRO = len(GYRO_NAMES)
"""So many of them are the gyroscope's; the accelerometer's follow."""

LIMITS = {"scale_factor_error": 0.03, "misalignment": 0.02}
"""What a data sheet allows a part that nobody calibrated [1]_. A calibrated one is far better, but
which it is nobody says; where an arm is long enough for that to matter the recording does."""

ZERO_RATE = 0.01
"""rad/s by which a gyroscope is off what it reads at rest, typically: 0.6 dps."""

UNSETTLED = 0.35
"""rad/s: what it may read at rest where it never is, the limit of a data sheet [1]_."""

SIZES = np.array([LIMITS.get(n.split(".")[1], 0.0) / np.sqrt(3.0) or ZERO_RATE for n in NAMES])
"""What the errors typically are: the standard deviation of what is anywhere within its limits."""

LINEAR = {"gyro": 2e-3, "accel": 5e-3}
"""By how much a gain at rest, or in slow turns, may differ from that in fast motion: a part is no
more linear than that [1]_."""

TRIANGLE = [(AXES.index(p[0]), AXES.index(p[-1])) for p in (*AXES, *ACCEL_MISALIGNMENT)]
"""Where each of the errors of the accelerometer is in K."""

_LOWER = tuple(np.transpose(TRIANGLE))

SEEN = 5e-3
"""m: an arm shorter than that carries less than anybody sees."""

PERFECT, QUIET = 1e-4, 1e-5
"""Share of gravity, and rad/s, by which a simulated sensor without errors is off in its rests."""


def settled(other: Recording) -> Recording:
    """Return the recording of another IMU without what its gyroscope reads at rest.

    What that multiplies would be an effect of its own: beside a bias b the cube of a rate has
    ``3 b w²`` in it.
    """
    poses = find_rests(other)
    if not len(poses.start):
        return other
    return replace(other, gyro=other.gyro - np.median(poses.gyro, axis=0))


def known_errors(
    other: Recording, mat_sr: FloatArray, *, gravity: float
) -> tuple[FloatArray, FloatArray]:
    """Return the errors (18,) of another IMU, once it is `settled`, and how far they may be off.

    Both follow from what a data sheet allows and, where it has poses and turns enough, from its own
    calibration. They are those in the sensor's frame, to which ``mat_sr`` (3, 3) leads.
    """
    sizes = SIZES.copy()
    poses = find_rests(other)
    if not len(poses.start):
        sizes[:3] = UNSETTLED
    try:
        own = calibrate(other, gravity=gravity, poses=poses)
    except ImuError:
        return np.zeros(len(NAMES)), sizes
    gyro = np.eye(3) - np.linalg.inv(own.model.gyro.matrix)
    accel = (own.model.accel.matrix - np.eye(3))[_LOWER]
    found = np.concatenate((np.zeros(3), gyro.ravel(), accel))
    names = [n.removeprefix("reference_") for n in NAMES]
    sigma = dict(zip(own.names, np.sqrt(np.diag(own.covariance)), strict=True))
    beyond = np.array([LINEAR[n.partition(".")[0]] for n in names])
    variance = np.square([sigma.get(n, np.inf) for n in names]) + beyond**2
    share = 1.0 / (1.0 + sizes**2 / variance)
    spread = np.sqrt(_turned(share * sizes**2, np.square(mat_sr), squares=True))
    return _turned((1.0 - share) * found, mat_sr), spread


def simulated_errors(
    simulated: Recording, mat_sr: FloatArray, *, gravity: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return what `known_errors` does, of a simulated sensor; None if it has none.

    The signals of a simulation stay as they are: what its gyroscope reads at rest is an error.
    """
    poses = find_rests(simulated)
    if len(poses.start):
        norm = np.linalg.norm(poses.accel, axis=1)
        if np.abs(norm - gravity).max() < PERFECT * gravity and np.abs(poses.gyro).max() < QUIET:
            return None
    errors, spread = known_errors(settled(simulated), mat_sr, gravity=gravity)
    if len(poses.start):
        errors[:3] = mat_sr @ np.median(poses.gyro, axis=0)
    return errors, spread


def _turned(errors: FloatArray, mat: FloatArray, *, squares: bool = False) -> FloatArray:
    """Return errors (18,) in another frame, or their variances with squares of its rotation.

    There K is a lower triangle again after a further small turn, ``I + K = (I + L) (I + A)``: the
    frame that makes it so is turned by A, and the gyroscope's axes lie by A less off it.
    """
    e, k = errors[3:OF_GYRO].reshape(3, 3), _matrix_of(errors)
    e, k = mat @ e @ mat.T, mat @ k @ mat.T
    upper = np.triu(k, 1)
    turn = upper + upper.T if squares else upper - upper.T
    lower = np.tril(k) + upper.T
    e = e + turn if squares else e - turn
    return np.concatenate((mat @ errors[:3], e.ravel(), lower[_LOWER]))


def rough_arm(state: State, left: FloatArray) -> FloatArray:
    """Return the arm (3,) by which differences (n, 3) of forces shrink most; 0 if it is short."""
    means = left - left.mean(axis=0)
    matrix = state.gradient
    matrix = (matrix - matrix.mean(axis=0)).reshape(-1, 3)
    arm: FloatArray = np.linalg.lstsq(matrix, means.ravel(), rcond=1e-6)[0]
    return arm if np.linalg.norm(arm) > SEEN else np.zeros(3)


def carried(state: State, arm: FloatArray, errors: FloatArray) -> list[Column]:
    """Return what one unit more of each of `NAMES` adds to the force that an arm (3,) makes.

    Beside the ``errors`` (18,) that are known already.
    """
    rate, turning = _without(state, errors)
    shown = np.eye(3) + _matrix_of(errors)
    out: list[Column] = []
    zero = np.zeros_like(rate)
    for k in range(OF_GYRO):
        error, slope = zero.copy(), zero.copy()
        if k < 3:
            error[:, k] = 1.0
        else:
            i, j = divmod(k - 3, 3)
            error[:, i], slope[:, i] = state.rate[:, j], state.rate_dot[:, j]
        # The derivative of w x (w x r) + dw/dt x r.
        force = np.cross(error, np.cross(rate, arm)) + np.cross(rate, np.cross(error, arm))
        force = (force + np.cross(slope, arm)) @ shown.T
        out.append({f"accel.{a}": -force[:, i] for i, a in enumerate(AXES)})
    felt = _felt(rate, turning, arm)
    for i, j in TRIANGLE:
        out.append({f"accel.{AXES[i]}": felt[:, j]})
    return out


def true_force(state: State, arm: FloatArray, errors: FloatArray) -> FloatArray:
    """Return the force such that an arm in the measured rate makes of it what the true one would.

    Parameters
    ----------
    state : State
        As the other IMU has it, in the sensor's frame.
    arm : (3,) array, m
    errors : (18,) array
        Of `NAMES`.
    """
    if not (arm.any() and errors.any()):
        return state.force
    felt = _felt(*_without(state, errors), arm)
    felt = felt + felt @ _matrix_of(errors).T
    return np.asarray(state.force + felt - _felt(state.rate, state.rate_dot, arm))


def _without(state: State, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rate and its derivative without a gyroscope's errors."""
    bias, matrix = errors[:3], errors[3:OF_GYRO].reshape(3, 3)
    rate = state.rate - bias - state.rate @ matrix.T
    return rate, state.rate_dot - state.rate_dot @ matrix.T


def _matrix_of(errors: FloatArray) -> FloatArray:
    """Return K, (3, 3)."""
    matrix = np.zeros((3, 3))
    matrix[_LOWER] = errors[OF_GYRO:]
    return matrix


def _felt(rate: FloatArray, turning: FloatArray, arm: FloatArray) -> FloatArray:
    return np.asarray(np.cross(rate, np.cross(rate, arm)) + np.cross(turning, arm))


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
