"""The motion of a real recording, from its own rests and turns.

Orientation and acceleration are splines (`calib.simulation.through`): the derivatives of the one
are rate and angular acceleration, the integrals of the other velocity and position.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from calib.effects.base import State
from calib.errors import InsufficientMotionError
from calib.model import SensorModel
from calib.poses import Poses
from calib.recording import Recording
from calib.rotation import (
    cumulative_quat,
    mat_from_quat,
    quat_from_rotvec,
    quat_multiply,
)
from calib.simulation.bridges import bridged
from calib.simulation.kinematics import Kinematics, Motion, Segment
from calib.simulation.through import motion_through, one_sign, path_under
from calib.thermometer import Temperature, known_temperature
from calib.turns import turns_and_shaking
from calib.types import FloatArray

UP = np.array([0.0, 0.0, 1.0])
FEWEST = 2
"""Samples that a motion goes through."""


def motion_of(
    recording: Recording,
    model: SensorModel,
    poses: Poses,
    *,
    gravity: float,
) -> Motion:
    """Estimate the true motion of a recording from its rests and turns.

    At rest the sensor neither turns nor accelerates, and gravity gives roll and pitch. In a turn
    the rate, corrected by `model` and by what the gyro reads off at the rests about it, is
    integrated from rest to rest; what is missing to the gravity of the next pose is spread over the
    turn in proportion to the rate. The specific force less gravity is the hand's acceleration; what
    is missing to standing still at the end is spread likewise. Heading starts at 0.

    Both signals first go through a local Wiener filter that knows the noise at rest: what is above
    the noise passes as it is, what is not is averaged over five samples.

    Parameters
    ----------
    recording : Recording
    model : SensorModel
        The sensor that recorded it.
    poses : Poses
        Its rests, as `calib.statics.find_poses` finds them.
    gravity : float, m/s²

    Returns
    -------
    Motion
        Its time 0 is the recording's first sample.

    Raises
    ------
    InsufficientMotionError
        If there are fewer than two samples.
    """
    if len(recording) < FEWEST:
        raise InsufficientMotionError(
            f"the recording has {len(recording)} sample{'s' * (len(recording) > 1)}: no motion can "
            f"be taken from fewer than {FEWEST}"
        )
    time = recording.time - recording.time[0]
    temperature = temperature_of(recording)
    measured = State(
        recording.time,
        recording.accel,
        recording.gyro,
        temperature=None if temperature is None else temperature(time),
        temperature_slope=None if temperature is None else temperature.rate_at(time),
        power_on=float(recording.time[0]),
        gravity=gravity,
    )
    true = model.correct(measured)
    moving, shake = _moving(recording, poses)
    force = _without_noise(true.accel, poses, shake)
    rate = _without_noise(true.gyro, poses, np.zeros_like(shake))
    rate -= _rest_bias(time, true.gyro, poses)
    quat, acceleration = _smooth(time, force, rate, true.accel, poses, gravity)
    segments = [
        Segment("static", time[a], time[b - 1], f"pose {k + 1}")
        for k, (a, b) in enumerate(_pairs(poses))
    ]
    segments += [
        Segment("turn", a, b, f"turn {k + 1}")
        for k, (a, b) in enumerate((moving - recording.time[0]).tolist())
    ]
    return Motion(
        "recording",
        float(time[-1]),
        _moving_as(time, quat, acceleration),
        tuple(sorted(segments, key=lambda segment: segment.start)),
        temperature=temperature,
        vibration=_interpolated(time, np.sqrt(shake)) if shake.any() else None,
        gravity=gravity,
    )


def _moving_as(
    time: FloatArray, quat: FloatArray, acceleration: FloatArray
) -> Callable[[FloatArray], Kinematics]:
    """Return the motion through orientations (n, 4) and accelerations in frame n (n, 3)."""
    time, values = bridged(time, np.hstack((one_sign(quat), acceleration)))
    return motion_through(time, values[:, :4], path_under(time, values[:, 4:]))


def _smooth(
    time: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    raw_force: FloatArray,
    poses: Poses,
    gravity: float,
) -> tuple[FloatArray, FloatArray]:
    """Return orientations (n, 4) and accelerations in frame n (n, 3)."""
    n = len(time)
    quat, acceleration = np.empty((n, 4)), np.zeros((n, 3))
    if not len(poses):
        up = force.mean(axis=0)
        quat[:] = quat_multiply(_level(up), _integrate(time, rate))
        return quat, _free(quat, force, gravity)
    ups = np.stack([raw_force[a:b].mean(axis=0) for a, b in _pairs(poses)])
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    now = _level(ups[0])
    # Before the first pose: backwards from it, with nothing to close on.
    a = poses.start[0]
    head = _integrate(time[: a + 1], rate[: a + 1])
    quat[: a + 1] = quat_multiply(quat_multiply(now, _conjugate(head[-1])), head)
    acceleration[:a] = _free(quat[:a], force[:a], gravity) * _taper(time[:a], first=False)
    for k, (a, b) in enumerate(_pairs(poses)):
        quat[a:b] = now
        stop = poses.start[k + 1] + 1 if k + 1 < len(poses) else n
        part = slice(b - 1, stop)
        last = k + 1 == len(poses)
        ease = _taper(time[part], last=not last)
        moved = rate[part] * ease
        if not last:
            moved = _close(time[part], moved, ups[k], ups[k + 1])
        quat[part] = quat_multiply(now, _integrate(time[part], moved))
        free = _free(quat[part], force[part], gravity) * ease
        if not last:
            left = CubicSpline(time[part], free).integrate(time[part][0], time[part][-1])
            free -= left * _share(time[part], moved)
        acceleration[part] = free
        now = quat[stop - 1] / np.linalg.norm(quat[stop - 1])
    return quat, acceleration


def _close(time: FloatArray, rate: FloatArray, up: FloatArray, next_up: FloatArray) -> FloatArray:
    """Return the rate with the least rotation added that ends it at the next pose's gravity."""
    share = _share(time, rate)
    for _ in range(4):
        quat = _integrate(time, rate)
        found = mat_from_quat(quat[-1]).T @ up
        # exp(missing)' found = next_up, about the axis that is square to both.
        missing = _between(next_up, found)
        if np.linalg.norm(missing) < 1e-12:
            break
        back = mat_from_quat(quat).transpose(0, 2, 1) @ (mat_from_quat(quat[-1]) @ missing)
        rate = rate + share * back
    return rate


def _integrate(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return quaternions (n, 4) from identity: the spline's integral and the coning term.

    The trapezoidal rule would lose 1.5 % of a 10 Hz tremor at 100 Hz, and the motion with it.
    """
    quat = np.zeros((len(time), 4))
    quat[0, 0] = 1.0
    if len(time) > 1:
        whole = CubicSpline(time, rate).antiderivative()(time)
        coning = np.diff(time)[:, None] ** 2 / 12 * np.cross(rate[:-1], rate[1:])
        quat[1:] = cumulative_quat(quat_from_rotvec(np.diff(whole, axis=0) + coning))
    return quat


def _between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the rotation vector with ``exp(out) first = second``, for unit vectors."""
    axis = np.cross(first, second)
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, first @ second)
    return axis * (angle / sine) if sine > 1e-15 else np.zeros(3)


def _share(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return how a correction is spread over a turn, (n, 1) in 1/s: in proportion to the rate."""
    size = np.linalg.norm(rate, axis=1)
    if not size.any():
        size = np.ones(len(time))
        size[[0, -1]] = 0.0
    total = np.trapezoid(size, time)
    return (size / total)[:, None] if total else np.zeros((len(time), 1))


def _taper(
    time: FloatArray, *, first: bool = True, last: bool = True, ease: float = 0.05
) -> FloatArray:
    """Return a weight (n, 1) that rises from 0 at one end and falls to 0 at the other."""
    if not len(time):
        return np.zeros((0, 1))
    ease = min(ease, 0.25 * (time[-1] - time[0])) or 1.0
    weight = np.ones(len(time))
    if first:
        weight *= np.clip((time - time[0]) / ease, 0.0, 1.0)
    if last:
        weight *= np.clip((time[-1] - time) / ease, 0.0, 1.0)
    return (weight * weight * (3 - 2 * weight))[:, None]


def _free(quat: FloatArray, force: FloatArray, gravity: float) -> FloatArray:
    out: FloatArray = np.einsum("nij,nj->ni", mat_from_quat(quat), force)
    out[:, 2] -= gravity
    return out


def _level(up: FloatArray) -> FloatArray:
    """Return the orientation with this direction up and the least turn: heading 0."""
    up = up / np.linalg.norm(up)
    if up[2] < -1 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    return quat_from_rotvec(_between(up, UP))


def _conjugate(quat: FloatArray) -> FloatArray:
    return quat * [1.0, -1.0, -1.0, -1.0]


def _without_noise(values: FloatArray, poses: Poses, shake: FloatArray) -> FloatArray:
    """Return (n, 3) values through a local Wiener filter with the variance at rest as its noise.

    Where something shakes, a variance of it is no motion either.

    References
    ----------
    .. [1] J. S. Lim, Two-Dimensional Signal and Image Processing, 1990, eq. 9.26-9.29.
    """
    if not len(poses) or len(values) < 5:
        return np.array(values)
    noise = np.median(
        [values[a:b].var(axis=0) - shake[a:b].mean(axis=0) for a, b in _pairs(poses)], axis=0
    )
    noise = np.maximum(noise, 0.0) + shake
    mean = uniform_filter1d(values, 5, axis=0, mode="nearest")
    variance = uniform_filter1d(values**2, 5, axis=0, mode="nearest") - mean**2
    gain = np.maximum(0.0, 1.0 - noise / np.maximum(variance, np.finfo(float).tiny))
    out: FloatArray = mean + gain * (values - mean)
    return out


def _pairs(poses: Poses) -> list[tuple[int, int]]:
    return [(int(a), int(b)) for a, b in zip(poses.start, poses.stop, strict=True)]


def _rest_bias(time: FloatArray, rate: FloatArray, poses: Poses) -> FloatArray:
    """Return what the gyro still reads at rest, between the rests by straight lines, (n, 3)."""
    if not len(poses):
        return np.zeros_like(rate)
    pairs = _pairs(poses)
    at = np.array([time[a:b].mean() for a, b in pairs])
    means = np.stack([rate[a:b].mean(axis=0) for a, b in pairs])
    return np.stack([np.interp(time, at, means[:, i]) for i in range(3)], axis=1)


def _moving(recording: Recording, poses: Poses) -> tuple[FloatArray, FloatArray]:
    """Return when turns begin and end, (k, 2) s, and what shakes beyond the noise, (n, 3)."""
    if not len(poses):
        return np.zeros((0, 2)), np.zeros_like(recording.accel)
    moving, vibration, quiet = turns_and_shaking(recording, poses)
    return moving, np.maximum(vibration - quiet, 0.0)


def _interpolated(time: FloatArray, values: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return (n, k) values between their times, by straight lines."""
    return lambda when: np.stack([np.interp(when, time, v) for v in values.T], axis=1)


def temperature_of(recording: Recording) -> Temperature | None:
    """Return the recorded temperature, without its thermometer's noise and steps, from time 0."""
    known = known_temperature((recording,))
    return None if known is None else known.since(float(recording.time[0]))
