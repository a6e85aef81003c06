"""Find the static poses of a recording, without a threshold from the user.

The recording is cut into blocks of about 0.1 s. A window of a few blocks is at rest when

- its samples scatter no more than the recording's own noise at rest, in both sensors,
- its mean rate is the gyroscope's rate at rest.

Both levels come from the recording itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.types import BoolArray, FloatArray, IntArray

BLOCK = 0.1
WINDOW = 0.5


@dataclass(frozen=True, eq=False)
class _Blocks:
    edges: IntArray
    accel: FloatArray
    gyro: FloatArray
    accel_power: FloatArray
    gyro_power: FloatArray


def find_poses(recording: Recording, *, minimum_duration: float = 1.0) -> Poses:
    """Return the static poses of a recording; none if it only moves.

    Parameters
    ----------
    recording : Recording
    minimum_duration : float, s
        The shortest rest that counts as a pose.
    """
    step = recording.interval
    if len(recording) < 8 or step <= 0:
        return average_poses(recording, np.zeros(0, np.int64), np.zeros(0, np.int64))
    size = max(1, round(BLOCK / step))
    blocks = _cut(recording, size)
    width = max(3, round(WINDOW / (size * step)))
    static = _static_blocks(blocks, width)
    start, stop = _runs(static)
    start, stop = blocks.edges[start + 1], blocks.edges[stop - 1]
    keep = (stop - start) * step >= minimum_duration - 2 * size * step
    return average_poses(recording, start[keep], stop[keep])


def _cut(recording: Recording, size: int) -> _Blocks:
    n = len(recording) // size
    edges = np.arange(n + 1) * size

    def stats(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        shaped = values[: n * size].reshape(n, size, 3)
        mean = shaped.mean(axis=1)
        power = np.square(shaped - mean[:, None]).sum(axis=(1, 2)) / size
        return mean, power

    accel, accel_power = stats(recording.accel)
    gyro, gyro_power = stats(recording.gyro)
    return _Blocks(edges, accel, gyro, accel_power, gyro_power)


def _static_blocks(blocks: _Blocks, width: int) -> BoolArray:
    n = len(blocks.accel)
    if n < width:
        return np.zeros(n, bool)
    activity = [
        _window_rms(blocks.accel, blocks.accel_power, width),
        _window_rms(blocks.gyro, blocks.gyro_power, width),
    ]
    quiet = np.ones(n - width + 1, bool)
    for level in activity:
        floor = np.quantile(level, 0.05)
        quiet &= level <= 4.0 * floor
    mean = _moving_mean(blocks.gyro, width)
    bias = np.median(mean[quiet], axis=0)
    off = np.linalg.norm(mean - bias, axis=1)
    quiet &= off <= 8.0 * np.median(off[quiet])
    static = np.zeros(n, bool)
    for k in range(width):
        static[k : n - width + 1 + k] |= quiet
    return static


def _moving_mean(values: FloatArray, width: int) -> FloatArray:
    sums = np.concatenate((np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)))
    return np.asarray((sums[width:] - sums[:-width]) / width, np.float64)


def _window_rms(mean: FloatArray, power: FloatArray, width: int) -> FloatArray:
    centred = mean - np.median(mean, axis=0)
    average = _moving_mean(centred, width)
    total = np.square(centred).sum(axis=1) + power
    second = _moving_mean(total[:, None], width)[:, 0] - np.square(average).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(second, 0.0)), np.float64)


def _runs(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the index ranges ``[start, stop)`` of the runs of True."""
    edge = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
