"""True motion: orientation, angular rate and specific force that agree exactly, at any time.

Orientation is a product of rotations about axes, each with an analytic angle, so rate and angular
acceleration follow from the product rule and nothing is differenced::

    mat_ns = prod_k exp(u_k theta_k(t))
    rate <- E_k' rate + u_k dtheta_k,   E_k = exp(u_k theta_k)
    force = mat_ns' (acceleration_n + gravity z_n)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from calib.effects.base import State
from calib.effects.observed import since_and_during
from calib.rotation import mat_from_quat, quat_from_rotvec, quat_multiply
from calib.types import BoolArray, FloatArray


class Angle(NamedTuple):
    """An angle and its first two time derivatives, each (n,): rad, rad/s, rad/s²."""

    value: FloatArray
    rate: FloatArray
    acceleration: FloatArray


class Turning(NamedTuple):
    """Orientation (n, 4) of ``mat_ns``, angular rate and angular acceleration (n, 3) in frame s."""

    quat: FloatArray
    rate: FloatArray
    rate_dot: FloatArray

    def then(self, axis: FloatArray, angle: Angle) -> Turning:
        """Return this turned further about `axis`, (3,) or (n, 3), unit, in the turned frame."""
        turned = quat_multiply(self.quat, quat_from_rotvec(axis * angle.value[:, None]))
        sine, cosine = np.sin(angle.value)[:, None], np.cos(angle.value)[:, None]
        rate = _turn_back(self.rate, axis, sine, cosine)
        own = axis * angle.rate[:, None]
        rate_dot = _turn_back(self.rate_dot, axis, sine, cosine) + np.cross(rate, own)
        return Turning(turned, rate + own, rate_dot + axis * angle.acceleration[:, None])

    def mounted(self, quat: FloatArray) -> Turning:
        """Return this seen from a sensor fixed at orientation `quat` (4,) in the turned frame."""
        mat = mat_from_quat(quat)
        fixed = np.broadcast_to(quat, self.quat.shape)
        return Turning(quat_multiply(self.quat, fixed), self.rate @ mat, self.rate_dot @ mat)


def at_rest(quat: FloatArray) -> Turning:
    """Return orientations (n, 4) that do not turn."""
    zero = np.zeros((len(quat), 3))
    return Turning(quat, zero, zero)


def _turn_back(
    vec: FloatArray, axis: FloatArray, sine: FloatArray, cosine: FloatArray
) -> FloatArray:
    """Rodrigues' formula for the inverse rotation: ``exp(-axis angle) vec``."""
    if not vec.any():
        return vec
    axis = np.broadcast_to(axis, vec.shape)
    along = np.einsum("ij,ij->i", axis, vec)[:, None]
    out: FloatArray = vec * cosine - np.cross(axis, vec) * sine + axis * along * (1 - cosine)
    return out


class Path(NamedTuple):
    """Position, velocity and acceleration of the sensor in frame n, each (n, 3), SI."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


class Kinematics(NamedTuple):
    """How the sensor moves at (n,) times."""

    turning: Turning
    path: Path | None = None


@dataclass(frozen=True)
class Segment:
    """A labelled stretch of a motion, in seconds.

    ``static`` is at rest, ``turn`` goes from rest to rest, ``spin`` turns at a steady rate; how the
    sensor moved in what is ``hidden`` nobody knows.
    """

    kind: Literal["static", "turn", "spin", "hidden"]
    start: float
    stop: float
    label: str = ""


@dataclass(frozen=True, eq=False)
class Motion:
    """A true trajectory, defined at every time from 0 to ``duration``.

    Parameters
    ----------
    name : str
    duration : float, s
    kinematics : function of (n,) times
        Orientation, rate and path.
    segments : tuple of Segment
        The labelled truth, in the order of time.
    temperature : function of (n,) times, °C, or None
    vibration : function of (n,) times, or None
        Standard deviation of the specific force about its mean, (n, 3) m/s².
    power_on : float, s
        When the sensor was switched on (0 or earlier).
    gravity : float, m/s²
    """

    name: str
    duration: float
    kinematics: Callable[[FloatArray], Kinematics]
    segments: tuple[Segment, ...] = ()
    temperature: Callable[[FloatArray], FloatArray] | None = None
    vibration: Callable[[FloatArray], FloatArray] | None = None
    power_on: float = 0.0
    gravity: float = 9.80665

    def intervals(self, kind: str) -> FloatArray:
        """Return (k, 2) start and stop times of the segments of one kind, s."""
        found = [(s.start, s.stop) for s in self.segments if s.kind == kind]
        return np.array(found, np.float64).reshape(-1, 2)

    @property
    def statics(self) -> FloatArray:
        """Intervals at rest, (k, 2) s."""
        return self.intervals("static")

    @property
    def turns(self) -> FloatArray:
        """Intervals of turns from rest to rest, (m, 2) s."""
        return self.intervals("turn")

    def seen(self, time: FloatArray) -> BoolArray:
        """Return at which of (n,) times it is known how the sensor moved."""
        starts, stops = np.sort(self.intervals("hidden"), axis=0).T
        begun = np.searchsorted(starts, time, side="right")
        return np.asarray(begun == np.searchsorted(stops, time, side="left"))

    def until(self, duration: float) -> Motion:
        """Return this motion, ended at `duration` seconds if it lasts longer."""
        kept = (replace(s, stop=min(s.stop, duration)) for s in self.segments if s.start < duration)
        return replace(self, duration=min(self.duration, duration), segments=tuple(kept))

    def state(self, time: FloatArray) -> State:
        """Return the true state at (n,) times, s."""
        time = np.asarray(time, np.float64)
        rotation, path = self.kinematics(time)
        mat_ns = mat_from_quat(rotation.quat)
        if path is None:
            force = self.gravity * mat_ns[:, 2, :]
        else:
            total = path.acceleration + np.array([0.0, 0.0, self.gravity])
            force = np.einsum("nij,ni->nj", mat_ns, total)
        turns = self.turns
        since, turning = since_and_during(time, *turns.T) if len(turns) else (None, None)
        return State(
            time,
            force,
            rotation.rate,
            temperature=None if self.temperature is None else self.temperature(time),
            power_on=self.power_on,
            since_turn=since,
            turning=turning,
            mat_ns=mat_ns,
            vibration=None if self.vibration is None else self.vibration(time) ** 2,
            angular_acceleration=rotation.rate_dot,
            temperature_slope=self._temperature_slope(time),
            gravity=self.gravity,
        )

    def _temperature_slope(self, time: FloatArray) -> FloatArray | None:
        if self.temperature is None:
            return None
        h = 1e-3
        slope: FloatArray = (self.temperature(time + h) - self.temperature(time - h)) / (2 * h)
        return slope
