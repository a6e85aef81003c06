"""Channels that wrap around: beyond its range a counter of counts goes on at the other end.

From one sample to the next such a channel jumps by all of its range, from one end to the other, and
is on its course again if that range is added. What is clipped stays at the end instead.
"""

from __future__ import annotations

import numpy as np

from calib.faults import noise_at_rest
from calib.gravity import STANDARD_GRAVITY
from calib.stillness import runs
from calib.types import FloatArray

ENDS = 0.8
"""Of the largest value that a channel reads: what jumps reaches it on both sides."""

ON_COURSE = 0.2
"""Of the jump: how far a signal may go in one sample when the range is added."""

LEAST = 1.5
"""Of gravity: no accelerometer has a range of less, and one that is turned over between two samples
of a slow log jumps by twice gravity."""

GAP = 1.5
"""Intervals from which on samples are not neighbours."""

LOUD = 100.0
"""Noises that such a jump is, at least."""


def find_wrapped(
    values: FloatArray, time: FloatArray, interval: float
) -> list[tuple[int, int, int]]:
    """Return ``(channel, start, stop)`` of samples that are a range off their course.

    How many ranges a channel is off is counted from jump to jump; it is none most of the time.

    Parameters
    ----------
    values : (n, 6) array, m/s² and rad/s
    time : (n,) array, s
        Across a gap anything may have moved.
    interval : float, s
    """
    out: list[tuple[int, int, int]] = []
    noise = noise_at_rest(values)
    beside = np.diff(time) < GAP * interval
    for c in range(values.shape[1]):
        own = values[:, c]
        largest = float(np.abs(own).max(initial=0.0))
        far = np.minimum(np.abs(own[1:]), np.abs(own[:-1])) > ENDS * largest
        at = np.flatnonzero(far & (own[1:] * own[:-1] < 0))
        least = max(LOUD * noise[c], LEAST * STANDARD_GRAVITY if c < 3 else 0.0)
        if len(at) < 2 or largest <= least or not beside[at].all():
            continue
        jump = own[at + 1] - own[at]
        span = float(np.abs(jump).max())
        if (np.abs(np.abs(jump) - span) > ON_COURSE * span).any():
            continue
        ranges = np.zeros(len(own), np.int64)
        ranges[at + 1] = np.sign(jump).astype(np.int64)
        ranges = np.cumsum(ranges)
        # What shakes from one end to the other moves as far in the samples beside.
        near = np.clip([at - 1, at, at + 1], 0, len(own) - 2)
        if np.abs(np.diff(own - span * ranges))[near].max() > ON_COURSE * span:
            continue
        off = ranges != np.bincount(ranges - ranges.min()).argmax() + ranges.min()
        out += [(c, a, b) for a, b in zip(*(x.tolist() for x in runs(off)), strict=True)]
    return out
