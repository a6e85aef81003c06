"""Which poses of very many are looked at.

The cost of a diagnosis grows with the cube of its rows, and every pose and turn brings some. A
calibration and its further terms have some dozens of parameters: eighty poses with the turns
between them determine each many times over, and what more would give is the root of their number.
What must not be lost is variety. So turns are taken that begin and end at unlike directions of
gravity, from all over the recording; then the longest rests, which see temperature and time.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.rows.grid import LONGEST_TURN
from calib.types import FloatArray, IntArray

MOST = 80
"""Poses."""

FOR_TURNS = 0.8
"""Share of the poses that are chosen for the turns beside them."""

ALIKE = 0.26
"""Directions of gravity closer than this are one, rad."""


def choose_poses(
    accel: FloatArray, start: IntArray, stop: IntArray, *, interval: float
) -> IntArray:
    """Return the indices of the poses to look at, in order: all of up to `MOST`.

    Parameters
    ----------
    accel : (k, 3) array
        Mean specific force of each pose, in any unit.
    start, stop : (k,) arrays of int
        Samples of each pose.
    interval : float, s
        Between samples.
    """
    k = len(start)
    if k <= MOST:
        return np.arange(k)
    kind = _directions(accel)
    turn = np.flatnonzero((start[1:] - stop[:-1]) * interval <= LONGEST_TURN)
    order = turn[_spread(len(turn))]
    # The first of every kind of turn, then the second of every kind, ...
    seen: dict[tuple[int, int], int] = {}
    number = np.zeros(len(order), np.int64)
    for i, a in enumerate(order.tolist()):
        ends = int(kind[a]), int(kind[a + 1])
        # A turn that comes back to where it began tells little.
        number[i] = seen.get(ends, 0) + (k if ends[0] == ends[1] else 0)
        seen[ends] = seen.get(ends, 0) + 1
    chosen = np.zeros(k, bool)
    for a in order[np.argsort(number, kind="stable")]:
        if chosen.sum() + 2 > FOR_TURNS * MOST:
            break
        chosen[a : a + 2] = True
    longest = np.argsort(np.where(chosen, -1, stop - start), kind="stable")[::-1]
    chosen[longest[: MOST - int(chosen.sum())]] = True
    return np.flatnonzero(chosen)


def distinct_directions(accel: FloatArray) -> int:
    """Return how many directions of gravity are not `ALIKE`."""
    return len(np.unique(_directions(accel)))


def _directions(accel: FloatArray) -> IntArray:
    """Return the number of the direction that each vector has, (k,)."""
    up = accel / np.maximum(np.linalg.norm(accel, axis=1, keepdims=True), 1e-300)
    known = np.zeros((0, 3))
    out = np.empty(len(up), np.int64)
    for i, vec in enumerate(up):
        near = known @ vec
        if not len(near) or near.max() < np.cos(ALIKE):
            out[i] = len(known)
            known = np.vstack((known, vec))
        else:
            out[i] = int(np.argmax(near))
    return out


def _spread(n: int) -> IntArray:
    """Return 0 ... n - 1 so that the first few are spread over all (van der Corput's order)."""
    bits = max(n - 1, 1).bit_length()
    number = np.arange(1 << bits)
    turned = np.zeros_like(number)
    for bit in range(bits):
        turned |= (number >> bit & 1) << (bits - 1 - bit)
    return turned[turned < n]
