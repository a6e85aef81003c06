"""Places: the pieces of one disturbance are one item."""

from __future__ import annotations

from dataclasses import replace

from calib.mismatch.findings.diagnosis import Interval, Unexplained
from calib.mismatch.hypotheses.rivals import FROM_START
from calib.mismatch.hypotheses.windows import WINDOWED
from calib.recording import CHANNELS

GAP = 0.25
"""Gap between two pieces on one channel, relative to both with the gap, up to which they are one:
a window is found to within about a quarter of its length."""

COMMON = 0.5
"""Overlap of two windows on different channels, relative to their hull, from which they are one."""

SEEN = " there"
"""How what follows the time ends where the samples of some rests show it, and those of no other."""


def joined(items: list[Unexplained]) -> list[Unexplained]:
    """Return the items with pieces of one disturbance joined, in the place of the first.

    A disturbance that no single window describes (it grows, pauses, or reaches several channels) is
    found piece by piece. What it follows and how sure it is are said of the surest; its channels
    too, where one has all of the other's.
    """
    out: list[Unexplained] = []
    for item in items:
        for i, other in enumerate(out):
            if _are_one(other, item):
                surest = min(other, item, key=lambda piece: piece.p_value)
                both, own = {*other.channels, *item.channels}, (other.channels, item.channels)
                channels = surest.channels if both in map(set, own) else both
                out[i] = replace(
                    surest,
                    channels=tuple(c for c in CHANNELS if c in channels),
                    intervals=(_hull(other.intervals[0], item.intervals[0]),),
                )
                break
        else:
            out.append(item)
    return out if len(out) == len(items) else joined(out)


def gathered(items: list[Unexplained]) -> list[Unexplained]:
    """Return the items with what some rests show of the same triads as one, in several places."""
    out: list[Unexplained] = []
    for item in items:
        alike = [i for i, other in enumerate(out) if _kind(other) == _kind(item)]
        if not alike or not item.follows.endswith(SEEN):
            out.append(item)
            continue
        other = out[alike[0]]
        channels = {*other.channels, *item.channels}
        out[alike[0]] = replace(
            other,
            channels=tuple(c for c in CHANNELS if c in channels),
            intervals=_apart((*other.intervals, *item.intervals)),
            p_value=min(other.p_value, item.p_value),
        )
    return out


def _kind(item: Unexplained) -> tuple[str, frozenset[str]]:
    return item.follows, frozenset(c.split(".")[0] for c in item.channels)


def _apart(intervals: tuple[Interval, ...]) -> tuple[Interval, ...]:
    """Return intervals in their order, those that overlap as one."""
    out: list[Interval] = []
    for here in sorted(intervals):
        if out and here[0] <= out[-1][1]:
            out[-1] = _hull(out[-1], here)
        else:
            out.append(here)
    return tuple(out)


def _are_one(one: Unexplained, other: Unexplained) -> bool:
    if (one.follows, one.channels, one.intervals) == (
        other.follows,
        other.channels,
        other.intervals,
    ):
        # Waves of several periods are one that is no sine.
        return True
    if not (_is_local(one) and _is_local(other)):
        return False
    (a, b), (c, d) = one.intervals[0], other.intervals[0]
    start, stop = _hull((a, b), (c, d))
    common = (min(b, d) - max(a, c)) / (stop - start)
    return common > -GAP if set(one.channels) & set(other.channels) else common >= COMMON


def _is_local(item: Unexplained) -> bool:
    """Whether an item is somewhere in time: in the rows, or in the samples of rests."""
    return item.follows in (*WINDOWED, FROM_START) or item.follows.endswith(SEEN)


def _hull(one: Interval, other: Interval) -> Interval:
    return min(one[0], other[0]), max(one[1], other[1])
