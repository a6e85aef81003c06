"""Static poses: what the sensor read while it was at rest."""

from __future__ import annotations

from dataclasses import dataclass

from calib.types import FloatArray, IntArray


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
