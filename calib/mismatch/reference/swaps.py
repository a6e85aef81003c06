"""Moments at which motion capture takes one marker for another.

The orientation then jumps, and back a little later. A gyroscope does not: what the orientation
turns by beside it, summed up, stays near its own running median but while markers are swapped.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.truths import near
from calib.recording import Recording
from calib.rotation import quat_multiply
from calib.types import BoolArray, FloatArray

WINDOW = 4.0
"""s of the running median: markers are swapped for less than half of that."""

FAR = 10.0
"""Standard errors from the median that no noise of angles reaches."""

LEAST = 0.02
"""rad that a gyroscope of this grade may wander in `WINDOW`, its scale and bias fitted."""

SMALL = 0.1
"""rad up to which a turn is a vector to the third order: to 0.0002 rad."""

POINTS = 200
"""Points of the running median."""

REACH = 3
"""Samples about a swapped one into which a filter of the capture's own spreads it."""


def swapped(
    time: FloatArray, quat: FloatArray, real: Recording, alignment: Alignment, mat: FloatArray
) -> BoolArray:
    """Return which captured orientations are not those of the body, (n,) bool.

    Parameters
    ----------
    time : (n,) array, s
    quat : (n, 4) array
        ``mat_ns``; rows that are not finite are gaps.
    real : Recording
        What its gyroscope saw, in its own frame, ``mat`` (3, 3) from the captured one.
    alignment : Alignment
        From the recording's time to the captured one.
    """
    from scipy.ndimage import median_filter  # only this needs it

    out = np.zeros(len(time), bool)
    own = alignment.moments(time)
    good = np.flatnonzero(
        np.isfinite(quat).all(axis=1) & (own > real.time[0]) & (own < real.time[-1])
    )
    if len(good) < POINTS:
        return out
    step = quat_multiply(quat[good[:-1]] * [1, -1, -1, -1], quat[good[1:]])
    turned = 2.0 * step[:, 1:] * np.where(step[:, :1] < 0, -1.0, 1.0)
    rate = real.gyro @ mat
    angle = np.zeros_like(rate)
    angle[1:] = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(real.time)[:, None], axis=0)
    at = own[good]
    seen, fast = (
        np.stack([np.diff(np.interp(at, real.time, v)) for v in values.T], axis=1)
        for values in (angle, rate)
    )
    # Bias, scale and misalignment of the gyroscope, and what is left of the offset of the clocks.
    design = np.hstack((np.diff(at)[:, None], seen, fast))
    left = turned - seen
    # What the body turned by in a gap of the gyroscope's own nobody saw.
    both = near(real.time, at[:-1]) & near(real.time, at[1:])
    usual = np.linalg.norm(left, axis=1)
    usual = both & (usual < FAR * np.median(usual[both]))
    left = left - design @ np.linalg.lstsq(design[usual], left[usual])[0]
    interval = float(np.median(np.diff(at)))
    # Turns that are missed in a gap do not add up as vectors.
    left[(np.diff(at) > 1.5 * interval) & (np.linalg.norm(seen, axis=1) > SMALL)] = 0.0
    left[~both] = 0.0
    total = np.vstack((np.zeros(3), np.cumsum(left, axis=0)))
    every = max(1, round(WINDOW / POINTS / interval))
    width = round(WINDOW / (every * interval))
    middle = median_filter(total[::every], size=(width, 1), mode="nearest")
    about = np.abs(
        total - np.stack([np.interp(at, at[::every], column) for column in middle.T], axis=1)
    )
    limit = FAR * np.median(about, axis=0) / 0.6745 + LEAST
    # A gap is a step, and of two points beside it one may be on either side: between two points of
    # the median nothing is far from both that is between them.
    k = np.arange(len(total)) // every
    ends = middle[k], middle[np.minimum(k + 1, len(middle) - 1)]
    far = np.maximum(np.minimum(*ends) - total, total - np.maximum(*ends))
    out[good] = (far > limit).any(axis=1)
    return np.asarray(np.convolve(out, np.ones(2 * REACH + 1), mode="same") > 0)
