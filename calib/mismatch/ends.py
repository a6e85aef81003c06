"""Where a disturbance begins and ends: the window that is expected to overlap it most.

What rows say of the ends of a window is often little: a gain on one axis shows only where that axis
is loaded. The most probable window may then be far from most of those that are as good. So every
window is weighted by its evidence, and the one is said whose overlap with the others, intersection
over union, is largest on average.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.candidates import Candidate
from calib.mismatch.diagnosis import Interval
from calib.mismatch.noise import Whitener
from calib.mismatch.rows import Rows
from calib.mismatch.score import log_bayes_factors
from calib.mismatch.windows import moved_window, segment_columns
from calib.types import FloatArray

UNLIKELY = 1e-3
"""Windows less probable than the best by this factor are left out."""


def place_window(rows: Rows, candidate: Candidate, whitener: Whitener, y: FloatArray) -> Candidate:
    """Return a candidate for the window that overlaps most, on average over what is probable.

    Its columns in a window are sums over the segments in it (not so those of a fluctuation). No
    window is longer than half of the recording: the others are the rule there, and not it.
    """
    parts = segment_columns(rows, candidate)
    m, number, k = parts.shape
    white = whitener.project(parts.reshape(m, -1))
    gram = (white.T @ white).reshape(number, k, number, k).transpose(0, 2, 1, 3)
    total = np.zeros((number + 1, number + 1, k, k))
    total[1:, 1:] = gram.cumsum(axis=0).cumsum(axis=1)
    match = np.zeros((number + 1, k))
    match[1:] = (y @ white).reshape(number, k).cumsum(axis=0)
    # Open at one end a bias in a window would be a step, which has a name.
    low = 1 if candidate.name == "bias in a window" else 0
    first, last = np.triu_indices(number + 1, 1)
    some = (last - first <= max(number // 2, 1)) & (first >= low) & (last <= number - low)
    first, last = first[some], last[some]
    inner = total[last, last] - total[first, last] - total[last, first] + total[first, first]
    value = log_bayes_factors(inner, match[last] - match[first])
    # Every length, by its logarithm, is as likely as any other, and so is every place.
    value -= np.log(last - first) + np.log(number + 1.0 - (last - first))
    probable = value > value.max() + np.log(UNLIKELY)
    weight = np.exp(value[probable] - value.max())
    start, stop = rows.interval[first[probable], 0], rows.interval[last[probable] - 1, 1]
    return moved_window(candidate, *expected_overlap(start, stop, weight))


def expected_overlap(start: FloatArray, stop: FloatArray, weight: FloatArray) -> Interval:
    """Return the one of (n,) intervals that overlaps most, on average over their weights."""
    common = np.minimum.outer(stop, stop) - np.maximum.outer(start, start)
    hull = np.maximum.outer(stop, stop) - np.minimum.outer(start, start)
    best = int(np.argmax(np.maximum(common, 0.0) / hull @ weight))
    return float(start[best]), float(stop[best])
