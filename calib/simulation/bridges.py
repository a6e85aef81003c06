"""Bridges over the holes of what is known of a motion.

In a hole nothing holds a spline, and it would run free. Rows that bridge it come first: from its
edge a value goes over to a steady speed, and from that to the speed at the other edge, by even
acceleration. Of what was in the hole they say nothing.
"""

from __future__ import annotations

import numpy as np

from calib.types import BoolArray, FloatArray

HOLE = 0.035
"""s from one orientation to the next up to which a spline knows what is between: a body that is
moved by hand, or by a table, has next to nothing beyond 15 Hz."""

LONG_STEP = 2.5
"""Usual steps from which on something is missing in a step where times are not even."""

LOOSE = 8
"""Rows beside a hole, or an end, after which a spline has forgotten it to a hundredth."""

EASE = 0.2
"""s in which a bridge goes over to its steady speed: a hand stops about as fast."""

GROWTH = 0.1
"""Of the distance from the edge of a hole by which the rows of its bridge lie further apart."""


def holes(time: FloatArray) -> BoolArray:
    """Return which steps between (n,) times are holes, (n - 1,)."""
    step = np.diff(time)
    return np.asarray(step > max(HOLE, LONG_STEP * float(np.median(step))))


def bridged(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times and (n, k) values with rows that bridge their holes; as they are without."""
    before = np.flatnonzero(holes(time)) if len(time) > 1 else np.zeros(0, int)
    if not len(before):
        return time, values
    step = float(np.median(np.diff(time)))
    edges = np.concatenate(([0], before + 1, [len(time)]))
    times, rows = [time], [values]
    for k, (start, edge, stop) in enumerate(zip(edges, edges[1:], edges[2:], strict=False)):
        end, begin = slice(max(start, edge - LOOSE), edge), slice(edge, min(stop, edge + LOOSE))
        length = time[edge] - time[before[k]]
        since = _spread(length, step)
        speeds = (
            _speed(time[end] - time[edge - 1], values[end]),
            _speed(time[begin] - time[edge], values[begin]),
        )
        times.append(time[edge - 1] + since)
        way = _bridge(since, length, values[edge] - values[edge - 1], *speeds)
        rows.append(values[edge - 1] + way)
    whole, every = np.concatenate(times), np.concatenate(rows)
    order = np.argsort(whole, kind="stable")
    return whole[order], every[order]


def _spread(length: float, step: float) -> FloatArray:
    """Return times within a hole, the further apart the further from its edges, s."""
    count = np.ceil(np.log1p(0.5 * GROWTH * length / step) / np.log1p(GROWTH))
    near = step * np.expm1(np.log1p(GROWTH) * np.arange(1.0, count)) / GROWTH
    near = near[near < 0.5 * (length - step)]
    return np.concatenate((near, [0.5 * length], length - near[::-1]))


def _speed(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the speed (k,) at time 0 of up to `LOOSE` rows beside it, by a polynomial."""
    degree = min(3, (len(time) - 1) // 2)
    if not degree:
        return np.zeros(values.shape[1])
    return np.asarray(np.polyfit(time, values, degree)[-2])


def _bridge(
    since: FloatArray, length: float, whole: FloatArray, first: FloatArray, last: FloatArray
) -> FloatArray:
    """Return the way (m, k) along a bridge that has speeds (k,) at its ends, and its whole way."""
    ease = min(EASE, 0.5 * length)
    steady = (whole - 0.5 * ease * (first + last)) / (length - ease)

    def eased(since: FloatArray) -> FloatArray:
        rise = 0.5 * np.clip(since, 0.0, ease) ** 2 / ease
        return np.asarray(rise + np.maximum(since - ease, 0.0))[:, None]

    way = since[:, None] * first + eased(since) * (steady - first)
    return np.asarray(way + eased(since - (length - ease)) * (last - steady))
