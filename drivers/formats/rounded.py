"""Coarse stamps put on the even grid that explains them, batch by batch."""

from __future__ import annotations

import numpy as np

from calib.rounded_stamps import Even, even_grid
from calib.types import BoolArray, FloatArray, IntArray

BEFORE = 1 << 15
"""Stamps of batches before that tell the grid of the next one as well."""

BLEND = 1024
"""Samples over which a batch goes over from the grid before to its own."""


class Rounded:
    """Evens coarse stamps of one recording (`calib.rounded_stamps`), batch by batch.

    Attributes
    ----------
    found : Even or None
        Of the batch that was even last.
    """

    def __init__(self) -> None:
        self.found: Even | None = None
        self._stamps: FloatArray = np.zeros(0)
        self._lost: IntArray = np.zeros(0, np.int64)
        self._last: float | None = None

    def evened(self, time: FloatArray, lost: IntArray | None) -> FloatArray | None:
        """Return even times of the next batch, (n,) s; None if its stamps are not coarse.

        Stamps that go back or are NaN are returned as they are.

        Parameters
        ----------
        time : (n,) array, s
            Its stamps.
        lost : (n,) array of int, or None
            Samples known to be missing before each.
        """
        n = len(time)
        known = np.where(np.isfinite(time), time, -np.inf)
        start = self._stamps[-1] if len(self._stamps) else -np.inf
        latest = np.maximum.accumulate(np.r_[start, known])
        forward: BoolArray = (known >= latest[:-1]) & np.isfinite(known)
        if not forward.any():
            return None
        # A row without a stamp was a sample, too.
        missing = np.ones(n, np.int64) if lost is None else lost + 1
        count = np.diff(np.cumsum(missing)[forward], prepend=0) - 1
        before = len(self._stamps)
        self._stamps = np.concatenate((self._stamps, time[forward]))
        self._lost = np.concatenate((self._lost, count))
        grid = even_grid(self._stamps, self._lost)
        self._stamps, self._lost = self._stamps[-BEFORE:], self._lost[-BEFORE:]
        if grid is None:
            self._last = None
            return None
        own = grid.time[before:]
        if self._last is not None:
            ahead = grid.time[before - 1] - self._last
            own = own - ahead * np.clip(1.0 - np.arange(len(own)) / BLEND, 0.0, None)
        self.found, self._last = grid, float(own[-1])
        out = time.copy()
        out[forward] = own
        return out
