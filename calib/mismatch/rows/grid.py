"""The grid on which a diagnosis works: rests thinned to short means, turns sample by sample.

Every row of the diagnosis is a linear functional of the signals over one rest or one turn, so a
rest needs only a few means (`REST_STEP` apart), while a turn needs each sample. The grid's length
is therefore that of the turns, not that of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from calib.effects.base import SLOPE_WINDOW, line_slope, windows
from calib.mismatch.rows.closure import Spans
from calib.mismatch.rows.density import quiet_density
from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.rests import misfits, unmoved
from calib.thermometer import smooth_temperature
from calib.turns import turns_and_shaking
from calib.types import BoolArray, FloatArray, IntArray

REST_STEP = 0.25
"""Length of the means that a rest is thinned to, s."""

MARGIN = 3
"""Samples at either end of a rest that are given to the turn beside it, so that the turn is
integrated from rest to rest."""

LONGEST_TURN = 30.0
"""Motion that lasts longer than this between two rests is not closed, s: the errors of a hand
shaking a sensor for minutes say nothing of its calibration."""

SHORTEST_CELL, LONGEST_CELL = 2.0, 120.0
"""Of a rest that is cut, s: over minutes a bias walks, and where all rests last half an hour no two
of their means would tell how far."""

LOUD = 9.0
"""Noise power, relative to the median, above which a pose is louder than others."""

TOUCH = 2.0
"""s at either end of a rest in which a hand may be at the sensor; a third of a short rest."""

EVENLY = 0.25
"""Share of its mean power that what shakes a pose throughout has in any quarter of a second."""

FEW = 0.15
"""Share of louder poses up to which they are left out; where more are, that is how it was."""

BRIEF = 3.0
"""s of a rest that may be a moment of a turn. In so short a time no bias warms up."""

REDDER = 3.0
"""Variance of means over an eighth of a rest, times that of white noise, from which it sways: by
chance 0.4 % are beyond."""

CELLS = 150
"""At most so many cells (parts of a rest, each with a mean and two contrasts)."""

ROWS = 1000
"""Rows with a dense covariance, up to which rests are cut: six a cell, five a turn. The cost grows
with their cube."""

UNCLOCKED = 600.0
"""s that a recording of unknown length is taken to last where a rate of temperature is wanted: the
windows that it is fitted through are made for recordings of ten minutes."""


class Held(NamedTuple):
    """In which ``poses`` (k,) a hand holds the sensor, whose gyroscope tells how it sways.

    Variances along an axis of its ``velocity``, (m/s)², and ``acceleration``, (m/s²)², (k,).
    """

    poses: BoolArray
    velocity: FloatArray
    acceleration: FloatArray

    def of(self, poses: IntArray) -> Held:
        """Return the same of some poses."""
        return Held(self.poses[poses], self.velocity[poses], self.acceleration[poses])

    def of_means(self, lasts: FloatArray) -> FloatArray:
        """Return the variance of a mean acceleration over times (k,): how velocity has changed."""
        changed = 2.0 * self.velocity / np.square(np.maximum(lasts, 1e-9))
        return np.asarray(np.minimum(changed, self.acceleration))


class Lapped(NamedTuple):
    """In which ``poses`` (k,) points are means over windows that fade into each other.

    ``alike`` (2m + 1,) is the covariance of white noise in two smoothed samples, m of them apart
    or less, per variance of one; ``plain`` the grid in which no window fades.
    """

    poses: BoolArray
    alike: FloatArray
    plain: Grid


@dataclass(frozen=True, eq=False)
class Grid:
    """Points (means over ``[edge, edge + count)`` samples), and the segments that they belong to.

    Parameters
    ----------
    time, temperature : (n,) arrays
        Of the points; ``temperature`` is None where it was not measured.
    accel, gyro : (n, 3) arrays
        Measured means.
    begin, count : (n,) arrays of int
        First sample of each point, and how many there are.
    scatter : (n, 6) array
        Variance of the samples of each, about their mean; 0 for one sample.
    length : (n,) array, s
        Time over which it is their mean; 0 for one sample.
    vibration : (n, 3) array, (m/s²)²
        Short-time variance of the specific force; that of quiet rests where nothing shakes.
    since_turn, turning : (n,) arrays
        Time since motion last ended, s, and whether there is some.
    near : (n,) array of int
        The pose whose noise and vibration a point shares: its own at rest; in a turn the one that
        has not been left yet, or is reached already; -1 while the sensor moves.
    first, last : (s,) arrays of int
        Points ``[first, last)`` of each segment, in the order of time.
    interval : (s, 2) array, s
    temperature_slope : (n,) array, K/s, or None
        Rate of temperature. Where no seconds are known, as if all had taken `UNCLOCKED`, and by a
        line through a thirtieth of that: neither is known how long heat takes through a package.
    began : float, s
        When the recording did, be its first pose used or not: warm-up is counted from there.
    density : (6,) array, optional
        One-sided power density of the noise, where in the spectrum hands do little.
    held : Held, optional
        How a hand holds the sensor at rest.
    lapped : Lapped, optional
        Where points at rest are means over windows that fade.
    before, after : (s,) arrays of int
        Pose at either end of a segment: the same for a cell of a rest, neighbours for a turn.
    """

    time: FloatArray
    accel: FloatArray
    gyro: FloatArray
    temperature: FloatArray | None
    begin: IntArray
    count: IntArray
    scatter: FloatArray
    length: FloatArray
    vibration: FloatArray
    since_turn: FloatArray
    turning: BoolArray
    near: IntArray
    first: IntArray
    last: IntArray
    interval: FloatArray
    before: IntArray
    after: IntArray
    n_poses: int
    began: float
    temperature_slope: FloatArray | None = None
    density: FloatArray | None = None
    held: Held | None = None
    lapped: Lapped | None = None

    @property
    def is_rest(self) -> BoolArray:
        """Whether each segment is a cell of a rest, (s,) bool."""
        rest: BoolArray = self.before == self.after
        return rest

    @property
    def segment(self) -> IntArray:
        """The segment of each point, (n,)."""
        return np.repeat(np.arange(len(self.first)), self.last - self.first)

    @property
    def pose(self) -> IntArray:
        """The pose of each point, (n,); -1 in turns."""
        return np.where(self.is_rest, self.before, -1)[self.segment]

    @cached_property
    def turns(self) -> tuple[IntArray, Spans]:
        """The points of all turns, one after the other, and when the turns were."""
        points, first = self.points_of(np.flatnonzero(~self.is_rest))
        return points, Spans(self.time[points], first)

    def points_of(self, segments: IntArray) -> tuple[IntArray, IntArray]:
        """Return the points of k segments, one after the other, and where each begins, (k + 1,)."""
        number = self.last[segments] - self.first[segments]
        first = np.append(0, np.cumsum(number))
        return np.arange(first[-1]) + np.repeat(self.first[segments] - first[:-1], number), first


def make_grid(
    recording: Recording,
    poses: Poses,
    *,
    turns: IntArray | None = None,
    shortest_cell: float | None = None,
    began: float | None = None,
) -> Grid:
    """Cut a recording into cells of rests and turns between them.

    Parameters
    ----------
    recording : Recording
    poses : Poses
        In the order of time.
    turns : (k - 1, 2) array of int
        Samples in which the turns between k poses are under way, if not in all between rests: the
        others are given to the rests.
    shortest_cell : float, s
        Shortest part that a long rest is cut into.
    began : float, s
        When the recording did, if its first samples were left out.
    """
    step = max(recording.interval, 1e-9)
    width = max(1, round(REST_STEP / step))
    if turns is not None:
        poses = _up_to(turns, recording, poses)
    cells = _cell_counts(poses, SHORTEST_CELL if shortest_cell is None else shortest_cell)
    starts: list[IntArray] = []
    segments: list[tuple[int, int, int, int]] = []
    n_points = 0

    def add(edges: IntArray, stop: int, before: int, after: int) -> None:
        nonlocal n_points
        starts.append(np.stack((edges, np.append(edges[1:], stop)), axis=1))
        segments.append((n_points, n_points + len(edges), before, after))
        n_points += len(edges)

    for k in range(len(poses)):
        start, stop = int(poses.start[k]), int(poses.stop[k])
        # A rest keeps at least six points, so that it has a mean and two contrasts.
        trim = min(MARGIN, max(0, (stop - start - 6) // 2))
        inner = np.linspace(start + trim, stop - trim, int(cells[k]) + 1).astype(np.int64)
        for a, b in pairwise(inner):
            n = max(1, min(b - a, max(6, (b - a) // width)))
            edges = np.unique(np.linspace(a, b, n + 1).astype(np.int64)[:-1])
            add(edges, int(b), k, k)
        if k + 1 < len(poses):
            following = min(MARGIN, max(0, int(poses.stop[k + 1] - poses.start[k + 1] - 6) // 2))
            a, b = stop - trim, int(poses.start[k + 1]) + following
            if b - a >= 2 and (b - a) * step <= LONGEST_TURN:
                add(np.arange(a, b, dtype=np.int64), b, k, k + 1)
    bounds = np.concatenate(starts)
    table = np.array(segments, np.int64)
    began = float(recording.time[0]) if began is None else began
    return _fill(recording, poses, bounds, table, began)


def _up_to(turns: IntArray, recording: Recording, poses: Poses) -> Poses:
    """Return k poses that begin and end where the turns between them, (k - 1, 2), do."""
    start, stop = np.append(poses.start[:1], turns[:, 1]), np.append(turns[:, 0], poses.stop[-1:])
    if np.array_equal(start, poses.start) and np.array_equal(stop, poses.stop):
        return poses
    return average_poses(recording, start, stop)


def untouched(recording: Recording, poses: Poses) -> Poses:
    """Return the poses without the moments at either end in which a hand was at the sensor.

    A hand that takes the sensor up, or stops the recording, shakes it before it turns it. That is
    a true rate, short, and never about one axis alone; what one axis alone has is left in.
    """
    width = max(5, round(REST_STEP / max(recording.interval, 1e-9)))
    start, stop = poses.start.copy(), poses.stop.copy()
    for k in range(len(poses)):
        a, b = int(start[k]), int(stop[k])
        edges = np.arange(a, b - width + 1, width)
        if len(edges) < 8:
            continue
        square = np.square(recording.gyro[a:b] - np.median(recording.gyro[a:b], axis=0))
        each = np.add.reduceat(square, edges - a, axis=0)
        shaken = (each > LOUD * np.median(each, axis=0)).sum(axis=1) > 1
        near = round(TOUCH / (width * recording.interval))
        near = min(near, len(edges) // 3)
        first, last = np.flatnonzero(shaken[:near]), np.flatnonzero(shaken[len(edges) - near :])
        if len(first):
            start[k] = edges[first[-1]] + width
        if len(last):
            stop[k] = edges[len(edges) - near + last[0]]
    if np.array_equal(start, poses.start) and np.array_equal(stop, poses.stop):
        return poses
    return average_poses(recording, start, stop)


def steady(recording: Recording, poses: Poses) -> Poses:
    """Return the poses without those in which the sensor was not at rest.

    A pose that was held by hand turns on average: its mean rate stands out. One that is several
    times noisier than most, where few are, was touched or knocked; but not what shakes without
    turning, from one end to the other. Where all were held, one whose mean rate stands out by no
    more than it sways by was a moment of a turn.
    """
    length = poses.stop - poses.start

    def louder(covariance: FloatArray) -> BoolArray:
        power = np.einsum("kii->k", covariance) * length
        return np.asarray(power > LOUD * np.median(power))

    gyro = louder(poses.gyro_covariance)
    off = np.linalg.norm(poses.gyro - np.median(poses.gyro, axis=0), axis=1)
    out = off > 6 * np.median(off)
    # But for a bias that steps: nothing turns where gravity stays.
    stepped = np.array([o and _stays(recording, poses, k) for k, o in enumerate(out.tolist())])
    out, gyro = out & ~stepped, gyro & ~stepped
    held = gyro & out
    for k in np.flatnonzero(out & ~held).tolist():
        if np.ptp(poses.interval[k]) < BRIEF:
            held[k] = off[k] < 3.0 * _sway(recording.gyro[poses.start[k] : poses.stop[k]])
    loud = gyro | louder(poses.accel_covariance)
    shaken = [i for i in np.flatnonzero(loud & ~gyro).tolist() if _throughout(recording, poses, i)]
    loud[shaken] = False
    return poses.select(~(held | loud if loud.mean() <= FEW else held))


def _throughout(recording: Recording, poses: Poses, k: int) -> bool:
    """Whether what shakes a pose does so from one end of it to the other."""
    accel = recording.accel[poses.start[k] : poses.stop[k]]
    width = max(5, round(REST_STEP / max(recording.interval, 1e-9)))
    number = len(accel) // width
    if number < 2:
        return False
    power = accel[: number * width].reshape(number, width, 3).var(axis=1).sum(axis=1)
    return bool(power.min() > EVENLY * power.mean())


def _stays(recording: Recording, poses: Poses, k: int) -> bool:
    """Whether gravity stays in a pose in which it would turn at the mean rate."""
    own = slice(int(poses.start[k]), int(poses.stop[k]))
    accel = recording.accel[own]
    noise = float(np.sqrt(np.mean(np.square(np.diff(accel, axis=0))) / 2.0))
    rate = poses.gyro[k] - np.median(poses.gyro, axis=0)
    if not noise > 0:
        return False
    return unmoved(misfits(accel, rate, recording.interval, noise))


def _sway(rate: FloatArray) -> float:
    """Return by how much (n, 3) samples of a rate change more slowly than from one to the next.

    In means of an eighth of them; 0 for noise, for what a machine shakes, and for one axis alone.
    """
    width = len(rate) // 8
    if width < 2:
        return 0.0
    slow = rate[: 8 * width].reshape(8, width, 3).mean(axis=1).var(axis=0, ddof=1)
    fast = rate.var(axis=0, ddof=1) / width
    moves = slow > REDDER * fast
    return float(np.sqrt((slow - fast)[moves].sum())) if moves.sum() > 1 else 0.0


def one_rest(poses: Poses) -> Poses:
    """Return all poses as one, from the first to the last."""
    whole = poses.select(np.array([0]))
    interval = np.array([[poses.interval[0, 0], poses.interval[-1, 1]]])
    return replace(whole, start=poses.start[:1], stop=poses.stop[-1:], interval=interval)


def connected(poses: Poses) -> Poses:
    """Return the poses without lone ones: cut off from all others by motion that is not closed.

    What happens to a bias while a sensor is shaken for minutes is no part of a calibration. Where
    most poses are cut off, all are kept.
    """
    gap = poses.interval[1:, 0] - poses.interval[:-1, 1]
    closed = np.concatenate(([False], gap <= LONGEST_TURN, [False]))
    near = closed[:-1] | closed[1:]
    return poses.select(near) if near.mean() >= 0.75 and not near.all() else poses


def _cell_counts(poses: Poses, shortest: float) -> IntArray:
    """Split long rests so that their drift shows, into no more cells than `CELLS` and `ROWS` allow.

    Where there are few rests they are all there is, and are cut finer.
    """
    length = poses.interval[:, 1] - poses.interval[:, 0]
    few = max(1.0, 30.0 / len(poses))
    usual = min(float(np.median(length)) * 1.5 / few, LONGEST_CELL)
    typical = max(shortest, usual, float(length.sum()) / CELLS)
    samples = (poses.stop - poses.start) // 30
    most = max(min(CELLS, (ROWS - 5 * (len(poses) - 1)) // 6), len(poses))
    while True:
        cells = np.minimum(np.floor(length / max(typical, 1e-12)).astype(np.int64), samples)
        if np.maximum(cells, 1).sum() <= most:
            break
        typical = max(1.1 * typical, 1e-9)
    return np.asarray(np.maximum(cells, 1))


def _fill(
    recording: Recording, poses: Poses, bounds: IntArray, table: IntArray, began: float
) -> Grid:
    count = bounds[:, 1] - bounds[:, 0]

    def mean(values: FloatArray) -> FloatArray:
        # reduceat over interleaved [start, stop) pairs; the odd ones are the gaps between.
        flat = bounds.ravel()
        if flat[-1] == len(values):
            flat = flat[:-1]
        sums: FloatArray = np.add.reduceat(values, flat, axis=0)[::2]
        shape = (-1, *([1] * (values.ndim - 1)))
        return sums / count.reshape(shape)

    first, last, before, after = table.T
    accel = mean(recording.accel)
    time = mean(recording.time)
    length = recording.time[bounds[:, 1] - 1] - recording.time[bounds[:, 0]]
    length = length * count / np.maximum(count - 1, 1)
    temperature, slope = None, None
    if recording.temperature is not None:
        when = recording.time
        if recording.clock == "invalid":
            when = np.linspace(0.0, UNCLOCKED, len(recording))
        known = smooth_temperature(when, recording.temperature)
        temperature, slope = mean(known(when)), mean(known.rate_at(when))
        if recording.clock == "invalid":
            slope = mean(line_slope(when, known(when), *windows(when, SLOPE_WINDOW)))
    rest = np.repeat(before == after, last - first)
    interval = np.stack(
        (recording.time[bounds[first, 0]], recording.time[bounds[last - 1, 1] - 1]), axis=1
    )
    moving, vibration, _ = turns_and_shaking(recording, poses)
    ended = np.append(-np.inf, moving[:, 1])
    since = time - ended[np.searchsorted(ended, time, side="right") - 1]
    # Poses begin late and end early, to be sure: the rest of a rest is at the ends of its turns.
    begun = np.searchsorted(moving[:, 0], time, side="right")
    near = np.where(begun == np.searchsorted(ended[1:], time, side="left"), begun, -1)
    near = np.where(rest, np.repeat(before, last - first), near)
    gyro = mean(recording.gyro)
    scatter = np.hstack(
        (
            mean(np.square(recording.accel)) - np.square(accel),
            mean(np.square(recording.gyro)) - np.square(gyro),
        )
    )
    return Grid(
        time=time,
        accel=accel,
        gyro=gyro,
        temperature=temperature,
        begin=bounds[:, 0],
        count=count,
        scatter=np.maximum(scatter, 0.0) * (count / np.maximum(count - 1, 1))[:, None],
        length=length,
        vibration=mean(vibration),
        since_turn=since,
        turning=near < 0,
        near=near,
        first=first,
        last=last,
        interval=interval,
        before=before,
        after=after,
        n_poses=len(poses),
        began=began,
        temperature_slope=slope,
        density=quiet_density(recording, poses),
    )


def fast_power(accel: FloatArray) -> FloatArray:
    """Return the variance of what is faster than motion in (n, 3) samples, (3,).

    The median of squared second differences: the variance of white noise is theirs over six, and
    their median 0.4549 of their mean. What shakes only the ends of a turn is none of its own.
    """
    return np.asarray(np.median(np.square(np.diff(accel, n=2, axis=0)), axis=0) / (6.0 * 0.4549))
