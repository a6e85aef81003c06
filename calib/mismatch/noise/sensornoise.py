"""Noise of a sensor: white, from samples at rest; and how a bias drifts, as covariances.

How much it drifts is a level that `noise` estimates; how much to expect is said here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import linalg, sparse

from calib.effects.vibration import quiet_level
from calib.mismatch.rows.grid import Grid, fast_power
from calib.mismatch.rows.lapped import FEWEST, point_noise, surely_louder
from calib.mismatch.rows.lean import Lean
from calib.mismatch.rows.rows import Component
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

DRIFT = {"accel": 0.15, "gyro": 0.5}
"""How far a bias wanders in `DRIFT_TIME`, per noise density: the ratio of bias instability to noise
density in data sheets and Allan plots (MPU-6050: 50 µg to 400 µg/√Hz, 10 °/h to 18 °/h/√Hz). In
minutes at rest a few slow modes are all that shows of drift, and effects go with them; so the prior
on drift is part of the physics. Jitter, flicker and walk of the axes of one triad share their
scale, so that what is seen from pose to pose says what to expect over minutes."""

RISES = 400.0
"""s after which a bias is expected to have walked further than it flickers, where an Allan plot
begins to rise: from 100 s to half an hour, in parts of this kind."""

SPREAD = 1.4
"""Standard deviation of the logarithm of a level (a variance) of drift, or of what sampling adds: a
factor of 2 in size."""

DRIFT_TIME = 600.0
"""s."""

FLOOR = 2 * np.log(2) / np.pi
"""Allan variance of 1/f noise, per square of its bias instability (IEEE Std 952, annex C)."""

LEAN = "lean"

LEANING = (np.deg2rad(0.001)) ** 2
"""Variance of the angle by which a sensor at rest is expected to lean in a second, rad²."""

LEAN_SPREAD = 3.0
"""Standard deviation of its logarithm: a factor of 4.5 in size. A table does not lean by a
thousandth of a degree in minutes; a hand does by a tenth in seconds."""

LEAN_TOLD = 1.0
"""The same where gravity has told how a sensor sways."""

CAUTION = 6.0
"""Differences that count as those of white noise, besides what is seen of rests that are shaken."""


def sample_noise(grid: Grid) -> FloatArray:
    """Return the variance of each point's mean on each channel, (n, 6), white part.

    Drift has no part in it. A rest that is clearly noisier than the others (vibration, a hand) has
    its own level, from successive differences of its points (quarter seconds), so that noise that
    is correlated over a few samples counts in full. Means over windows that fade have that of what
    these leave; samples in the turns beside them do not.
    """
    plain = grid if grid.lapped is None else grid.lapped.plain
    own, number = point_noise(plain)
    usable = number >= FEWEST
    # A level that is surely louder is that of one rest by itself.
    limit = surely_louder(number)
    known = usable if usable.any() else np.ones_like(usable)
    common = np.array([quiet_level(own[known, c], limit[known]) for c in range(6)])
    largest = np.abs(np.hstack((plain.accel, plain.gyro))).max(axis=0)
    least = 1e-12 * np.square(largest) + 1e-18
    loud = usable[:, None] & (own > limit[:, None] * np.maximum(common, least))
    quiet = known[:, None] & ~loud
    floor = np.maximum(_quiet_noise(plain, own, number, quiet), least)
    level = _levels(plain, own, number, floor, loud)
    each = _of_points(grid, level, floor)
    if grid.lapped is not None:
        own, number = point_noise(grid)
        left = _levels(grid, own, number, floor, grid.lapped.poses[:, None] & (own > 0))
        faded = (grid.pose >= 0) & grid.lapped.poses[grid.pose]
        each[faded] = np.maximum(left, floor)[grid.pose[faded]]
    return np.asarray(each / grid.count[:, None])


def _of_points(grid: Grid, level: FloatArray, floor: FloatArray) -> FloatArray:
    """Return the variance of a sample at each point, (n, 6), by its `level` (k, 6) in rests.

    In a turn it is `floor` (6,), and what goes on of what shakes the rests beside it.
    """
    each = np.where((grid.near >= 0)[:, None], level[np.maximum(grid.near, 0)], floor)
    for s in np.flatnonzero(~grid.is_rest).tolist():
        loudest = np.maximum(level[grid.before[s]], level[grid.after[s]])
        if (loudest > floor).any():
            own = np.arange(grid.first[s], grid.last[s])
            own = own[grid.near[own] < 0]
            each[own] = floor + _still_shaken(grid, s, own, floor) * (loudest - floor)
    return np.asarray(each)


def _levels(
    grid: Grid, own: FloatArray, number: IntArray, floor: FloatArray, loud: BoolArray
) -> FloatArray:
    """Return the variance of a sample in each rest, (k, 6): its own where it is `loud` (k, 6).

    ``own`` (k, 6) is that of so many differences, `number` (k,), and `floor` (6,) that of others.
    """
    ratio = np.where(loud, own / floor, 1.0)
    error = np.broadcast_to(3.0 / np.maximum(number, 1)[:, None], ratio.shape)
    for triad in (np.arange(6) < 3, np.arange(6) >= 3):
        mine = loud & triad
        ratio[mine] = shrunk(ratio[mine], error[mine])
    level = floor * np.where(loud, ratio, 1.0)
    left = _averaged(grid, np.hstack((grid.accel, grid.gyro)), level, floor, loud)
    return np.asarray(np.where(loud, floor + left * (level - floor), level))


def _quiet_noise(grid: Grid, own: FloatArray, number: IntArray, quiet: BoolArray) -> FloatArray:
    """Return the variance that a sample has on each channel, as it counts in means, (6,).

    From all samples of quiet rests, which tell it far more closely than differences of points,
    times how much larger it is by these: not at all, if it is white. Logarithms of the ratio have
    errors of variance ``3 / n`` for n differences. Three of a triad that are as large as by chance
    are none, and others are drawn to that by what chance has in them [1]_.

    Parameters
    ----------
    grid : Grid
    own : (k, 6) array
        From differences of the points of each of k rests; `number` (k,) of them.
    quiet : (k, 6) array of bool
        The rests that are taken.

    References
    ----------
    .. [1] Efron, Morris, "Stein's estimation rule and its competitors", JASA 68, 1973, p. 117.
    """
    weight = quiet * number[:, None]
    coarse = (weight * own).sum(axis=0) / np.maximum(weight.sum(axis=0), 1)
    rest = grid.pose >= 0
    freedom = (grid.count[rest] - 1)[:, None] * quiet[grid.pose[rest]]
    fine = (freedom * grid.scatter[rest]).sum(axis=0) / np.maximum(freedom.sum(axis=0), 1)
    out = np.where((freedom.sum(axis=0) > 0) & (fine > 0), fine, coarse)
    both = (out > 0) & (coarse > 0)
    error = 3.0 / np.maximum(weight.sum(axis=0), 1)
    logs = np.zeros(6)
    np.log(np.divide(coarse, out, out=np.ones(6), where=both), out=logs)
    logs[both] += 0.5 * error[both]
    for triad in (slice(0, 3), slice(3, 6)):
        chance = np.square(logs[triad]).sum() / error[triad].mean()
        logs[triad] *= max(0.0, 1.0 - 3.0 / max(chance, 1e-300))
    return np.asarray(out * np.exp(logs))


def _still_shaken(grid: Grid, turn: int, moving: IntArray, floor: FloatArray) -> float:
    """Return how much of what shakes a rest beside a turn goes on while it moves, as power.

    What is as fast there as in the louder rest: a hand may have taken the sensor off the bench.
    """
    beside = grid.vibration[[grid.first[turn] - 1, grid.last[turn]]].sum(axis=1).max()
    beside -= grid.vibration.min(axis=0).sum()
    if len(moving) < 3 or not beside > 0:
        return 0.0
    seen = fast_power(grid.accel[moving]).sum() - floor[:3].sum()
    return float(np.clip(seen / beside, 0.0, 1.0))


def _averaged(
    grid: Grid, values: FloatArray, level: FloatArray, floor: FloatArray, loud: BoolArray
) -> FloatArray:
    """Return how much of what shakes rests is left in means over parts of them, (6,).

    A machine shakes at frequencies of its own, and over seconds that averages out faster than
    white noise does. Thirds of the rests show by how much: what they differ by, of `level` (k, 6)
    above `floor` (6,) in those that are `loud` (k, 6). The axes of a triad have it in common.
    """
    out = np.ones(6)
    places = [np.flatnonzero(grid.pose == k) for k in range(grid.n_poses)]
    square, white = np.zeros((grid.n_poses, 6)), np.zeros(grid.n_poses)
    for k, own in enumerate(places):
        if len(own) < 6:
            continue
        thirds = np.array_split(own, 3)
        weight = np.array([grid.count[part].sum() for part in thirds])
        early, _, late = (
            np.average(values[part], axis=0, weights=grid.count[part]) for part in thirds
        )
        square[k], white[k] = np.square(late - early), 1 / weight[0] + 1 / weight[2]
    for triad in (slice(0, 3), slice(3, 6)):
        mine = loud[:, triad] & (white > 0)[:, None]
        share = (floor / level)[:, triad][mine]
        seen = (square[:, triad] / np.maximum(white, 1e-300)[:, None] / level[:, triad])[mine]
        # With one standard error; the square of a normal variable's square is three on average.
        total = seen.sum() + np.sqrt(np.square(seen).sum() * 2 / 3)
        left = (total - share.sum() + CAUTION) / ((1.0 - share).sum() + CAUTION)
        out[triad] = np.clip(left, 0.0, 1.0)
    return out


def shrunk(level: FloatArray, error: FloatArray) -> FloatArray:
    """Return variances from few differences each, drawn to what they have in common.

    Where each is weighted by its own, those that are too small by chance would count most. The
    logarithm of a variance from n successive differences has a variance of about 3/n, `error`; what
    levels differ by beyond that is how much each is its own.
    """
    if not len(level):
        return level
    logs = np.log(level) + 0.5 * error
    between = max(float(np.var(logs) - error.mean()), 0.0) if len(level) > 1 else np.inf
    own = 1.0 if np.isinf(between) else between / (between + error)
    # The mean of a variance whose logarithm is uncertain.
    return np.asarray(np.exp(logs.mean() + own * (logs - logs.mean()) + 0.5 * own * error))


def flicker_covariance(time: FloatArray, length: FloatArray) -> FloatArray:
    """Return the covariance of means of 1/f noise with a bias instability of one.

    A sum of Gauss-Markov processes, correlation times a factor of 3 apart from shorter than any
    segment to longer than the recording, each of variance ``ln(3) / pi``: one-sided density
    ``1 / (pi f)``. Means over segments of lengths a and b, a gap apart, of one of correlation time
    T and unit variance have the covariance

        f(a / T) f(b / T) exp(-gap / T),    f(r) = (1 - exp(-r)) / r,

    and each the variance ``2 (r - 1 + exp(-r)) / r²``, r being its own length over T.

    Parameters
    ----------
    time, length : (n,) arrays, s
        Middles and lengths of segments that do not overlap.
    """
    apart = np.abs(np.subtract.outer(time, time))
    size = np.maximum(length, 1e-9)
    gap = np.maximum(apart - 0.5 * np.add.outer(size, size), 0.0)
    span = max(float(apart.max()), 1e-9)
    out = np.zeros_like(gap)
    for correlation in 3 * span * 3.0 ** -np.arange(12.0):
        ratio = size / correlation
        end = -np.expm1(-ratio) / ratio
        part = np.outer(end, end) * np.exp(-gap / correlation)
        np.fill_diagonal(part, 2 * (1 - end) / ratio)
        out += part
    return np.asarray(out * np.log(3.0) / np.pi)


class DriftKernels(NamedTuple):
    """Covariances (k, k) of what a bias does in the segments of a recording, for levels of one.

    That is its mean in each, and in some by how much it is higher in their second halves than that.
    A mean alone may have an error of its own, a jitter.
    """

    jitter: FloatArray
    flicker: FloatArray
    walk: FloatArray

    @classmethod
    def of(cls, interval: FloatArray, halved: IntArray | None = None) -> DriftKernels:
        """Return those of the means in segments (s, 2), and of the halves of those ``halved``.

        By the Allan variance, which 1/f noise has over any time alike, half the difference of two
        halves has half of it.
        """
        length, middle = np.ptp(interval, axis=1), interval.mean(axis=1)
        walk = np.minimum.outer(middle - middle[0], middle - middle[0]) / DRIFT_TIME
        flicker = flicker_covariance(middle, length)
        if halved is None:
            return cls(np.eye(len(length)), flicker, walk)
        means, halves = np.ones(len(length)), np.ones(len(halved))
        return cls(
            np.diag(np.append(means, 0.0 * halves)),
            linalg.block_diag(flicker, np.diag(0.5 * FLOOR * halves)),
            linalg.block_diag(walk, np.diag(length[halved] / (12.0 * DRIFT_TIME))),
        )

    def beside(self, number: int) -> DriftKernels:
        """Return the same beside a `number` of things that do not drift."""
        none = np.zeros((number, number))
        return DriftKernels(*(linalg.block_diag(kernel, none) for kernel in self))


def drift_components(
    channel: str, pieces: sparse.csr_matrix, kernels: DriftKernels, drift: float, spread: float
) -> list[Component]:
    """Return the drift of one channel's bias: jitter, flicker and random walk.

    Parameters
    ----------
    channel : str
    pieces : sparse (n_dense, k) matrix
        Response to what `kernels` are the covariances of, on that channel.
    kernels : DriftKernels
    drift : float
        Expected level.
    spread : float
    """
    index = np.flatnonzero(np.diff(pieces.indptr))
    response = pieces[index]
    triad = channel.split(".")[0]
    return [
        Component(f"{channel} {label}", index, response, kernel, share * drift, spread, triad)
        for label, kernel, share in (
            ("jitter", kernels.jitter, 0.1),
            ("flicker", kernels.flicker, 1.0),
            # The Allan variance of a walk is a third of its own after as long.
            ("walk", kernels.walk, 3 * FLOOR * DRIFT_TIME / RISES),
        )
    ]


def lean_components(
    lean: Lean, rows: IntArray, rest: IntArray, pieces: Sequence[sparse.csr_matrix]
) -> list[Component]:
    """Return the unknown variances of means at rest as the sensor leans.

    Accelerometers have theirs in common. Of a turn about the vertical they see nothing, so that
    each axis of a gyroscope has its own.

    Parameters
    ----------
    lean : Lean
        In n cells.
    rows : (n, 6) array of int
        Their means among the dense rows.
    rest : (n,) array of int
        Their segments.
    pieces : six sparse (n_dense, s) matrices
        Response to a constant on each channel in each segment. Of a sensor that is held, the last n
        columns are that of closures to how it turns in each cell on average.
    """
    n = len(rows)
    kernel = lean.of_force()
    each = sparse.identity(3 * n, format="csr")
    prior = _expected(lean)
    out = [
        Component(f"accel {LEAN}", rows[:, :3].T.ravel(), each, kernel.reshape(3 * n, -1), *prior)
    ]
    for c in range(3, 6):
        index = np.flatnonzero(np.diff(pieces[c].indptr))
        own = np.zeros((pieces[c].shape[1],) * 2)
        # What closures feel of the same turns, of a sensor that is held, comes last.
        places = (rest, np.arange(len(own) - n, len(own))) if lean.held.any() else (rest,)
        for a, b in product(places, places):
            own[np.ix_(a, b)] = lean.covariance(c)
        out.append(Component(f"{CHANNELS[c]} {LEAN}", index, pieces[c][index], own, *prior))
    return out


def lean_of_turns(
    lean: Lean, rows: IntArray, poses: IntArray, parts: tuple[FloatArray, FloatArray]
) -> Component:
    """Return the unknown variance of closures as turns begin and end where a rest has leaned to.

    Parameters
    ----------
    lean : Lean
    rows : (k, 5) array of int
        The closures of k turns among the dense rows.
    poses : (2, k) array of int
        Before and after each.
    parts : two (k, 5, 2) arrays
        What the angles before, and those after, do to the closures.
    """
    variance, turns = lean.at_ends(), np.arange(len(rows))
    kernel = np.zeros((len(rows), 5, len(rows), 5))
    for pose, part in zip(poses, parts, strict=True):
        kernel[turns, :, turns] += variance[pose, None, None] * (part @ np.swapaxes(part, 1, 2))
    each = sparse.identity(rows.size, format="csr")
    matrix = kernel.reshape(rows.size, -1)
    return Component(f"turn {LEAN}", rows.ravel(), each, matrix, *_expected(lean))


def _expected(lean: Lean) -> tuple[float, float, str]:
    """Return what is expected of the level of a lean, how far it may be from that, and a group."""
    expected = lean.sway.expected
    return (expected, LEAN_TOLD, LEAN) if expected else (LEANING, LEAN_SPREAD, LEAN)
