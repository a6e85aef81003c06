"""When samples were taken: the device's own clock unwrapped, or arrival times made steady."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np

from calib.errors import UnitError
from calib.recording import Clock
from calib.types import FloatArray, IntArray
from drivers.dialects.base import Samples

WARM_UP = 1.0
"""s of stamps that are gathered before the first time is given out."""
GAP = 0.25
"""s that samples must stay late, with no backlog that catches up, to be called a gap."""
PATIENCE = 3
"""Batches that must stay late before a gap is believed."""
MEMORY = 60.0
"""s of arrivals that the line is fitted to: longer than scheduling noise, shorter than drift."""
COARSE = 0.05
"""A device clock that repeats itself more often than this is too coarse to stamp single samples."""


class SteadyClock:
    """A line through arrival times: ``time = origin + interval * index``.

    A sample never arrives before it was taken, so the line lies below all arrivals and as close to
    them as it can: of the edges of their lower convex hull it is the one over the mean index, which
    minimises the sum of delays.

    References
    ----------
    .. [1] S. Moon, P. Skelly, D. Towsley, "Estimation and Removal of Clock Skew from Network Delay
       Measurements", INFOCOM 1999, section IV (the linear programme that this solves).
    """

    def __init__(self) -> None:
        self.origin = 0.0
        self.interval = 0.0
        """s between samples; 0 until enough has arrived to tell."""
        self._points: list[tuple[float, float]] = []  # (index, arrival): the least late of each 1 s
        self._given: tuple[float, float] | None = None  # last index, and the time it was given

    def delay(self, index: int, arrival: float) -> float:
        """Return how much later than on the line sample `index` arrived, s."""
        return arrival - (self.origin + self.interval * index)

    def remember(self, index: int, arrival: float) -> None:
        """Take that sample `index` was the last to have arrived at `arrival` s."""
        points, point = self._points, (float(index), arrival)
        if self.interval and len(points) > 1 and arrival - points[-2][1] < 1.0:
            if (
                self.delay(index, arrival)
                <= points[-1][1] - self.origin - self.interval * points[-1][0]
            ):
                points[-1] = point
        else:
            points.append(point)
        while arrival - points[0][1] > MEMORY:
            points.pop(0)
        if arrival - points[0][1] >= WARM_UP:
            self._fit()

    def settle(self, interval: float) -> None:
        """Fit with what there is, as nothing more will come; `interval` is the last resort."""
        if not self.interval:
            self._fit()
        if not self.interval and self._points:
            self.interval = interval
            self.origin = self._points[0][1] - interval * self._points[0][0]

    def times(self, index: IntArray) -> FloatArray:
        """Return the times of rising indices, s: continuous with those given before, and rising."""
        end = float(index[-1])
        target = self.origin + self.interval * end
        if self._given is None:
            times = np.asarray(self.origin + self.interval * index, np.float64)
        else:
            begin, start = self._given
            # Follow the line, but never slower than half or faster than twice the interval.
            span = self.interval * (end - begin)
            step = min(max(target - start, 0.5 * span), 2.0 * span)
            times = np.asarray(start + step * (index - begin) / (end - begin), np.float64)
        self._given = (end, float(times[-1]))
        return times

    def _fit(self) -> None:
        hull: list[tuple[float, float]] = []
        for point in self._points:
            while len(hull) > 1 and _turn(hull[-2], hull[-1], point) <= 0:
                hull.pop()
            hull.append(point)
        middle = sum(i for i, _ in self._points) / len(self._points) if self._points else 0.0
        for (i0, t0), (i1, t1) in itertools.pairwise(hull):
            if i1 >= middle and i1 > i0 and t1 > t0:
                self.interval = (t1 - t0) / (i1 - i0)
                self.origin = t0 - self.interval * i0
                return


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


class Timeline:
    """Gives the samples of one stream their times, from 0, and counts what the times show lost.

    The clock is the device's where the samples carry ticks, else the host's arrivals made steady,
    else, where nobody noted arrivals, the nominal `rate`.

    Parameters
    ----------
    period : float, s, or None
        When the device's clock wraps around.
    rate : float, Hz, or None
    counters : Counter
        Gets ``clock_restarts`` and ``repeated_samples``.
    """

    def __init__(
        self,
        *,
        period: float | None,
        rate: float | None,
        counters: Counter[str],
    ) -> None:
        self.clock: Clock = "nominal"
        self.interval = 1.0 / rate if rate else 0.0
        self._period = period
        self._rate = rate
        self._counters = counters
        self._steady = SteadyClock()
        self._coarse: bool | None = None
        self._held: list[Samples] = []  # not yet looked at
        self._steadied: list[Samples] = []  # waiting for the steady clock
        self._first_arrival: float | None = None
        self._arrival: float | None = None
        self._taken: float | None = None  # the arrival up to which the device's clock was followed
        self._index = 0  # of the next sample, lost ones included
        self._late = 0
        self._last: tuple[float, float] | None = None  # tick and time of the last sample
        self._origin: float | None = None

    def add(self, samples: Samples, arrival: float | None) -> None:
        """Take the next samples, whose last one arrived at `arrival` s."""
        if not len(samples):
            return
        if self._first_arrival is None:
            self._first_arrival = arrival
        if samples.ticks is not None:
            self.clock = "device"
        elif arrival is not None:
            self.clock = "host"
        elif not self._rate:
            raise UnitError(
                "these bytes carry no time and nobody noted when they arrived: state the rate in "
                "the address, as in &rate=200"
            )
        self._arrival = arrival
        if self.clock == "host":
            assert arrival is not None
            self._make_steady(samples, arrival)
        else:
            self._held.append(samples)

    def take(self, *, final: bool = False) -> tuple[FloatArray, Samples] | None:
        """Return the samples that are ready and their times; with `final` all that are left."""
        if self._held:
            placed = self._take_device(final=final) if self.clock == "device" else self._count()
            if placed is not None:
                return placed
        return self._take_steady(final=final) if self._steadied else None

    def _count(self) -> tuple[FloatArray, Samples]:
        samples, self._held = Samples.join(self._held), []
        index = self._index + np.cumsum(samples.lost + 1)
        self._index = int(index[-1])
        return np.asarray((index - 1) * self.interval, np.float64), samples

    def _make_steady(self, samples: Samples, stamp: float) -> None:
        self._steadied.append(samples)
        self._index += len(samples) + int(samples.lost.sum())
        self._observe(stamp)

    def _observe(self, stamp: float) -> None:
        """Tell the steady clock of the last sample; find gaps that no backlog makes good."""
        steady = self._steady
        if steady.interval:
            delay = steady.delay(self._index - 1, stamp)
            if delay > max(GAP, 5 * steady.interval):
                self._late += 1
                if self._late < PATIENCE:
                    return
                missing = round(delay / steady.interval)
                first = self._steadied[0]
                lost = first.lost.copy()
                lost[0] += missing
                self._steadied[0] = replace(first, lost=lost)
                self._index += missing
        self._late = 0
        steady.remember(self._index - 1, stamp)

    def _take_steady(self, *, final: bool) -> tuple[FloatArray, Samples] | None:
        steady = self._steady
        if final:
            spread = (self._arrival or 0.0) - (self._first_arrival or 0.0)
            steady.settle(self.interval or max(spread, 1e-3) / self._index)
        elif self._late or not steady.interval:
            return None
        samples, self._steadied = Samples.join(self._steadied), []
        index = np.cumsum(samples.lost + 1)
        index += self._index - 1 - index[-1]
        self.interval = steady.interval
        times = steady.times(index)
        if self._origin is None:
            self._origin = float(times[0])
        return times - self._origin, samples

    def _take_device(self, *, final: bool) -> tuple[FloatArray, Samples] | None:
        if self._coarse is None:
            elapsed = (self._arrival or 0.0) - (self._first_arrival or 0.0)
            if sum(map(len, self._held)) < 20 and elapsed < WARM_UP and not final:
                return None
        samples, self._held = Samples.join(self._held), []
        assert samples.ticks is not None
        before, start = self._last or (float(samples.ticks[0]), 0.0)
        steps = np.diff(samples.ticks, prepend=before)
        if self._period is not None:
            steps[steps < -0.5 * self._period] += self._period
        fresh = self._last is None
        if self._coarse is None:
            self._coarse = bool((steps[1:] == 0).mean() > COARSE) if steps.size > 1 else False
        restarts = steps < 0
        if restarts.any():
            self._counters["clock_restarts"] += int(restarts.sum())
            steps[restarts] = self.interval or float(np.median(np.abs(steps)))
            if self._arrival is not None and self._taken is not None:
                unexplained = self._arrival - self._taken - float(steps.sum())
                steps[int(np.argmax(restarts))] += max(unexplained, 0.0)
        self._taken = self._arrival
        self._last = (float(samples.ticks[-1]), start + float(steps.sum()))
        if self._coarse:
            # A floored stamp is at most one tick early, so the line through them is steady.
            stamps = start + np.cumsum(steps)
            self._make_steady(replace(samples, ticks=None), float(stamps[-1]))
            return None
        keep = steps > 0
        keep[0] |= fresh
        if not keep.all():
            self._counters["repeated_samples"] += int((~keep).sum())
            if not keep.any():
                return None
            steps, samples = steps[keep], samples.where(keep)
        return start + np.cumsum(steps), self._with_missing(samples, steps)

    def _with_missing(self, samples: Samples, steps: FloatArray) -> Samples:
        """Count what an otherwise even clock shows to be missing."""
        if steps.size > 8:
            self.interval = float(np.median(steps))
        if not self.interval:
            return samples
        ratio = steps / self.interval
        whole = np.rint(ratio)
        even = np.abs(ratio - whole) < 0.25
        if np.mean(even & (whole >= 1)) < 0.9:
            return samples
        missing = np.where(even, whole - 1, 0).clip(min=0).astype(np.int64)
        return replace(samples, lost=np.maximum(samples.lost, missing))
