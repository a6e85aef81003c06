"""Rests without what a hand still carries, or already: it turns nothing, but the sensor moves.

The ends of rests are told by the gyroscope. A hand that sets a sensor down stops turning it some
tenths of a second before it stops to move it, and what is left of the velocity by then would be a
turn that does not end at rest: a bias in that window. What the accelerometer shows of it rises as
briskly as a hand does. Gravity that moves as slowly as a slow turn begins is none of it, and what
settles for longer is the accelerometer's own.

A robot, or a slow hand, begins to carry a sensor long before it turns it, and by less. Nothing of
an accelerometer's own comes before a turn: what it shows there is motion, however small. Where many
rests end so, they begin so, too; and what few begin with is motion as well.
"""

from __future__ import annotations

import numpy as np

from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.rests import ONSET, SHORTEST, rise, scatter
from calib.stillness import block_size
from calib.types import FloatArray, IntArray

CARRIED = 6
"""Blocks (0.1 s each) for which what has stopped to turn is still carried."""

MOVED = 0.03
"""m/s² from which what carries a sensor is seen, however quiet that is: what settles is less."""

LONGEST, PART = 30, 3
"""Blocks before a turn for which it is carried slowly, at most, and the part of a rest (a third):
what changes for longer leans."""

MOSTLY = 0.75
"""Share of these that are off: where a force changes its sign it is none for a moment."""

SOME, SELDOM = 0.1, 0.25
"""Share of the rests, and two at least, that end so where they begin so as well; and share that may
begin so in any case: what settles after turns does so after nearly all."""

BESIDE = 20
"""Blocks beyond the end of a rest that are looked at, at most."""


def uncarried(recording: Recording, poses: Poses) -> Poses:
    """Return the poses, of a recording and in the order of time, without such moments at ends.

    Where no seconds are known, nor is what is brisk.
    """
    if recording.interval <= 0 or recording.clock == "invalid":
        return poses
    assert recording.lost is not None
    size, torn = block_size(recording.interval), np.flatnonzero(recording.lost)
    start, stop = poses.start.copy(), poses.stop.copy()
    edges = np.concatenate(([0], np.stack((start, stop), axis=1).ravel(), [len(recording)]))
    inwards, slow = np.zeros((2, len(poses), 2), np.int64)
    for k in range(len(poses)):
        before, a, b, after = (int(v) for v in edges[2 * k : 2 * k + 4])
        # Of a rest that was thinned only the windows at its ends are next to what moves.
        first, last = _next_to_ends(torn, a, b)
        early, late = recording.accel[before:first][::-1], recording.accel[last:after]
        inwards[k] = _inwards(early, first - a, size), _inwards(late, b - last, size)
        slow[k] = _slowly(early[: first - a], size), _slowly(late[: b - last], size)
    early, late = np.count_nonzero(slow, axis=0)
    if late < max(2, SOME * len(poses)) and early > SELDOM * len(poses):
        slow[:, 0] = 0
    inwards = np.maximum(inwards, slow)
    enough = (stop - start) - inwards.sum(axis=1) >= SHORTEST * size
    start[enough] += inwards[enough, 0]
    stop[enough] -= inwards[enough, 1]
    if np.array_equal(start, poses.start) and np.array_equal(stop, poses.stop):
        return poses
    return average_poses(recording, start, stop)


def _slowly(accel: FloatArray, size: int) -> int:
    """Return for how many samples at the end of a rest (n, 3) it is carried slowly.

    A force that grows with time, as where a smooth motion begins, is seen when it has begun for
    some time already; and it goes through nothing where the motion slows down.
    """
    blocks = accel[len(accel) % size :].reshape(-1, size, 3).mean(axis=1)
    own = len(blocks)
    if own < 2 * SHORTEST:
        return 0
    level = ONSET * scatter(blocks, 0.0)
    off = np.linalg.norm(blocks - np.median(blocks[own // 4 : own - own // 4], axis=0), axis=1)
    above = off[::-1] > level
    share = np.cumsum(above) / np.arange(1, own + 1)
    seen = int(np.max(np.flatnonzero(above & (share >= MOSTLY)), initial=-1)) + 1
    if not 0 < seen <= min(LONGEST, own // PART):
        return 0
    most = float(off[own - seen :].max())
    return (seen + min(int(np.ceil(seen * level / (most - level))), seen) + 1) * size


def _next_to_ends(torn: IntArray, a: int, b: int) -> tuple[int, int]:
    """Return where the first whole part of a rest ``[a, b)`` ends, and where its last begins.

    Before the samples ``torn`` others are missing.
    """
    own = torn[np.searchsorted(torn, a, side="right") : np.searchsorted(torn, b)]
    return (int(own[0]), int(own[-1])) if len(own) else (b, a)


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
