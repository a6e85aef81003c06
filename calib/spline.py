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
    chord = np.diff(values, axis=-2) / step[..., None]
    below, middle, above = np.zeros((3, *time.shape))
    right = np.empty_like(values, dtype=np.float64)
    h, g = step[..., :-1], step[..., 1:]
    below[..., 1:-1], middle[..., 1:-1], above[..., 1:-1] = g, 2 * (h + g), h
    right[..., 1:-1, :] = 3 * (g[..., None] * chord[..., :-1, :] + h[..., None] * chord[..., 1:, :])
    for end, beside, neighbour in ((0, 1, above), (-1, -2, below)):
        h, g = step[..., end], step[..., beside]
        middle[..., end], neighbour[..., end] = g, h + g
        outer, inner = ((3 * h + 2 * g) * g / (h + g), np.square(h) / (h + g))
        right[..., end, :] = (
            outer[..., None] * chord[..., end, :] + inner[..., None] * chord[..., beside, :]
        )
    # Rows one after the other: nothing couples them.
    flat = right.reshape(time.size, -1)
    solved = lapack.dgtsv(below.ravel()[1:], middle.ravel(), above.ravel()[:-1], flat)[3]
    return np.asarray(solved).reshape(right.shape)


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
    step = (time[gap + 1] - time[gap])[..., None]
    since = (at - time[gap])[..., None]
    chord = (values[gap + 1] - values[gap]) / step
    part = since / step
    bend = (slopes[gap] - chord) * (1 - part) - (slopes[gap + 1] - chord) * part
    return np.asarray(values[gap] + since * (chord + (1 - part) * bend))


def spline_at(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return (m, k) values of the spline through (n, k) `values` at (m,) times within it."""
    gap = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    return spline_between(time, values, spline_slopes(time, values), gap, at)
