"""Static poses: what the sensor read while it was at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.recording import Recording
from calib.types import FloatArray, IntArray

BATCHES = 8
"""Batches a pose is cut into to measure how the noise of its mean is correlated in time."""


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
    # Rows of all poses one after another; `offset` is where each pose begins among them.
    offset = np.concatenate(([0], np.cumsum(count)[:-1]))
    owner = np.repeat(np.arange(len(start)), count)
    rows = np.arange(len(owner)) - offset[owner] + start[owner]
    accel, accel_covariance = _mean(recording.accel[rows], offset, count, owner)
    gyro, gyro_covariance = _mean(recording.gyro[rows], offset, count, owner)
    temperature = None
    if recording.temperature is not None:
        temperature = np.add.reduceat(recording.temperature[rows], offset) / count
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


def _mean(
    values: FloatArray, offset: IntArray, count: IntArray, owner: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return means (k, 3) and covariances of the means (k, 3, 3)."""
    mean = np.add.reduceat(values, offset, axis=0) / count[:, None]
    rest = values - mean[owner]
    pair = [(i, j) for i in range(3) for j in range(i, 3)]
    products = np.column_stack([rest[:, i] * rest[:, j] for i, j in pair])
    sums = np.add.reduceat(products, offset, axis=0) / np.maximum(count - 1, 1)[:, None]
    sample = np.empty((len(count), 3, 3))
    for column, (i, j) in enumerate(pair):
        sample[:, i, j] = sample[:, j, i] = sums[:, column]
    long = count >= 2 * BATCHES
    kappa = 1.0
    if long.any():
        width = count[long] // BATCHES
        edges = offset[long, None] + width[:, None] * np.arange(BATCHES + 1)
        sums = np.concatenate((np.zeros((1, 3)), np.cumsum(rest, axis=0)))
        batch = np.diff(sums[edges], axis=1) / width[:, None, None]
        spread = batch.var(axis=1, ddof=1) * width[:, None]
        white = np.einsum("kii->ki", sample[long])
        # The ratio of sums, not the mean of ratios: poses with little noise must not dominate.
        weight = 1.0 / np.maximum(white.mean(axis=1), np.finfo(float).tiny)
        expected = float((white.mean(axis=1) * weight).sum())
        kappa = max(1.0, float((spread.mean(axis=1) * weight).sum()) / expected)
    # With noise below a step the mean does not get better by averaging: rounding stays in it.
    variance = np.einsum("kii->ki", sample)
    step = _steps(values)
    floor = np.where(variance < 0.25 * step**2, step**2 / 12, 0.0)
    covariance = sample * (kappa / count)[:, None, None]
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
