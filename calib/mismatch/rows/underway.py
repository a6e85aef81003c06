"""When turns are under way: rests begin late and end early, to be sure, and integrals pay for it.

What is integrated for half as long again has half as much noise again. So a turn is integrated from
before the first sample that stands out of the rest before it to after the last that stands out of
the rest after it. A rate that grows as ``(t - t0)²`` passes a level at t1 and four times that at
``t2 = 2 t1 - t0``: it begins as long before it stands out as it takes to stand out four times as
much. What is left out must read as the rest does, on average, on every channel: it is part of it.
"""

from __future__ import annotations

import numpy as np

from calib.poses import Poses
from calib.recording import Recording
from calib.types import FloatArray, IntArray

STANDS_OUT, RISE = 5.0, 4.0
"""Standard deviations of a sample at rest, by which one in 10⁶ is off by chance; and how many times
as much what has begun stands out."""

SAME = 3.0
"""Standard errors within which means are those of the rest."""

REACH = 0.5
"""s that are left out at either end of a turn, at most: rests are found with no wider margins."""

KEPT = 0.05
"""s at rest that a turn keeps at either end: what a filter does to the motion is over by then."""

NEAR, LEAST = 1.0, 10
"""s, and samples at least, of a rest that tell what it reads at its end."""

GAP = 2.5
"""Intervals between samples from which on some are missing, and motion may be."""


def is_torn(recording: Recording, start: int, stop: int) -> bool:
    """Return whether any are missing between samples ``[start, stop)``, of which there are two."""
    return bool(np.diff(recording.time[start:stop]).max() > GAP * recording.interval)


def under_way(recording: Recording, poses: Poses) -> IntArray:
    """Return the samples ``[start, stop)``, (k - 1, 2), in which the turns between k poses are.

    Parameters
    ----------
    recording : Recording
    poses : Poses
        Of it, in the order of time.
    """
    turns = np.stack((poses.stop[:-1], poses.start[1:]), axis=1)
    step = max(recording.interval, 1e-9)
    near, reach, kept = (max(1, round(seconds / step)) for seconds in (NEAR, REACH, KEPT))
    for k, (a, b) in enumerate(turns.tolist()):
        # Half of what is between two rests is either's.
        room = min((b - a) // 2, reach)
        first, last = max(int(poses.start[k]), a - near), min(int(poses.stop[k + 1]), b + near)
        if min(a - first, last - b) < LEAST or room < 1 or _broken(recording, first, last):
            continue
        rest, turn, later = (
            np.hstack((recording.accel[own], recording.gyro[own]))
            for own in (slice(first, a), slice(a, b), slice(b, last))
        )
        turns[k, 0] += max(still_for(rest, turn, most=room) - kept, 0)
        turns[k, 1] -= max(still_for(later[::-1], turn[::-1], most=room) - kept, 0)
    return turns


def _broken(recording: Recording, first: int, last: int) -> bool:
    """Whether samples are missing among ``[first, last)``, as far as times tell."""
    if recording.clock == "invalid":
        return False
    return bool((np.diff(recording.time[first:last]) > GAP * recording.interval).any())


def still_for(rest: FloatArray, turn: FloatArray, *, most: int) -> int:
    """Return how many of the first samples of a turn are still those of the rest.

    Parameters
    ----------
    rest : (n, 6) array
        Signals at rest just before the turn.
    turn : (m, 6) array
        Those of the turn. Both may run backwards: from the rest after it.
    most : int
    """
    mean, sigma = rest.mean(axis=0), rest.std(axis=0)
    off = turn - mean
    size = (np.abs(off) / np.maximum(sigma, 1e-12 * np.abs(mean) + 1e-300)).max(axis=1)
    out = np.flatnonzero(size > STANDS_OUT)
    if not len(out):
        return 0
    begins = int(out[0])
    clearly = np.flatnonzero(size[begins:] > RISE * STANDS_OUT)
    rise = int(clearly[0]) if len(clearly) else int(np.argmax(size[begins:]))
    still = min(begins - rise, most)
    if still < 1:
        return 0
    error = sigma * np.sqrt(1 / still + 1 / len(rest))
    return still if (np.abs(off[:still].mean(axis=0)) <= SAME * error).all() else 0
