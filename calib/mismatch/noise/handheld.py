"""Noise of a sensor that a hand holds: without what the hand does, as far as both sensors see that.

A hand sways by many times what a gyroscope errs by, and the gyroscope is right in that: of the rate
its own noise is all there is, as much as where in the spectrum hands do little. How far the sensor
turned on average in a rest, and gravity with it, is a lean's (`lean`).

An accelerometer sees the hand's acceleration as well. Its mean over a time T is what velocity has
changed by over that, so that of means

    var = a / T + min(2 s / T², c)

with a of white noise ((m/s²)²/Hz), s the variance of the velocity and c that of the acceleration:
in each pose as much more as it sways by more. They are learnt along gravity, where no lean shows,
from means over a quarter of a second to two, about that of their rest. Velocities that are closer
than that are alike, so that the largest s counts.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib.mismatch.rows.grid import Grid, Held
from calib.mismatch.rows.rows import UNKNOWN, Component
from calib.types import BoolArray, FloatArray, IntArray

LAGS = (1, 2, 4, 8)
"""Points of the grid (quarter seconds) that means are over."""

FEWEST = 6
"""Times that a mean fits into the rests, at least."""

BRIEF = 2.0
"""s of a rest up to which it is no longer than a hand takes to sway: its mean then differs from
others by as much as its parts do."""

MORE = 0.3
"""Times the variance that is learnt within rests, that is expected besides."""

WHOLE = 2.0
"""Times the variance of an acceleration about the mean of its rest, that it has as a whole."""


def held_by_hand(grid: Grid, poses: BoolArray, size: FloatArray) -> Held:
    """Return how a hand holds a sensor that sways by a `size` (poses,) in each pose, a variance."""
    velocity, acceleration = _motion(grid, size)
    return Held(poses, velocity * size, acceleration * size)


def noise_of_held(grid: Grid, noise: FloatArray) -> FloatArray:
    """Return the variance of each point's mean on each channel, (n, 6), white part.

    Parameters
    ----------
    grid : Grid
        Of a sensor that is ``held``.
    noise : (n, 6) array
        What `sensornoise.sample_noise` says. It is the least of forces in brief rests, and of all
        in poses that are not held and in turns beside them.
    """
    assert grid.density is not None
    assert grid.held is not None
    still = np.flatnonzero(grid.pose >= 0)
    step = float(np.median(grid.length[still] / grid.count[still]))
    out = np.asarray(grid.density / (2.0 * step * grid.count[:, None]))
    pose, cell = grid.pose[still], (np.cumsum(grid.is_rest) - 1)[grid.segment[still]]
    lasts = np.asarray(np.bincount(cell, grid.length[still]), np.float64)
    moved = grid.held.of(grid.before[grid.is_rest]).of_means(lasts)
    out[still, :3] += (moved * lasts)[cell, None] / grid.length[still, None]
    brief = still[np.bincount(pose, grid.length[still], grid.n_poses)[pose] < BRIEF]
    out[brief, :3] = np.maximum(out[brief, :3], noise[brief, :3])
    beside = ~(grid.held.poses[grid.before] & grid.held.poses[grid.after])
    others = beside[grid.segment]
    out[others] = np.maximum(out[others], noise[others])
    return out


def moved_by_hand(grid: Grid, rows: IntArray) -> Component:
    """Return what means of forces may err by besides, (cells, 3) rows: as they differ by.

    In a rest of a second nobody sees what it differs from others by.
    """
    held, lasts = grid.held, np.ptp(grid.interval[grid.is_rest], axis=1)
    assert held is not None
    size = np.repeat(held.of(grid.before[grid.is_rest]).of_means(lasts), 3)
    return Component.alone("accel in a hand", rows.ravel(), size, expected=MORE, spread=UNKNOWN)


def _motion(grid: Grid, size: FloatArray) -> tuple[float, float]:
    """Return the variances of velocity and acceleration along gravity in poses of the size one."""
    assert grid.density is not None
    order = np.flatnonzero(grid.pose >= 0)
    ends = np.searchsorted(grid.pose[order], np.arange(grid.n_poses + 1))
    square, wanted, number = np.zeros((3, len(LAGS)))
    for k, (a, b) in enumerate(pairwise(ends.tolist())):
        force, length = grid.accel[order[a:b]], grid.length[order[a:b]]
        up = force.mean(axis=0) if b > a else np.zeros(3)
        along = force @ up / max(float(np.linalg.norm(up)), 1e-300)
        total = np.append(0.0, np.cumsum(along - along.mean() if b > a else along))
        for i, lag in enumerate(LAGS):
            if b - a < 2 * lag:
                continue
            own = np.square((total[lag:] - total[:-lag]) / lag)
            white = 1.0 / (lag * length.mean()) - 1.0 / length.sum()
            white *= 0.5 * grid.density[:3].mean()
            # Means over half of a rest are closer to its mean than those of a longer one.
            share = 1.0 - (lag / (b - a)) ** 2
            # The louder, the more a pose tells of it.
            square[i] += size[k] * share * (own - white).sum()
            wanted[i] += np.square(size[k] * share) * len(own)
            number[i] += len(own) / lag
    told = (number >= FEWEST) & (wanted > 0)
    level = np.maximum(square[told] / wanted[told], 0.0)
    time = np.array(LAGS)[told] * float(np.median(grid.length[order]))
    velocity = 0.5 * level * np.square(time)
    return float(velocity.max(initial=0.0)), WHOLE * float(level[:1].max(initial=0.0))
