"""Means of rests that something shakes, over windows that fade into each other.

A mean over a time T keeps of a tone of amplitude A and frequency f as much as A / (pi f T), by
where in its swing it begins and ends. For a machine that shakes by several m/s² that is centimetres
per second squared: a hundred times what the sensor's own noise leaves, and more than the mean is
shifted by if the sensor rectifies what shakes it. In a window that fades in and out over a time L,
by the square of a sine, nothing is left of what is much faster than 2 / L [1]_.

So samples of such rests are averaged over a short such window before the points are. The points of
a rest then overlap, and add up to one window that is flat, but for its ends.

References
----------
.. [1] Harris, "On the use of windows for harmonic analysis with the discrete Fourier transform",
   Proc. IEEE 66, 1978, p. 60: cos²(x), its zeros and how fast it falls off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.mismatch.rows.grid import REST_STEP, Grid, Lapped
from calib.recording import Recording
from calib.types import BoolArray, FloatArray, IntArray

SURE = 4.0
"""Standard errors of a level by which plain means are louder before others are taken."""

FEWEST = 4
"""Differences of points that tell of the noise of a rest."""


def lapped(grid: Grid, recording: Recording) -> Grid:
    """Return a grid whose rests, where that makes their means quieter, have windows that fade.

    Only rests that are shaken are looked at. What a hand does is as slow as a window is long:
    means are no quieter there, and stay.
    """
    half = round(0.5 * REST_STEP / max(recording.interval, 1e-9))
    shaken = _shaken(grid, half)
    if half < 1 or not shaken.any():
        return grid
    taper = np.hanning(2 * half + 3)[1:-1]
    taper /= taper.sum()
    every = _with_windows(grid, recording, shaken, taper)
    (plain, number), (fading, _) = point_noise(grid), point_noise(every)
    limit = 1.0 + SURE * np.sqrt(2.0 / np.maximum(number, 1))
    quieter = shaken & (plain[:, :3].sum(axis=1) > limit * fading[:, :3].sum(axis=1))
    if not quieter.any():
        return grid
    return _with_windows(grid, recording, quieter, taper)


def point_noise(grid: Grid) -> tuple[FloatArray, IntArray]:
    """Return the variance of a sample in each rest, as it counts in means, and what tells of it.

    By successive differences of points: (poses, 6), and their number (poses,).
    """
    values = np.hstack((grid.accel, grid.gyro))
    pose = grid.pose
    pair = (grid.segment[1:] == grid.segment[:-1]) & (pose[1:] >= 0)
    gap = np.diff(grid.time)
    # Across a hole in time the bias has drifted.
    pair &= gap <= 3 * np.median(gap[pair]) if pair.any() else pair
    weight = grid.count[1:] * grid.count[:-1] / (grid.count[1:] + grid.count[:-1])
    if grid.lapped is not None:
        own = pair & grid.lapped.poses[pose[1:]]
        weight[own] = 1.0 / _of_difference(grid.count[:-1][own], grid.count[1:][own], grid.lapped)
    square = np.square(np.diff(values, axis=0)) * weight[:, None]
    own = np.empty((grid.n_poses, 6))
    number = np.bincount(pose[1:][pair], minlength=grid.n_poses)
    for c in range(6):
        own[:, c] = np.bincount(pose[1:][pair], square[pair, c], grid.n_poses)
    return own / np.maximum(number, 1)[:, None], number


def _shaken(grid: Grid, half: int) -> BoolArray:
    """Return the rests that are shaken more than others, (poses,), and long enough to show it."""
    rest = np.flatnonzero(grid.pose >= 0)
    moved = (grid.vibration[rest] != grid.vibration.min(axis=0)).any(axis=1)
    if not moved.any():
        return np.zeros(grid.n_poses, bool)
    short = grid.count[rest] <= half + 1
    number, moves, shorts = (
        np.bincount(grid.pose[rest], own, grid.n_poses) for own in (rest >= 0, moved, short)
    )
    return np.asarray((moves > 0) & (shorts == 0) & (number > FEWEST))


def _with_windows(
    grid: Grid, recording: Recording, poses: BoolArray, taper: FloatArray
) -> Grid:
    """Return a grid with means over windows that fade by a `taper` (2h + 1,) in some poses."""
    half = len(taper) // 2
    accel, gyro, count = grid.accel.copy(), grid.gyro.copy(), grid.count.copy()
    order = np.flatnonzero(grid.pose >= 0)
    for k in np.flatnonzero(poses).tolist():
        own = order[grid.pose[order] == k]
        first, stop = int(grid.begin[own[0]]), int(grid.begin[own[-1]] + grid.count[own[-1]])
        # The ends of a rest are where its first and its last window fade.
        edges = np.append(0, grid.begin[own[1:]] - first - half)
        count[own] = np.diff(edges, append=stop - first - 2 * half)
        for out, values in ((accel, recording.accel), (gyro, recording.gyro)):
            smooth = np.stack([np.convolve(v, taper, "valid") for v in values[first:stop].T], axis=1)
            out[own] = np.add.reduceat(smooth, edges, axis=0) / count[own, None]
    length = grid.length * count / grid.count
    made = Lapped(poses, np.convolve(taper, taper[::-1]), grid)
    return replace(grid, accel=accel, gyro=gyro, count=count, length=length, lapped=made)


def _of_difference(first: IntArray, second: IntArray, made: Lapped) -> FloatArray:
    """Return the variance of the difference of neighbours of so many samples, (k,), per sample's.

    Of sums over n samples that are smoothed it is ``sum of (n - |lag|) r(lag)``, r being how alike
    the noise of two of them is; and that of both as one is that of each, and twice their product.
    """
    lag = np.abs(np.arange(len(made.alike)) - len(made.alike) // 2)

    def of_sum(n: IntArray) -> FloatArray:
        return np.asarray(np.maximum(n[:, None] - lag, 0) @ made.alike)

    each = of_sum(first) / np.square(first) + of_sum(second) / np.square(second)
    both = of_sum(first + second) - of_sum(first) - of_sum(second)
    return np.asarray(each - both / (first * second))
