"""How a sensor leans in the rests of one recording: some far more than others, or as they begin.

What is put down on foam, or pulled by its cable, creeps for seconds, by hundredths of a degree or
by tenths, and one rest in three may last no longer than that. How much rests lean is learnt from
all of them: the few that do then look like a gyroscope that fluctuates, and what all of them begin
with like one that remembers each turn. But gravity moves as the rate says, which it does for no
bias.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from calib.mismatch.rows.grid import Grid
from calib.mismatch.rows.lean import STEADY, TIMES, WALK, Sway
from calib.mismatch.rows.sway import SURE, follow, follows, how_it_sways
from calib.stillness import moving_median
from calib.types import BoolArray, FloatArray, IntArray

PARTS = 3
"""Of a rest, in which rates are compared with each other."""

BESIDE = 7
"""Rests whose median rate is taken for that of a sensor that does not turn there."""

FAR = 2.0
"""How much larger a variance is than that of most from which on it may be none of these: of nine
squares of normal errors one in 25 is."""

FEWEST = 3
"""Rests in which gravity does, from which on those lean as well that are too brief to tell, or
whose accelerometer is too noisy; unless these tell so together."""

EARLY, LOUDER, TELLING = 1.5, 2.0, 6
"""s that a rest begins with, times as large as later the square of the rate is there if it creeps,
and rests that must tell."""

TOLD = 3.0
"""Standard errors by which gravity has moved in all rests as the rate says, where these sway."""

MEDIAN = 0.4549
"""Of the square of a normal error."""


class Leans(NamedTuple):
    """How poses lean unlike each other.

    ``size`` (poses,) is the variance of the angle in each beside that in most. ``creep`` (s) is
    that of the angle by which they creep as they begin, beside that per second later. ``sway`` is
    how all of them do, where gravity tells.
    """

    size: FloatArray | None = None
    creep: float = 0.0
    sway: Sway = WALK
    held: BoolArray | None = None


class _Pose(NamedTuple):
    """How much a pose leans, rad²/s, and by how many standard errors gravity moved, and should.

    And how long it lasts, s.
    """

    lean: float
    length: float
    seen: float
    wanted: float

    @property
    def follows(self) -> bool:
        """Whether gravity moved as the rate says."""
        return follows(self.seen, self.wanted)

    @property
    def seems(self) -> bool:
        """Whether it likely did, where others certainly did."""
        return follows(self.seen, self.wanted, sure=TOLD)

    @property
    def open(self) -> bool:
        """Whether gravity would not show what the rate says."""
        return self.wanted < SURE


def how_it_leans(grid: Grid, noise: FloatArray, *, least: float) -> Leans:
    """Return how poses lean unlike each other, as far as gravity and rate agree on it.

    Parameters
    ----------
    grid : Grid
    noise : (n, 6) array
        Variance of each point's mean on each channel.
    least : float, rad²/s
        What a sensor at rest leans anyway.
    """
    size = np.ones(grid.n_poses)
    order = np.flatnonzero(grid.pose >= 0)
    order = order[np.argsort(grid.pose[order], kind="stable")]
    bounds = np.searchsorted(grid.pose[order], np.arange(grid.n_poses + 1))
    points = [order[a:b] for a, b in pairwise(bounds.tolist())]
    some = [k for k, own in enumerate(points) if len(own) >= PARTS]
    if len(some) < 2:
        return Leans()
    mean = np.stack([grid.gyro[points[k]].mean(axis=0) for k in some])
    still = moving_median(mean, BESIDE)
    poses = [_look(grid, noise, points[k], zero) for k, zero in zip(some, still, strict=True)]
    usual = max(float(np.median([p.lean for p in poses])), least)
    leans = sum(p.follows for p in poses) >= FEWEST or _together(p for p in poses if p.open)
    creep, per_second = _creep(grid, noise, points, least=least)
    sway = WALK
    if _together(poses, sure=TOLD):
        after = EARLY if creep else 0.0
        sway = how_it_sways(grid, [points[k] for k in some], still, after=after)
    expected = sway.expected or least
    swing = sway.back if np.isfinite(sway.back) else 0.0
    for k, p in zip(some, poses, strict=True):
        # Most may have no more of it than noise. What creeps, most do.
        beside = usual if creep else expected
        if p.lean > FAR * usual and (p.follows or (leans and (p.open or p.seems))):
            size[k] = max(p.lean / beside, 1.0)
        elif sway.expected and not creep:
            # Parts of less than a swing differ by as much less, however much it sways.
            brief = max(PARTS * swing / p.length, 1.0)
            size[k] = min(np.square(FAR * brief) * p.lean / beside, 1.0)
    held = np.zeros(grid.n_poses, bool)
    if sway.expected:
        creep = creep * per_second / expected
        for k, p in zip(some, poses, strict=True):
            held[k] = p.lean <= FAR**2 * expected * size[k]
    return Leans(size, creep, sway, held)


def _creep(
    grid: Grid, noise: FloatArray, points: list[IntArray], *, least: float
) -> tuple[float, float]:
    """Return `Leans.creep`, and the variance of the angle per second that it is beside.

    It is by how much rates are larger as poses begin, where gravity tells so.
    """
    poses, lasts, early, late = [], [], [], []
    for own in points:
        time, rate = grid.time[own], grid.gyro[own]
        length = float(np.ptp(time)) if len(own) else 0.0
        since = time - time[:1]
        parts = (
            since < EARLY,
            (since >= length / 2) & (since < 0.75 * length),
            since >= 0.75 * length,
        )
        if length < 2 * EARLY or not all(part.any() for part in parts):
            continue
        first, third, last = (rate[part].mean(axis=0) for part in parts)
        still = 0.5 * (third + last)
        poses.append(_look(grid, noise, own, still))
        lasts.append(length)
        early.append(np.square(first - still))
        late.append(np.square(third - last) * length / 8.0)
    if len(poses) < TELLING:
        return 0.0, least
    span, squares = np.array(lasts), np.array(early)
    per_second = float(np.median(late)) / MEDIAN
    usual = per_second * (1.0 / EARLY + 2.0 / span)[:, None]
    if (squares <= LOUDER * MEDIAN * usual).mean() >= 0.5 or not _together(poses):
        return 0.0, least
    times = np.array(TIMES)[:, None]
    begins = -np.expm1(-EARLY / times) / EARLY
    ends = np.exp(-0.5 * span / times) * -np.expm1(-0.5 * span / times) / (0.5 * span)
    unit = np.square(begins - ends).mean(axis=0)[:, None]
    angle = float(np.median((squares - usual) / unit)) / MEDIAN
    later = max(per_second - _white(grid, noise), least)
    return max(angle, 0.0) / later, later


def _white(grid: Grid, noise: FloatArray) -> float:
    """Return the variance of the rate's white noise in a mean over a second, (rad/s)²."""
    rest = grid.pose >= 0
    step = float(np.median(np.diff(grid.time[rest])))
    return float(np.median(noise[rest, 3:])) * step


def _together(poses: Iterable[_Pose], *, sure: float = SURE) -> bool:
    """Return whether gravity moved in some poses as the rate says, taken together."""
    some = list(poses)
    size = float(np.sqrt(sum(p.wanted**2 for p in some)))
    seen = sum(p.seen * p.wanted for p in some) / max(size, 1e-9)
    return follows(seen, size, sure=sure)


def _look(grid: Grid, noise: FloatArray, points: IntArray, still: FloatArray) -> _Pose:
    """Return what some points of one pose say, whose rate would be ``still`` if nothing turned."""
    time, force, rate = grid.time[points], grid.accel[points], grid.gyro[points]
    length = float(np.ptp(time)) * len(points) / (len(points) - 1)
    mean = rate.mean(axis=0)
    parts = np.stack([part.mean(axis=0) for part in np.array_split(rate, PARTS)])
    # Rates of a walk with a steady turn for q of one: of parts beside each other, and of them all.
    apart = float(np.square(parts - mean).sum()) * length / PARTS
    off = float(np.square(mean - still).sum()) / (1.0 / length + 1.0 / STEADY)
    lean = (apart + off) / (3 * PARTS)
    sigma = np.sqrt(noise[points, :3])
    # Where the rate of a sensor at rest is hardly known, a steady turn is not either.
    said = [
        _Pose(lean, length, *follow(time, force, rate - still, sigma, order=order))
        for order in (0, 1)
    ]
    return next((p for p in said if p.follows), said[1])
