"""Find the static poses of a recording, or of a live stream, without a threshold from the user.

What a rest looks like is learnt from the recording: the levels of its stillest windows. A window is
a candidate if rate and change of specific force are below a multiple of those, or of what a hand
that holds still or a machine that shakes does, and below what no rest has. What of the candidates
is a rest, and where it ends, is found by `calib.rests`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.poses import Poses, average_poses, resolution
from calib.recording import Recording, join
from calib.rests import refine
from calib.stillness import (
    FACTOR,
    MOST_FORCE,
    MOST_RATE,
    MOST_SHAKEN,
    SHAKEN,
    TREMOR_FORCE,
    TREMOR_RATE,
    WIDTH,
    Blocks,
    Units,
    Windows,
    block_size,
    cut_blocks,
    find_units,
    join_blocks,
    moving_mean,
    slide,
    spill,
)
from calib.types import BoolArray, FloatArray, IntArray

SCALES: tuple[int, ...] = (1, 5, 10, 20)
"""Lengths over which a run is compared with rest, in blocks."""

SPIN = 0.1
"""Share of the fastest rate of a recording by which the rates of rests do not differ."""


def find_poses(recording: Recording, *, minimum_duration: float = 1.0) -> Poses:
    """Return the static poses of a recording; none if it only moves.

    Any unit, range, rate and noise level; linear in the number of samples.

    Parameters
    ----------
    recording : Recording
    minimum_duration : float, s
        The shortest rest that counts as a pose.
    """
    finder = RestFinder(recording)
    finder.add(recording)
    return average_poses(recording, *finder.find(minimum_duration=minimum_duration))


class RestFinder:
    """Finds the rests of a recording that comes in parts; `find_poses` explains how.

    What it keeps is a mean of every 0.1 s.

    Parameters
    ----------
    first : Recording
        Its first part, whole if it is short: it tells clock, interval and resolution.
    """

    def __init__(self, first: Recording) -> None:
        self.interval = first.interval
        self.scales = SCALES
        self._ordered = first.clock == "invalid"
        if self._ordered:
            # Durations mean nothing: blocks of ten samples, and nothing that takes long.
            self.interval, self.scales = 0.01, SCALES[:1]
        self._steps = resolution(first)
        self._size = block_size(self.interval) if self.interval > 0 else 0
        self._parts: list[Blocks] = []
        self._rest: Recording | None = None
        self._before: float | None = None
        self._count = 0
        self._blocks: Blocks | None = None

    def add(self, part: Recording) -> None:
        """Take in the next part of the recording."""
        if not self._size:
            return
        whole = part if self._rest is None else join((self._rest, part))
        time: FloatArray = whole.time
        if self._ordered:
            time = 0.01 * np.arange(self._count, self._count + len(whole), dtype=np.float64)
        used = len(whole) // self._size * self._size
        self._parts.append(
            cut_blocks(
                time,
                whole.accel,
                whole.gyro,
                size=self._size,
                interval=self.interval,
                before=self._before,
            )
        )
        self._rest = whole.slice(used, len(whole)) if used < len(whole) else None
        if used:
            self._before = float(time[used - 1])
        self._count += used

    def find(self, *, minimum_duration: float = 1.0) -> tuple[IntArray, IntArray]:
        """Return the samples ``[start, stop)`` of the rests of all parts together."""
        none = np.zeros(0, np.int64)
        if not self._parts:
            return none, none
        blocks = self._blocks = join_blocks(self._parts)
        self._parts = [blocks]
        if len(blocks) < WIDTH:
            return none, none
        bias = stillest_rate(blocks)
        units = find_units(blocks, bias)
        windows = slide(blocks, bias)
        candidates = covered(windows, find_limits(windows, units), len(blocks)) & ~blocks.broken
        least = max(3, round(minimum_duration / blocks.duration) - 2)
        found = refine(blocks, candidates, least, self._steps, units, self.scales)
        segments = np.array(found, np.int64).reshape(-1, 2) * blocks.size
        return segments[:, 0], segments[:, 1]

    def accel(self, start: IntArray, stop: IntArray) -> FloatArray:
        """Return the mean specific force over rests that were found, (k, 3)."""
        assert self._blocks is not None
        spans = zip(start // self._size, stop // self._size, strict=True)
        return np.array([self._blocks.accel[a:b].mean(axis=0) for a, b in spans]).reshape(-1, 3)


def stillest_rate(blocks: Blocks) -> FloatArray:
    """Return the median rate of the tenth of the windows in which the sensor was stillest, (3,).

    Of those the slowest, where they fall apart: on a table that spins at one speed about the
    vertical nothing changes either.
    """
    levels = slide(blocks, np.zeros(3))
    mean = moving_mean(blocks.gyro, WIDTH)
    scatter = np.sqrt(np.maximum(levels.rate**2 - np.square(mean).sum(axis=1), 0.0))
    rank = np.maximum(
        scatter / max(float(np.median(scatter)), 1e-300),
        levels.force / max(float(np.median(levels.force)), 1e-300),
    )
    still = mean[rank <= np.quantile(rank, 0.1)]
    speed = np.linalg.norm(still, axis=1)
    order = np.argsort(speed)
    apart = np.diff(speed[order])
    least = SPIN * float(np.linalg.norm(mean, axis=1).max())
    if (apart > least).any():
        unit = find_units(blocks, still[order[0]]).rate
        far = apart > max(least, TREMOR_RATE / unit if unit else 0.0)
        still = still[order[: int(np.argmax(far)) + 1]] if far.any() else still
    return np.asarray(np.median(still, axis=0), np.float64)


@dataclass(frozen=True)
class Limits:
    """Levels of a window up to which it may be a rest, in the recording's units.

    ``shaken`` is the limit of the force where it is no more than fast shaking explains.
    """

    rate: float
    force: float
    shaken: float


def find_limits(windows: Windows, units: Units) -> Limits:
    """Return the limits from the levels of the stillest windows and from physical sizes."""
    use = windows.whole
    rate, force = windows.rate[use], windows.force[use]
    if not use.any():
        return Limits(0.0, 0.0, 0.0)
    level_rate, level_force = np.quantile(rate, 0.01), np.quantile(force, 0.01)
    for multiple in (3.5, 2.5, 2.5):
        still = (rate <= multiple * level_rate) & (force <= multiple * level_force)
        if not still.any():
            break
        level_rate, level_force = np.median(rate[still]), np.median(force[still])
    limit_rate, limit_force = FACTOR * float(level_rate), FACTOR * float(level_force)
    if units.rate is not None:
        limit_rate = min(max(limit_rate, TREMOR_RATE / units.rate), MOST_RATE / units.rate)
    limit_force = min(max(limit_force, TREMOR_FORCE * units.gravity), MOST_FORCE * units.gravity)
    return Limits(limit_rate, limit_force, MOST_SHAKEN * units.gravity)


def covered(windows: Windows, limits: Limits, n: int) -> BoolArray:
    """Return a mask of the blocks that lie in any window within the limits."""
    shaken = np.minimum(SHAKEN * windows.shake, limits.shaken)
    force = windows.force <= np.maximum(limits.force, shaken)
    still = windows.whole & (windows.rate <= limits.rate) & force
    mask = np.zeros(n, bool)
    spill(mask, still, WIDTH)
    return mask
