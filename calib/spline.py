"""Cubic splines through points, not-a-knot at their ends: slopes first, then Hermite's form.

`scipy.interpolate.CubicSpline` gives the same (tests compare them), one set of points at a time.
Where a sample may be missing, thousands of short splines are tried, each through points of its own:
here they are one banded system.

References
----------
.. [1] de Boor, "A Practical Guide to Splines", Springer 1978, ch. IV, eqs. (7) and (10).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from calib.types import FloatArray, IntArray


def spline_slopes(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the slopes of splines at their own points.

    Parameters
    ----------
    time : (..., n) array, n > 3
        Increasing along the last axis; each row before it is a spline of its own.
    values : (..., n, k) array
    """
    step = np.diff(time, axis=-1)
    # One column after the other in memory, as the solver has them.
    rows = np.ascontiguousarray(np.moveaxis(values, -1, 0), np.float64)
    chord = np.diff(rows, axis=-1) / step
    below, middle, above = np.zeros((3, *time.shape))
    right = np.empty_like(rows)
    h, g = step[..., :-1], step[..., 1:]
    below[..., 1:-1], middle[..., 1:-1], above[..., 1:-1] = g, 2 * (h + g), h
    right[..., 1:-1] = 3 * (g * chord[..., :-1] + h * chord[..., 1:])
    for end, beside, neighbour in ((0, 1, above), (-1, -2, below)):
        h, g = step[..., end], step[..., beside]
        middle[..., end], neighbour[..., end] = g, h + g
        outer, inner = ((3 * h + 2 * g) * g / (h + g), np.square(h) / (h + g))
        right[..., end] = outer * chord[..., end] + inner * chord[..., beside]
    # Rows one after the other: nothing couples them.
    flat = right.reshape(len(rows), -1).T
    lower, diagonal, upper = below.ravel()[1:], middle.ravel(), above.ravel()[:-1]
    solved = lapack.dgtsv(lower, diagonal, upper, flat, 1, 1, 1, 1)[3]
    return np.moveaxis(np.asarray(solved).T.reshape(right.shape), 0, -1)


def spline_between(
    time: FloatArray, values: FloatArray, slopes: FloatArray, gap: IntArray, at: FloatArray
) -> FloatArray:
    """Return (..., k) values of a spline at times (...), each between points `gap` and the next.

    Parameters
    ----------
    time, values, slopes : (n,), (n, k), (n, k) arrays
        Points, and what `spline_slopes` makes of them.
    gap, at : (...) arrays
    """
    step = time[gap + 1] - time[gap]
    since = at - time[gap]
    part = since / step
    points, bends = np.ascontiguousarray(values.T), np.ascontiguousarray(slopes.T)
    left = points.take(gap, axis=1)
    chord = (points.take(gap + 1, axis=1) - left) / step
    bend = (bends.take(gap, axis=1) - chord) * (1 - part)
    bend -= (bends.take(gap + 1, axis=1) - chord) * part
    return np.moveaxis(left + since * (chord + (1 - part) * bend), 0, -1)


def spline_at(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return (m, k) values of the spline through (n, k) `values` at (m,) times within it."""
    gap = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    return spline_between(time, values, spline_slopes(time, values), gap, at)
