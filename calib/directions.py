"""Where gravity points at either end of a turn, from the rests beside it.

A sensor that is laid down does not move, and the best direction of gravity at the end of its rest
is the mean over all of the rest. A hand that holds it sways by some tenths of a degree: there the
mean is not the direction at the end. The gyroscope sees the sway ``x(t)``, together with the
integral of its own noise; the accelerometer's direction ``y(t)`` sees it too, with other noise. The
best linear prediction of the sway by the gyroscope alone is ``gain x(t)``, with the gain
``var(sway) / var(x)``, between 0 and 1: that is the slope of y on x. So each rest has its gain, and
the turns beside it are integrated from its middle, with that share of the rate inside the rest.

The share also is what is left of the gyroscope's noise: of a random walk of intensity q that is
seen with noise n, ``q n / (q + n) = gain n`` is uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from calib.closure import TurnSteps, closure_residual, propagate
from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.rotation import integrate_rate, mat_from_quat
from calib.turns import Turns
from calib.types import FloatArray

BATCH = 0.5
"""s; the sensors are compared in means over this time: tremor is more acceleration than tilt."""
FEWEST = 4
"""Batches of a rest in which sway can be told."""
QUARTERS = 4
"""Parts of a rest from whose means the error of its own is judged: a hand that goes to and fro
pushes the sensor both ways, so longer parts agree better than noise of shorter ones says."""
SIGNIFICANCE = 0.01
"""Chance that a recording in which nothing sways is said to."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Direction of gravity at k poses, from the calibrated accelerometer.

    Parameters
    ----------
    up : (k, 3) array
        Unit vectors of specific force, in frame s.
    covariance : (k, 3, 3) array, rad²
        Of ``up``; its part along ``up`` has no meaning.
    """

    up: FloatArray
    covariance: FloatArray


def pose_directions(poses: Poses, accel: Triad) -> Directions:
    """Return the mean direction of gravity over each pose, with its covariance."""
    force = accel.correct(poses.accel)
    norm = np.linalg.norm(force, axis=1, keepdims=True)
    inverse = np.linalg.inv(accel.matrix)
    covariance = inverse @ poses.accel_covariance @ inverse.T
    return Directions(force / norm, covariance / norm[..., None] ** 2)


@dataclass(frozen=True, eq=False)
class Sway:
    """How a sensor moved in k poses.

    Parameters
    ----------
    gain : (k,) array
        Share of the gyroscope's rate within each pose that is motion.
    noise : float, rad²/s
        How fast the variance of the integrated rate grows by noise, beside the motion.
    """

    gain: FloatArray
    noise: float = 0.0


def find_sway(recording: Recording, poses: Poses, accel: Triad, gyro: Triad) -> Sway:
    """Return in which poses the sensor swayed, and by which share of its rate.

    With x the integrated rate and y what the accelerometer saw, ``x.(x - y)`` is the energy of the
    gyroscope's noise in x, whether the pose swayed or not. From all poses together that gives the
    noise, and ``gain = 1 - noise / x.x``. The gain is 0 unless both sensors agree that the
    direction moved: the slope of y on x is above 1/2, and positive at a false discovery rate of
    `SIGNIFICANCE` [1]_, or above 1/2 where x has no less power than in such a pose.

    References
    ----------
    .. [1] Benjamini, Hochberg, "Controlling the false discovery rate", J. Royal Stat. Soc. B 57(1),
       1995: where nothing sways, it is the chance that anything is said to.
    """
    k = len(poses)
    energy, common, count, doubt = np.zeros(k), np.zeros(k), np.zeros(k), np.ones(k)
    for i, (start, stop) in enumerate(zip(poses.start, poses.stop, strict=True)):
        paths = _paths(recording, int(start), int(stop), accel, gyro)
        y, x = (batch_means(path, recording.interval) for path in paths)
        if len(x) < FEWEST or not x.any():
            continue
        energy[i], common[i], count[i] = (x * x).sum(), (x * y).sum(), len(x)
        slope = common[i] / energy[i]
        freedom = 2 * (len(x) - 1) - 1
        error = np.sqrt(((y - slope * x) ** 2).sum() / freedom / energy[i])
        doubt[i] = stdtr(freedom, -slope / max(float(error), 1e-300))
    # Where the noise is more than half of x, the mean is nearer than what x makes of it: a bias
    # that drifts looks like a sensor that turns slowly, and some of it may fit by chance.
    doubt[common <= 0.5 * energy] = 1.0
    order = np.argsort(doubt)
    passed = np.flatnonzero(doubt[order] <= SIGNIFICANCE * np.arange(1, k + 1) / k)
    # A random walk of n rad²/s has a variance of n T / 6 about its mean over T: here with two
    # components, and T = count * BATCH.
    walk = count**2 * BATCH / 3
    noise = max(0.0, float((energy - common).sum() / max(float(walk.sum()), 1e-300)))
    gain = np.zeros(k)
    if passed.size:
        sure = order[: passed[-1] + 1]
        # One that turns as much as such a pose, and whose gravity follows, sways as well.
        power = energy / np.maximum(walk, 1e-300)
        sways = (power >= power[sure].min()) & (common > 0.5 * energy)
        gain[sways] = np.maximum(0.0, 1 - noise * walk[sways] / energy[sways])
    return Sway(gain, noise)


def batch_means(values: FloatArray, interval: float) -> FloatArray:
    """Return means over `BATCH` of (n, 3) values, less the mean of them all."""
    width = max(1, round(BATCH / interval)) if interval else 1
    count = len(values) // width
    means: FloatArray = values[: count * width].reshape(count, width, 3).mean(axis=1)
    return means - means.mean(axis=0) if count else means


def _paths(
    recording: Recording, start: int, stop: int, accel: Triad, gyro: Triad
) -> tuple[FloatArray, FloatArray]:
    """Return how gravity's direction moved in a pose, (n, 3) rad each: as seen, and as turned."""
    force = accel.correct(recording.accel[start:stop])
    mean = force.mean(axis=0)
    up = mean / np.linalg.norm(mean)
    rate = gyro.correct(recording.gyro[start:stop])
    angle = np.zeros_like(rate)
    step = np.diff(recording.time[start:stop])[:, None]
    np.cumsum(0.5 * step * (rate[1:] + rate[:-1]), axis=0, out=angle[1:])
    seen = force / np.linalg.norm(mean)
    return seen - np.outer(seen @ up, up), np.cross(up, angle)


def follow(
    recording: Recording, poses: Poses, turns: Turns, accel: Triad, gyro: Triad, gain: FloatArray
) -> tuple[TurnSteps, Directions]:
    """Return the steps of turns between the middles of poses, and the directions there.

    Within pose k the rate counts by ``gain[k]``: with 0 that is the turn between the ends of the
    poses, and the mean direction over each. Readings of a pose are turned to its middle by the same
    share of the rate; an error of the bias cancels there, to first order.
    """
    directions = pose_directions(poses, accel)
    middle = (poses.start + poses.stop) // 2
    moved = np.flatnonzero(gain > 0)
    up, covariance = directions.up.copy(), directions.covariance.copy()
    share = np.ones(len(recording) - 1)
    for k in moved:
        start, stop = int(poses.start[k]), int(poses.stop[k])
        share[start : stop - 1] = gain[k]
        rate = gain[k] * gyro.correct(recording.gyro[start:stop])
        quat = integrate_rate(recording.time[start:stop], rate)
        mats = mat_from_quat(quat)
        # From frame at each sample to that at the middle.
        seen = np.einsum("nij,nj->ni", mats, accel.correct(recording.accel[start:stop]))
        seen = seen @ mats[middle[k] - start]
        mean = seen.mean(axis=0)
        norm = np.linalg.norm(mean)
        up[k] = mean / norm
        width = (stop - start) // QUARTERS
        if width:
            parts = seen[: width * QUARTERS].reshape(QUARTERS, width, 3).mean(axis=1) / norm
            parts = parts - parts.mean(axis=0)
            parts = parts - np.outer(parts @ up[k], up[k])
            # Of one component across: there are few parts, so both share one variance.
            variance = float((parts**2).sum()) / (2 * (QUARTERS - 1)) / QUARTERS
            covariance[k] = variance * np.eye(3)
    begins, ends = turns.start.copy(), turns.stop.copy()
    before, after = np.isin(turns.before, moved), np.isin(turns.after, moved)
    begins[before] = middle[turns.before[before]]
    ends[after] = middle[turns.after[after]] + 1
    interval = np.stack([recording.time[begins], recording.time[ends - 1]], axis=1)
    extended = Turns(turns.before, turns.after, begins, ends, interval)
    return TurnSteps.of(recording, extended, gain=share), Directions(up, covariance)


def closure_errors(
    recording: Recording,
    poses: Poses,
    turns: Turns,
    accel: Triad,
    gyro: Triad,
    *,
    gain: FloatArray | None = None,
) -> FloatArray:
    """Return the closure error of each turn as rotation vectors (m, 3), rad, at its start.

    It is what is left between gravity's direction before a turn and that predicted from its
    direction after the turn and the corrected rate; perpendicular to gravity, so 2 degrees of
    freedom. Sway in the poses is followed by `gain`, that of `find_sway` if None.
    """
    if not len(turns):
        return np.zeros((0, 3))
    if gain is None:
        gain = find_sway(recording, poses, accel, gyro).gain
    steps, directions = follow(recording, poses, turns, accel, gyro, gain)
    up = directions.up
    motion = propagate(steps, gyro.matrix, gyro.bias)
    predicted = np.einsum("mij,mj->mi", motion.mat, up[turns.after])
    return closure_residual(up[turns.before], predicted)
