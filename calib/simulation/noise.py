"""What is random in a sensor's output: white noise, bias instability, random walks.

Spectra are one-sided, as `calib` fixes them. Allan variances of the parts at averaging time T::

    white           N² / (2 T)
    bias            (2 ln 2 / pi) B²              the flat floor, at 0.664 B
    random walk     K² T / 3

References
----------
.. [1] IEEE Std 952-1997, Annex C, eq. C.8, C.15 and C.24.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.signal import lfilter

from calib.effects.base import G, Signals
from calib.poses import Poses
from calib.recording import Recording
from calib.types import FloatArray


@dataclass(frozen=True)
class NoiseModel:
    """Random terms of one IMU, the same on its three axes of each triad. All zero is no noise.

    Parameters
    ----------
    accel_noise_density : (m/s²)/√Hz
    gyro_noise_density : (rad/s)/√Hz
        One-sided: sigma of one sample is N sqrt(rate / 2).
    accel_bias_instability : m/s²
    gyro_bias_instability : rad/s
        B of a 1/f process with one-sided density ``B² / (pi f)``.
    accel_random_walk : (m/s²)/√s
    gyro_random_walk : (rad/s)/√s
        K: the bias wanders by K sqrt(t).
    temperature : °C
        Standard deviation of one temperature sample.
    """

    accel_noise_density: float = 0.0
    gyro_noise_density: float = 0.0
    accel_bias_instability: float = 0.0
    gyro_bias_instability: float = 0.0
    accel_random_walk: float = 0.0
    gyro_random_walk: float = 0.0
    temperature: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"`{item.name}` must be finite and not negative, got {value}")

    def scaled(self, factor: float) -> NoiseModel:
        """Return the same kinds of noise, all `factor` times as large."""
        return replace(self, **{f.name: factor * getattr(self, f.name) for f in fields(self)})

    def draw(self, time: FloatArray, *, rng: np.random.Generator) -> Signals:
        """Return the noise of both triads at (n,) times, s."""
        return Signals(
            _triad_noise(
                time,
                rng,
                self.accel_noise_density,
                self.accel_bias_instability,
                self.accel_random_walk,
            ),
            _triad_noise(
                time,
                rng,
                self.gyro_noise_density,
                self.gyro_bias_instability,
                self.gyro_random_walk,
            ),
        )


CONSUMER = NoiseModel(
    accel_noise_density=400e-6 * G,
    gyro_noise_density=float(np.radians(0.005)),
    accel_bias_instability=50e-6 * G,
    gyro_bias_instability=float(np.radians(10 / 3600)),
    accel_random_walk=5e-6 * G,
    gyro_random_walk=float(np.radians(0.0003)),
    temperature=0.03,
)
"""A consumer part. White noise is the MPU-6050's (product specification rev. 3.4: 400 µg/√Hz,
0.005 dps/√Hz); the slow terms are of the size that Allan deviations of such parts show (floors
of about 30 µg and 7 deg/h, random walk seen from some 100 s on)."""


def noise_at_rest(recording: Recording, poses: Poses) -> NoiseModel:
    """Return the white noise of a recording at its rests; slower noise is left at 0.

    From successive differences, which drift does not enter; rounding to LSB is part of it. The
    median over the rests: one that was shaken does not count. Without a rest there is no noise.
    """
    pairs = [(a, b) for a, b in zip(poses.start, poses.stop, strict=True) if b - a > 1]
    if not pairs or not recording.interval:
        return NoiseModel()
    density = []
    for values in (recording.accel, recording.gyro):
        variance = [np.square(np.diff(values[a:b], axis=0)).mean() / 2 for a, b in pairs]
        density.append(float(np.sqrt(np.median(variance) * 2 * recording.interval)))
    return NoiseModel(accel_noise_density=density[0], gyro_noise_density=density[1])


def _triad_noise(
    time: FloatArray, rng: np.random.Generator, density: float, instability: float, walk: float
) -> FloatArray:
    n = len(time)
    step = float(np.median(np.diff(time))) if n > 1 else 1.0
    out = rng.standard_normal((n, 3)) if density else np.zeros((n, 3))
    out *= density / np.sqrt(2 * step)
    if walk:
        length = np.sqrt(np.diff(time, prepend=time[0]))
        out += np.cumsum(rng.normal(0.0, walk, (n, 3)) * length[:, None], axis=0)
    if instability:
        out += flicker(time, instability, rng=rng)
    return out


def flicker(time: FloatArray, instability: float, *, rng: np.random.Generator) -> FloatArray:
    """Return three columns of 1/f noise, (n, 3): one-sided density ``B² / (pi f)``.

    A sum of Gauss-Markov processes, their correlation times a factor of 3 apart from two samples to
    three times the recording's length, each of variance ``B² ln(3) / pi``; below and above, the
    density is flat and falls as 1/f². Each starts in its stationary state.
    """
    n = len(time)
    if n < 2:
        return np.zeros((n, 3))
    span = float(time[-1] - time[0])
    step = float(np.median(np.diff(time)))
    ratio = 3.0
    count = 1 + int(np.ceil(np.log(max(3 * span / (2 * step), 1.0)) / np.log(ratio)))
    sigma = instability * np.sqrt(np.log(ratio) / np.pi)
    # On an even grid of its own, so that gaps and jitter in time do not matter.
    size = int(np.ceil(span / step)) + 2
    grid = np.zeros((size, 3))
    for correlation in 2 * step * ratio ** np.arange(count):
        keep = np.exp(-step / correlation)
        drive = rng.standard_normal((size, 3))
        drive *= sigma * np.sqrt(1 - keep**2)
        drive[0] /= np.sqrt(1 - keep**2)
        grid += lfilter([1.0], [1.0, -keep], drive, axis=0)
    at = time[0] + step * np.arange(size)
    return np.stack([np.interp(time, at, grid[:, i]) for i in range(3)], axis=1)
