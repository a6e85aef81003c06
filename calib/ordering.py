"""Samples that are not in the order they were taken in: a packet that came after the next one.

No channel is on its course there, at three places: where the later packet begins, where the earlier
one does, and where both have ended. In their own order all channels go on as beside.
"""

from __future__ import annotations

import numpy as np

from calib.faults import FALSE_ALARM, NEARBY, ROBUST, noise_at_rest, resolution
from calib.types import FloatArray, IntArray

LEAST, MOST = 4, 32
"""Samples of a packet: as many as tell its ends apart, and what a buffer holds."""

FREEDOM = 3.0
"""Degrees of freedom of the jumps that motion makes."""

REACH = 4
"""Samples on either side of a place that its jumps are seen in."""

PART = 4096
"""Places that are looked at together."""

USUAL = 0.99
"""Share of samples that channels jump less at than where packets meet that were exchanged, and no
less than in their own order: what shakes a sensor may be as rough, but it is so in any order."""


def find_swapped(values: FloatArray) -> list[tuple[int, int]]:
    """Return ``(start, stop)`` of samples (n, 6) of which the second half was taken first.

    Of jumps with Student's t the likelihood with both halves exchanged, over that of the order as
    it is, is x or more by chance in 1 of x recordings at most, at each place and size of a packet:
    exchanging samples changes no density. In a recording chance finds one with `FALSE_ALARM`. At
    each of the three places they must jump by more than others do, and in the order they were taken
    in go on as smoothly as those.
    """
    n = len(values)
    if n < 4 * NEARBY:
        return []
    jump, step = _jumps(values)
    scale = _scale(jump, values)
    rough = _unlikely(jump, scale)
    broken = _unlikely(step, scale)
    needed = 2.0 * np.log(n * (MOST - LEAST + 1) / FALSE_ALARM)
    usual = float(np.quantile(rough, USUAL))
    gain, start, size = [np.zeros(0)], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for m in range(LEAST, MOST + 1):
        edges = broken[: n - 2 * m], broken[m : n - m], broken[2 * m :]
        before = edges[0] + edges[1] + edges[2]
        at = np.flatnonzero(before > needed)
        at = at[np.min([edge[at] for edge in edges], axis=0) > usual]
        at = at[(at >= REACH) & (at < n - 2 * m - REACH)]
        for own in np.array_split(at, len(at) // PART + 1):
            after = _exchanged(values, scale, own, m)
            better = before[own] - after
            some = (better > needed) & (after < 3.0 * usual)
            gain.append(better[some])
            start.append(own[some])
            size.append(np.full(int(some.sum()), m))
    return _apart(np.concatenate(gain), np.concatenate(start), np.concatenate(size), n)


def _exchanged(values: FloatArray, scale: FloatArray, at: IntArray, size: int) -> FloatArray:
    """Return how unlikely jumps are where packets from ``at`` (k,) meet once they are exchanged.

    A step is seen from one sample on either side too: the least likely of these counts.
    """
    order = np.arange(-REACH, 2 * size + REACH)
    places = REACH + np.array([[0], [size], [2 * size]]) + np.arange(-1, 2)
    there = at[:, None] + order[places.ravel()]
    order[REACH : REACH + 2 * size] = np.roll(order[REACH : REACH + 2 * size], size)
    jump, _ = _jumps(np.swapaxes(values[at[:, None] + order], 0, 1))
    each = _unlikely(jump[places.ravel()], np.swapaxes(scale[there], 0, 1))
    return np.asarray(each.reshape(3, 3, len(at)).max(axis=1).sum(axis=0))


def _jumps(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how much more channels (n, ...) change at each sample than before and after it.

    And how much of that is left whichever sample beside it is left out: one that is off is no step.
    """
    jump, step = np.zeros_like(values), np.zeros_like(values)
    if len(values) < 6:
        return jump, step
    a, b, c, d, e, f = (values[k : len(values) - 5 + k] for k in range(6))
    whole = (d - c) - 0.5 * ((c - b) + (e - d))
    least = np.abs(whole)
    for other in (
        (e - c) - ((c - b) + (f - e)),
        (d - b) - ((b - a) + (e - d)),
        (d - c) - 0.25 * ((c - a) + (f - d)),
    ):
        np.minimum(least, np.abs(other), out=least)
    own = slice(3, len(values) - 2)
    jump[own], step[own] = whole, least
    return jump, step


def _scale(jump: FloatArray, values: FloatArray) -> FloatArray:
    """Return what channels jump by around each sample, (n, 6): by noise, counts, or motion."""
    n, width = jump.shape
    count = n // NEARBY
    level = ROBUST * np.median(np.abs(jump[: count * NEARBY]).reshape(count, NEARBY, width), axis=1)
    padded = np.pad(level, ((1, 1), (0, 0)), mode="edge")
    level = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    level = np.pad(np.repeat(level, NEARBY, axis=0), ((0, n - count * NEARBY), (0, 0)), mode="edge")
    floor = np.maximum(np.sqrt(5.0) * noise_at_rest(values), resolution(values))
    return np.maximum(level, np.where(floor > 0, floor, np.inf))


def _unlikely(jump: FloatArray, scale: FloatArray) -> FloatArray:
    """Return minus twice the log-likelihood of jumps of all channels, over that of none, (n,)."""
    square = np.square(jump / scale) / FREEDOM
    return np.asarray((FREEDOM + 1.0) * np.log1p(square).sum(axis=-1))


def _apart(gain: FloatArray, start: IntArray, size: IntArray, n: int) -> list[tuple[int, int]]:
    """Return those stretches that gain most of all that overlap them, in order."""
    taken, out = np.zeros(n, bool), []
    for k in np.argsort(-gain):
        own = slice(int(start[k]), int(start[k] + 2 * size[k]))
        if not taken[own].any():
            taken[own] = True
            out.append((own.start, own.stop))
    return sorted(out)
