"""Means of rests that something shakes, over windows that fade into each other.

A mean over a time T keeps of a tone of amplitude A and frequency f as much as A / (pi f T), by
where in its swing it begins and ends. For a machine that shakes by several m/s² that is centimetres
per second squared: a hundred times what the sensor's own noise leaves, and more than the mean is
shifted by if the sensor rectifies what shakes it. In a window that fades in and out over a time L,
by the square of a sine, nothing is left of what is much faster than 2 / L [1]_.

So samples of such rests are averaged over a short such window before the points are. The points of
a rest then overlap, and add up to one window that is flat, but for its ends.

Nor does a window help where samples are taken unevenly: late by d, one is off by 2 pi f A d, and
that is white. But if their times say so, a cubic spline through them knows what was between.

References
----------
.. [1] Harris, "On the use of windows for harmonic analysis with the discrete Fourier transform",
   Proc. IEEE 66, 1978, p. 60: cos²(x), its zeros and how fast it falls off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.mismatch.rows.grid import REST_STEP, Grid, Lapped
from calib.mismatch.rows.underway import is_torn
from calib.recording import Recording
from calib.spline import spline_at
from calib.types import BoolArray, FloatArray, IntArray

FEWEST = 4
"""Differences of points that tell of the noise of a rest."""


def lapped(grid: Grid, recording: Recording) -> Grid:
    """Return a grid whose rests, where that makes their means quieter, have windows that fade.

    Only rests that are shaken are looked at. What a hand does is as slow as a window is long:
    means are no quieter there, and stay. Samples are taken at even times, or at those that are
    stated, by which of the two leaves less.
    """
    half = round(0.5 * REST_STEP / max(recording.interval, 1e-9))
    shaken = _shaken(grid, recording, half)
    if half < 1 or not shaken.any():
        return grid
    taper = np.hanning(2 * half + 3)[1:-1]
    taper /= taper.sum()
    as_they_are = _with_windows(grid, recording, shaken, taper, resampled=False)
    resampled = recording.clock != "invalid"
    if resampled:
        at_times = _with_windows(grid, recording, shaken, taper, resampled=True)
        resampled = _power(at_times)[shaken].sum() < _power(as_they_are)[shaken].sum()
    left = _power(at_times if resampled else as_they_are)
    quieter = shaken & (_power(grid) > surely_louder(point_noise(grid)[1]) * left)
    if not quieter.any():
        return grid
    return _with_windows(grid, recording, quieter, taper, resampled=resampled)


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


def surely_louder(number: IntArray) -> FloatArray:
    """Return by what factor a variance from so many differences, (k,), is another one.

    Beyond four standard errors of its estimate.
    """
    return np.asarray(1.0 + 4.0 * np.sqrt(2.0 / np.maximum(number, 1)))


def _power(grid: Grid) -> FloatArray:
    """Return the variance of a sample's force in each rest, as it counts in means, (poses,)."""
    return np.asarray(point_noise(grid)[0][:, :3].sum(axis=1))


def _shaken(grid: Grid, recording: Recording, half: int) -> BoolArray:
    """Return the rests that are shaken more than others, (poses,).

    And that are long enough to show it, with windows that are twice `half` a fading one, and whole.
    """
    rest = np.flatnonzero(grid.pose >= 0)
    pose = grid.pose[rest]
    moved = (grid.vibration[rest] != grid.vibration.min(axis=0)).any(axis=1)
    if not moved.any():
        return np.zeros(grid.n_poses, bool)
    out = np.bincount(pose, moved, grid.n_poses) > 0
    out &= np.bincount(pose, grid.count[rest] <= half + 1, grid.n_poses) == 0
    out &= np.bincount(pose, minlength=grid.n_poses) > FEWEST
    if recording.clock != "invalid":
        for k in np.flatnonzero(out).tolist():
            own = rest[pose == k]
            stop = int(grid.begin[own[-1]] + grid.count[own[-1]])
            out[k] = not is_torn(recording, int(grid.begin[own[0]]), stop)
    return np.asarray(out)


def _with_windows(
    grid: Grid, recording: Recording, poses: BoolArray, taper: FloatArray, *, resampled: bool
) -> Grid:
    """Return a grid with means over windows that fade by a `taper` (2h + 1,) in some poses.

    Of the samples, or of what they say of even times if they are `resampled`.
    """
    half = len(taper) // 2
    accel, gyro, count = grid.accel.copy(), grid.gyro.copy(), grid.count.copy()
    order = np.flatnonzero(grid.pose >= 0)
    for k in np.flatnonzero(poses).tolist():
        own = order[grid.pose[order] == k]
        rest = slice(grid.begin[own[0]], grid.begin[own[-1]] + grid.count[own[-1]])
        # The ends of a rest are where its first and its last window fade.
        edges = np.append(0, grid.begin[own[1:]] - rest.start - half)
        count[own] = np.diff(edges, append=rest.stop - rest.start - 2 * half)
        values = np.hstack((recording.accel[rest], recording.gyro[rest]))
        if resampled:
            time = recording.time[rest]
            values = spline_at(time, values, np.linspace(time[0], time[-1], len(time)))
        smooth = np.stack([np.convolve(v, taper, "valid") for v in values.T], axis=1)
        means = np.add.reduceat(smooth, edges, axis=0) / count[own, None]
        accel[own], gyro[own] = means[:, :3], means[:, 3:]
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
