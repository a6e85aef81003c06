"""Static poses: what the sensor read while it was at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.recording import Recording
from calib.types import FloatArray, IntArray

BATCHES = 8
"""Batches a pose is cut into to measure how the noise of its mean is correlated in time."""
EXACT = 1e-24
"""Variance over mean square that is rounding in the arithmetic."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Means over k static intervals, in the order of time.

    Parameters
    ----------
    start, stop : (k,) arrays of int
        Samples ``[start, stop)`` of each interval in the recording.
    interval : (k, 2) array, s
        Recording seconds of its first and last sample.
    accel, gyro : (k, 3) arrays, m/s² and rad/s
        Means of the measured signals.
    accel_covariance, gyro_covariance : (k, 3, 3) arrays
        Covariances of those means, from the noise at rest and its correlation in time.
    temperature : (k,) array, °C, or None
    """

    start: IntArray
    stop: IntArray
    interval: FloatArray
    accel: FloatArray
    gyro: FloatArray
    accel_covariance: FloatArray
    gyro_covariance: FloatArray
    temperature: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.start)

    def select(self, index: IntArray | np.ndarray) -> Poses:
        """Return the poses at `index` (integers or a mask)."""
        temperature = None if self.temperature is None else self.temperature[index]
        return Poses(
            self.start[index],
            self.stop[index],
            self.interval[index],
            self.accel[index],
            self.gyro[index],
            self.accel_covariance[index],
            self.gyro_covariance[index],
            temperature,
        )

    @classmethod
    def from_vectors(cls, accel: FloatArray, *, sigma: float) -> Poses:
        """Return poses that are single readings at rest, one a second.

        Parameters
        ----------
        accel : (k, 3) array, m/s²
        sigma : float, m/s²
            Standard deviation of each component, white.
        """
        accel = np.asarray(accel, np.float64)
        k = len(accel)
        start = np.arange(k)
        return cls(
            start,
            start + 1,
            np.repeat(start[:, None].astype(np.float64), 2, axis=1),
            accel,
            np.zeros((k, 3)),
            np.broadcast_to(sigma**2 * np.eye(3), (k, 3, 3)),
            np.zeros((k, 3, 3)),
        )


def average_poses(recording: Recording, start: IntArray, stop: IntArray) -> Poses:
    """Return the poses at samples ``[start, stop)``: means and the covariances of the means.

    The covariance of a mean of n samples is ``C / n * kappa``: C is the covariance of that pose's
    samples, and kappa >= 1 how much the correlation of the noise in time raises the variance of a
    mean over white noise, found for each triad from the means of batches, pooled over all poses
    (non-overlapping batch means). Rounding to ``LSB``, where the noise does not cover it, adds
    ``LSB² / 12``.

    Parameters
    ----------
    recording : Recording
    start, stop : (k,) arrays of int
        In the order of time, not overlapping, ``stop > start``.
    """
    start, stop = np.asarray(start, np.int64), np.asarray(stop, np.int64)
    count = stop - start
    if (count < 1).any():
        raise ValueError("`stop` must be greater than `start`")
    if not len(start):
        empty = np.zeros((0, 3, 3))
        return Poses(
            start, stop, np.zeros((0, 2)), empty[..., 0], empty[..., 0], empty, empty, None
        )
    accel, accel_covariance = _mean(recording.accel, start, stop)
    gyro, gyro_covariance = _mean(recording.gyro, start, stop)
    temperature = None
    if recording.temperature is not None:
        spans = zip(start.tolist(), stop.tolist(), strict=True)
        temperature = np.array([recording.temperature[a:b].mean() for a, b in spans])
    return Poses(
        start,
        stop,
        np.column_stack((recording.time[start], recording.time[stop - 1])),
        accel,
        gyro,
        accel_covariance,
        gyro_covariance,
        temperature,
    )


def _mean(values: FloatArray, start: IntArray, stop: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return means (k, 3) and covariances of the means (k, 3, 3)."""
    k = len(start)
    mean, sample = np.empty((k, 3)), np.zeros((k, 3, 3))
    ratios = []
    for p, (a, b) in enumerate(zip(start.tolist(), stop.tolist(), strict=True)):
        mean[p] = values[a:b].mean(axis=0)
        rest = values[a:b] - mean[p]
        if b - a > 1:
            sample[p] = rest.T @ rest / (b - a - 1)
        white = float(np.trace(sample[p]))
        width = (b - a) // BATCHES
        if width > 1 and white > EXACT * float(mean[p] @ mean[p]):
            batch = rest[: width * BATCHES].reshape(BATCHES, width, 3).mean(axis=1)
            ratios.append(width * float(batch.var(axis=0, ddof=1).sum()) / white)
    kappa = max(1.0, float(np.mean(ratios))) if ratios else 1.0
    # With noise below a step the mean does not get better by averaging: rounding stays in it.
    variance = np.einsum("kii->ki", sample)
    step = _steps(values)
    floor = np.where(variance < 0.25 * step**2, step**2 / 12, 0.0)
    covariance = sample * (kappa / (stop - start))[:, None, None]
    covariance[:, range(3), range(3)] += floor
    return mean, covariance


def resolution(recording: Recording) -> tuple[float, float]:
    """Return the steps of accelerometer and gyroscope, m/s² and rad/s: the LSB, or near it."""
    return float(_steps(recording.accel).max()), float(_steps(recording.gyro).max())


def _steps(values: FloatArray) -> FloatArray:
    """Return the smallest change from sample to sample of each column, (3,)."""
    change = np.abs(np.diff(values[:100_000], axis=0))
    change[change == 0] = np.inf
    step = change.min(axis=0, initial=np.inf)
    return np.where(np.isfinite(step), step, 0.0)
