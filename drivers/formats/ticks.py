"""Stamps of a clock that ticks too seldom: samples that share one are counted on from it.

A logger that notes whole seconds, or hundredths at 200 Hz, or when a packet of samples arrived,
gives a group of them one time. They were taken one after another from there on; whether evenly
throughout is judged where their values are at hand (`calib.timing`).
"""

from __future__ import annotations

import numpy as np

from calib.types import BoolArray, FloatArray, IntArray

SHARE = 0.05
"""Samples with the stamp of the one before, of all: fewer are mistakes."""
FEWEST = 20
"""Such samples: fewer tell no interval."""
WHOLE = 1.5
"""Times the usual tick; beyond it samples are missing between two."""


class Ticks:
    """Counts on the stamps of one recording, batch by batch.

    Attributes
    ----------
    interval : float, s
        From sample to sample; 0 while stamps are not shared.
    tick : float, s
        From one stamp to the next, usually.
    """

    def __init__(self) -> None:
        self.interval = 0.0
        self.tick = 0.0
        self._shortest = np.inf
        self._stamp = -np.inf
        self._given = -np.inf

    def counted_on(self, time: FloatArray) -> FloatArray:
        """Return the times of the next batch, (n,) s; stamps that go back or are NaN as they are.

        Parameters
        ----------
        time : (n,) array, s
            Its stamps.
        """
        if not self.interval and np.isfinite(time[-1]):
            step = np.diff(time, prepend=self._stamp)
            if step.min() > 0:  # as nearly always
                self._stamp = self._given = float(time[-1])
                return time
        known = np.where(np.isfinite(time), time, -np.inf)
        latest = np.maximum.accumulate(np.r_[self._stamp, known])
        forward = (known >= latest[:-1]) & np.isfinite(known)
        stamps = time[forward]
        if not stamps.size:
            return time
        fresh: BoolArray = np.diff(stamps, prepend=self._stamp) > 0
        if not self.interval:
            shared = int(np.count_nonzero(~fresh))
            if shared >= max(FEWEST, SHARE * len(stamps)):
                self._learn(stamps, np.flatnonzero(fresh))
        self._stamp = float(stamps[-1])
        if self.interval:
            stamps = self._spread(stamps, fresh)
            time = time.copy()
            time[forward] = stamps
        self._given = float(stamps[-1])
        return time

    def _learn(self, stamps: FloatArray, first: IntArray) -> None:
        """Take pace and ticks from the groups between which nothing is missing."""
        step, members = np.diff(stamps[first]), np.diff(first)
        if step.size:
            self.tick, self._shortest = float(np.median(step)), float(step.min())
            usual = step < WHOLE * self.tick
            self.interval = float(step[usual].sum() / members[usual].sum())

    def _spread(self, stamps: FloatArray, fresh: BoolArray) -> FloatArray:
        """Return times that increase, from stamps and whether they differ from those before.

        Members of a group follow at the usual pace, or faster if the next stamp is too soon.
        """
        # The first group may go on from the batch before: from the time that was given last.
        begun = int(not fresh[0])
        edges = np.flatnonzero(np.r_[True, fresh[1:]])
        count = np.diff(np.r_[edges, len(stamps)])
        start = stamps[edges]
        end = np.r_[start[1:], start[-1] + self._shortest]
        ahead = np.zeros(len(edges))
        ahead[0] = begun
        start[0] = self._given if begun else start[0]
        pace = np.minimum(self.interval, (end - start) / (count + ahead))
        number = np.arange(len(stamps)) - np.repeat(edges - ahead, count)
        return np.asarray(np.repeat(start, count) + np.repeat(pace, count) * number)
