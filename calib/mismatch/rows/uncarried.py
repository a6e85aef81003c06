"""Rests without what a hand still carries, or already: it turns nothing, but the sensor moves.

The ends of rests are told by the gyroscope. A hand that sets a sensor down stops turning it some
tenths of a second before it stops to move it, and what is left of the velocity by then would be a
turn that does not end at rest: a bias in that window. What the accelerometer shows of it rises as
briskly as a hand does. Gravity that moves as slowly as a slow turn begins is none of it, and what
settles for longer is the accelerometer's own.
"""

from __future__ import annotations

import numpy as np

from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.rests import ONSET, SHORTEST, rise, scatter
from calib.stillness import block_size
from calib.types import FloatArray

CARRIED = 6
"""Blocks (0.1 s each) for which what has stopped to turn is still carried."""

MOVED = 0.03
"""m/s² from which what carries a sensor is seen, however quiet that is: what settles is less."""

BESIDE = 20
"""Blocks beyond the end of a rest that are looked at, at most."""


def uncarried(recording: Recording, poses: Poses) -> Poses:
    """Return the poses, of a recording and in the order of time, without such moments at ends.

    Where no seconds are known, nor is what is brisk.
    """
    if recording.interval <= 0 or recording.clock == "invalid":
        return poses
    size = block_size(recording.interval)
    start, stop = poses.start.copy(), poses.stop.copy()
    edges = np.concatenate(([0], np.stack((start, stop), axis=1).ravel(), [len(recording)]))
    for k in range(len(poses)):
        before, a, b, after = (int(v) for v in edges[2 * k : 2 * k + 4])
        early = _inwards(recording.accel[before:b][::-1], b - a, size)
        late = _inwards(recording.accel[a:after], b - a, size)
        if (b - a) - early - late >= SHORTEST * size:
            start[k], stop[k] = a + early, b - late
    if np.array_equal(start, poses.start) and np.array_equal(stop, poses.stop):
        return poses
    return average_poses(recording, start, stop)


def _inwards(accel: FloatArray, inside: int, size: int) -> int:
    """Return how many samples at the end of the first ``inside`` of (n, 3) are not at rest."""
    own = inside // size
    skipped = inside - own * size
    blocks = accel[skipped:][: (own + BESIDE) * size]
    blocks = blocks[: len(blocks) // size * size].reshape(-1, size, 3).mean(axis=1)
    if own < 2 * SHORTEST or len(blocks) <= own:
        return 0
    level = max(ONSET * scatter(blocks[:own], 0.0), MOVED)
    near = blocks[own // 2 : own]
    off = np.linalg.norm(blocks - np.median(near, axis=0), axis=1)
    inwards, margin = rise(off, own, level, min(own // 2, CARRIED), brisk=CARRIED)
    return (inwards + margin) * size
