"""Motions with a closed form: the paper's sinusoidal attitudes, a pendulum, a thermal soak."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ellipj, ellipk

from calib.rotation import quat_from_rotvec
from calib.simulation.kinematics import Angle, Kinematics, Motion, Path, Segment, at_rest
from calib.types import FloatArray

X, Y, Z = np.eye(3)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def paper_sinusoid(*, duration: float = 100.0, gravity: float = 9.80665) -> Motion:
    """Return slow sinusoidal attitudes, with no acceleration.

    ``roll = pi sin(2 pi 0.05 t)``, ``pitch = pi/2 sin(2 pi 0.031 t + 0.3)``, yaw 0: pitch turns the
    sensor about y first, then roll about its x, so that the specific force is
    ``g (-sin pitch, cos pitch sin roll, cos pitch cos roll)``.

    References
    ----------
    .. [1] Ranjbaran et al. 2018 (the convention page's [1]) simulate "sinusoidal" motion; the
       frequencies are this project's.
    """
    _positive("duration", duration)

    def kinematics(time: FloatArray) -> Kinematics:
        pitch = _sine(time, np.pi / 2, 0.031, 0.3)
        roll = _sine(time, np.pi, 0.05, 0.0)
        upright = at_rest(np.tile(UPRIGHT, (len(time), 1)))
        return Kinematics(upright.then(Y, pitch).then(X, roll))

    return Motion("paper", duration, kinematics, gravity=gravity)


def _sine(time: FloatArray, amplitude: float, frequency: float, phase: float) -> Angle:
    w = 2 * np.pi * frequency
    sine = amplitude * np.sin(w * time + phase)
    return Angle(sine, amplitude * w * np.cos(w * time + phase), -w * w * sine)


def pendulum(
    *,
    duration: float = 60.0,
    amplitude: float = np.pi / 4,
    length: float = 0.5,
    distance: float = 0.4,
    hold: float = 5.0,
    mount: FloatArray | None = None,
    gravity: float = 9.80665,
) -> Motion:
    """Return a sensor on a pendulum that is held, let go at `hold` seconds, and swings for good.

    Parameters
    ----------
    duration : float, s
    amplitude : float, rad
        Of the swing about the x axis of frame n, below pi.
    length : float, m
        Of the simple pendulum that swings as fast: its small swings take ``2 pi sqrt(length/g)``.
    distance : float, m
        From the pivot to the sensor. At `distance` = `length` the sensor feels no force along the
        swing.
    hold : float, s
    mount : (4,) quaternion or None
        The sensor's orientation on the rod; None has z along the rod upwards and x along the pivot.

    Notes
    -----
    ``sin(theta/2) = k cd(w0 t | k²)``, ``k = sin(amplitude/2)``: the exact solution, in Jacobi's
    elliptic functions, for any amplitude.

    References
    ----------
    .. [1] NIST Digital Library of Mathematical Functions, section 22.19(i).
    """
    _positive("duration", duration)
    _positive("length", length)
    if not 0 < amplitude < np.pi:
        raise ValueError(f"`amplitude` must be between 0 and pi, got {amplitude}")
    k = np.sin(amplitude / 2)
    w0 = np.sqrt(gravity / length)
    fixed = UPRIGHT if mount is None else np.asarray(mount, np.float64)

    def kinematics(time: FloatArray) -> Kinematics:
        since = np.maximum(time - hold, 0.0)
        sn, cn, dn, _ = ellipj(np.remainder(w0 * since, 4 * ellipk(k * k)), k * k)
        theta = 2 * np.arcsin(k * cn / dn)
        rate = -2 * k * w0 * np.sqrt(1 - k * k) * sn / dn
        free = time > hold
        swing = Angle(theta, rate, np.where(free, -w0 * w0 * np.sin(theta), 0.0))
        turning = at_rest(np.tile(UPRIGHT, (len(time), 1))).then(X, swing)
        sine, cosine, zero = np.sin(theta), np.cos(theta), np.zeros_like(theta)
        outward = np.stack([zero, sine, -cosine], axis=1)
        forward = np.stack([zero, cosine, sine], axis=1)
        velocity = distance * rate[:, None] * forward
        acceleration = distance * (
            swing.acceleration[:, None] * forward - rate[:, None] ** 2 * outward
        )
        path = Path(distance * outward, velocity, acceleration)
        return Kinematics(turning.mounted(fixed), path)

    segments = (
        Segment("static", 0.0, min(hold, duration), "held"),
        Segment("spin", min(hold, duration), duration, "swing"),
    )
    return Motion("pendulum", duration, kinematics, segments, gravity=gravity)


def thermal_soak(
    *,
    temperatures: Sequence[float] = (25.0, 60.0, -10.0, 25.0),
    dwell: float = 600.0,
    ramp: float = 900.0,
    lag: float = 60.0,
    attitude: FloatArray | None = None,
    gravity: float = 9.80665,
) -> Motion:
    """Return one pose in a chamber that goes from temperature to temperature.

    The chamber dwells at each temperature for `dwell` seconds and takes `ramp` seconds to the next;
    the sensor follows it as ``dT/dt = (chamber - T) / lag``, solved exactly piece by piece.

    Parameters
    ----------
    temperatures : sequence of float, °C
    dwell, ramp, lag : float, s
    attitude : (4,) quaternion of ``mat_ns`` or None
        None is level.
    """
    if not temperatures:
        raise ValueError("`temperatures` must name at least one temperature")
    for name, value in (("dwell", dwell), ("ramp", ramp), ("lag", lag)):
        _positive(name, value)
    knots, chamber = [0.0], [float(temperatures[0])]
    for k, level in enumerate(temperatures):
        if k:
            knots.append(knots[-1] + ramp)
            chamber.append(float(level))
        knots.append(knots[-1] + dwell)
        chamber.append(float(level))
    at, level_at = np.array(knots), np.array(chamber)
    slope = np.diff(level_at) / np.diff(at)
    # On a straight piece the sensor is behind by lag * slope, and what is left over decays.
    excess = np.zeros(len(slope))
    sensor = level_at[0]
    for k, s in enumerate(slope):
        excess[k] = sensor - (level_at[k] - lag * s)
        sensor = level_at[k + 1] - lag * s + excess[k] * np.exp(-(at[k + 1] - at[k]) / lag)

    def temperature(time: FloatArray) -> FloatArray:
        k = np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(slope) - 1)
        since = time - at[k]
        out: FloatArray = level_at[k] + slope[k] * (since - lag)
        out += excess[k] * np.exp(-since / lag)
        return out

    quat = UPRIGHT if attitude is None else np.asarray(attitude, np.float64)
    return Motion(
        "thermal",
        float(at[-1]),
        lambda time: Kinematics(at_rest(np.tile(quat, (len(time), 1)))),
        (Segment("static", 0.0, float(at[-1]), "soak"),),
        temperature=temperature,
        gravity=gravity,
    )


FACES = {
    "+z": quat_from_rotvec(0.0 * X),
    "-z": quat_from_rotvec(np.pi * X),
    "+x": quat_from_rotvec(-np.pi / 2 * Y),
    "-x": quat_from_rotvec(np.pi / 2 * Y),
    "+y": quat_from_rotvec(np.pi / 2 * X),
    "-y": quat_from_rotvec(-np.pi / 2 * X),
}
"""Orientations ``mat_ns`` with one sensor axis up."""


def _positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"`{name}` must be positive and finite, got {value}")
