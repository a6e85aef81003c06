"""What a recording that is compared tells by itself: how warm and shaken it was, and its rests."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.effects.base import State
from calib.effects.observed import observed
from calib.mismatch.reference.captured import sensor_densities
from calib.mismatch.reference.stilled import find_rests
from calib.mismatch.reference.witnessed import fast_densities
from calib.recording import Recording
from calib.thermometer import smooth_temperature
from calib.types import FloatArray, IntArray

SETTLED = 3.0
"""Periods of the cut-off after which a low-pass leaves so little of a quarter turn that markers see
nothing of it: 0.01 %."""


@dataclass(frozen=True, eq=False)
class Warmth:
    """Temperature of the sensor, K or °C, and its slope, 1/s, at n times; None without one."""

    temperature: FloatArray | None = None
    slope: FloatArray | None = None

    @property
    def typical(self) -> float | None:
        """The temperature that a sensor's bias and scale factor are said at."""
        return None if self.temperature is None else float(np.median(self.temperature))

    def put_into(self, state: State) -> State:
        """Return a state that is as warm."""
        return replace(state, temperature=self.temperature, temperature_slope=self.slope)


@dataclass(frozen=True, eq=False)
class Stillness:
    """When a recording with all of its noise rests, and how loud its sensor is by itself.

    Parameters
    ----------
    rests : (k, 2) array of int
        Samples ``[first, last)`` that it rests in.
    settled : (k, 2) array of int
        The same where markers see nothing of the motion before and after.
    gyro : (k, 3) array, rad/s
        What the gyroscope shows in each rest.
    densities : two floats, SI/√Hz, optional
        Noise of the accelerometer and of the gyroscope.
    """

    rests: IntArray
    settled: IntArray
    gyro: FloatArray
    densities: tuple[float, float] | None = None


ALWAYS_MOVING = Stillness(np.zeros((0, 2), np.int64), np.zeros((0, 2), np.int64), np.zeros((0, 3)))
"""That of a recording whose rests are not looked for."""


def find_warmth(real: Recording, time: FloatArray) -> Warmth:
    """Return how warm a recording was at some times (n,)."""
    if real.temperature is None:
        return Warmth()
    known = smooth_temperature(real.time, real.temperature)
    return Warmth(known(time), known.rate_at(time))


def find_stillness(raw: Recording, time: FloatArray, *, band: float = 0.0) -> Stillness:
    """Return when a recording rests, as samples at some times (n,).

    ``band`` is the cut-off (Hz) that markers were smoothed with, where the sensor's own noise is
    asked for as well; else 0.
    """
    poses = find_rests(raw)
    densities = None
    if band:
        rests = np.stack((poses.start, poses.stop), axis=1)
        densities = sensor_densities(raw, rests) or fast_densities(raw)
    edges = np.stack((raw.time[poses.start], raw.time[poses.stop - 1]), axis=1)
    settled = ALWAYS_MOVING.settled
    if densities is not None:
        settled = np.searchsorted(time, edges + np.array([SETTLED, -SETTLED]) / band)
        settled = settled[settled[:, 1] > settled[:, 0]]
    return Stillness(np.searchsorted(time, edges), settled, poses.gyro, densities)


def vibration(shaken: Recording, time: FloatArray, *, bias: FloatArray) -> FloatArray:
    """Return how much a recording shook at some times, (n, 3), its gyroscope showing bias still."""
    variance = observed(
        State(shaken.time, shaken.accel, shaken.gyro - bias), ("vibration",)
    ).vibration
    assert variance is not None
    return np.stack([np.interp(time, shaken.time, own) for own in variance.T], axis=1)
