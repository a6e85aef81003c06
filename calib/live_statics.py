"""Tell rest from motion while samples arrive, with the statistics of `calib.statics`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.recording import Recording, join
from calib.rests import DRIFT, LASTING, NORM
from calib.statics import Limits, find_limits, stillest_rate
from calib.stillness import (
    WIDTH,
    Blocks,
    Units,
    block_size,
    cut_blocks,
    find_units,
    join_blocks,
    moving_mean,
    slide,
    spill,
)
from calib.types import BoolArray, FloatArray

HISTORY = 6000
"""Blocks (ten minutes) from which it is learnt what rest looks like."""
REFRESH = 10
"""New blocks after which that is learnt anew."""
LONG = 8
"""Blocks over which a slow turn is seen: less than the second in which a change must be known."""


@dataclass(frozen=True)
class StaticEvent:
    """The sensor came to rest, or began to move.

    Parameters
    ----------
    resting : bool
    time : float, s
        When that began, as far as it is known.
    known : float, s
        Time of the sample with which it became known; ``known - time`` is the latency.
    """

    resting: bool
    time: float
    known: float


class LiveStatics:
    """Rest and motion from batches of samples of one device, as they come.

    What rest looks like is learnt on the way, from the stillest windows of the last ten minutes and
    from what a hand that holds still does. Memory is bounded, and time is in proportion to the
    samples. `find_poses` on the whole recording judges the ends of the poses better.

    Attributes
    ----------
    resting : bool
        The state after the last whole block (0.1 s) of samples.
    """

    def __init__(self) -> None:
        self.resting = False
        self._size = 0
        self._interval = 0.0
        self._rest: Recording | None = None  # samples that do not fill a block yet
        self._blocks: Blocks | None = None
        self._times = np.zeros(0)
        self._learnt: tuple[FloatArray, Units, Limits] | None = None
        self._unlearnt = 0

    def update(self, samples: Recording) -> list[StaticEvent]:
        """Return what began or ended with these samples.

        Parameters
        ----------
        samples : Recording
            The next samples of the same device; time goes on from the batch before.
        """
        if self._rest is not None:
            samples = join((self._rest, samples))
        if not self._size:
            if len(samples) < 8:
                self._rest = samples
                return []
            self._interval = samples.interval
            self._size = block_size(self._interval)
        whole = len(samples) // self._size * self._size
        self._rest = samples.slice(whole, len(samples)) if whole < len(samples) else None
        if not whole:
            return []
        fresh = cut_blocks(
            samples.time[:whole],
            samples.accel[:whole],
            samples.gyro[:whole],
            size=self._size,
            interval=self._interval,
        )
        return self._judge(fresh, samples.time[self._size - 1 : whole : self._size])

    def _judge(self, fresh: Blocks, ends: FloatArray) -> list[StaticEvent]:
        new = len(fresh)
        if self._blocks is not None:
            gap = ends[0] - self._times[-1] > (2.5 * self._size) * self._interval
            fresh.broken[0] |= gap
            fresh = join_blocks((self._blocks, fresh))
        times = np.concatenate((self._times, ends))
        self._blocks, self._times = _cut(fresh, -HISTORY), times[-HISTORY:]
        if len(fresh) < WIDTH:
            return []
        self._unlearnt += new
        if self._learnt is None or self._unlearnt >= REFRESH:
            bias = stillest_rate(fresh)
            units = find_units(fresh, bias)
            self._learnt = bias, units, find_limits(slide(fresh, bias), units)
            self._unlearnt = 0
        recent = _cut(fresh, -(new + 2 * LONG))
        still = self._still(recent)[-new:]
        before = np.concatenate(([self.resting], still[:-1]))
        events = []
        for k in np.flatnonzero(still != before).tolist():
            known = float(ends[k])
            blocks = WIDTH if still[k] else 1
            began = known - (blocks * self._size - 1) * self._interval
            events.append(StaticEvent(bool(still[k]), began, known))
        self.resting = bool(still[-1])
        return events

    def _still(self, blocks: Blocks) -> BoolArray:
        """Return whether the sensor was at rest at the end of each block."""
        assert self._learnt is not None
        bias, units, limits = self._learnt
        still = np.zeros(len(blocks), bool)
        if len(blocks) < WIDTH:
            return still
        windows = slide(blocks, bias)
        within = windows.whole & (windows.rate <= limits.rate) & (windows.force <= limits.force)
        still[WIDTH - 1 :] = within
        # A slow turn: the mean over a longer stretch is off by more than its own scatter explains.
        if len(blocks) > LONG:
            inside = np.zeros(len(blocks), bool)
            spill(inside, within, WIDTH)
            off = np.linalg.norm(moving_mean(blocks.gyro - bias, LONG), axis=1)
            step = np.square(np.diff(blocks.gyro, axis=0)).sum(axis=1)
            scatter = np.sqrt(moving_mean(step, LONG - 1) / 6)
            limit = max(NORM / np.sqrt(LONG), LASTING) * scatter + DRIFT / (units.rate or 1.0)
            still[LONG - 1 :] &= (off <= limit) | (moving_mean(1.0 * inside, LONG) < 1)
        return still


def _cut(blocks: Blocks, start: int) -> Blocks:
    return replace(
        blocks,
        accel=blocks.accel[start:],
        gyro=blocks.gyro[start:],
        accel_power=blocks.accel_power[start:],
        gyro_power=blocks.gyro_power[start:],
        broken=blocks.broken[start:],
    )
