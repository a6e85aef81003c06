"""Moments at which samples are too few for a motion.

Where a turn begins at a constant pace, or a hand strikes, a motion has a corner: the spline through
its samples rounds that off, as a low-pass of the sensor would, for some samples about it. What
trembles faster than every third sample is followed nowhere.
"""

from __future__ import annotations

import numpy as np
from scipy.special import binom

from calib.recording import Recording
from calib.types import BoolArray, FloatArray

ORDER = 24
"""Of the differences that show what a spline does not follow, relative to the fastest signal that
samples can have. Of a sinusoid at a quarter of the rate they leave 2e-4, as much as the spline errs
by; of a slower one, less than any noise. About a corner the spline errs by three times as much."""

SPREAD = 5
"""Samples over which differences are taken together: they pass through zero."""

FOLLOWED = 0.1
"""Size of the differences, in standard deviations of the noise, up to which a spline follows: it
errs by a third of one then."""

LONG, SHARE = 2 * ORDER, 0.02
"""Samples of a run that corners do not make, not even two, and the share of the samples in such
runs from which on it is no exception."""

MOVES, HALF = 0.5, 0.5
"""rad/s from which on a motion is one, and the share of it that must be followed."""


def unfollowed(recording: Recording, noise: FloatArray) -> BoolArray:
    """Return the samples (n,) about which a spline errs beside noise (2,) of both triads."""
    kernel = binom(ORDER, np.arange(ORDER + 1)) * np.resize([1.0, -1.0], ORDER + 1) / 2.0**ORDER
    out = np.zeros(len(recording), bool)
    inner = slice(ORDER // 2, -(ORDER // 2))
    window = np.full(SPREAD, 1.0 / SPREAD)
    for signals, usual in zip((recording.accel, recording.gyro), noise, strict=True):
        square = np.zeros(len(recording))
        if len(recording) <= ORDER:
            continue
        for own in signals.T:
            square[inner] += np.square(np.convolve(own, kernel, mode="valid"))
        out |= np.convolve(square, window, mode="same") > 3.0 * (FOLLOWED * usual) ** 2
    return out


def is_common(unfollowed: BoolArray, rate: FloatArray) -> bool:
    """Whether samples (n,) that a spline does not follow are more than corners here and there.

    ``rate`` (n, 3) are their rates of rotation, of which most must be left.
    """
    edges = np.flatnonzero(np.diff(unfollowed, prepend=False, append=False)).reshape(-1, 2)
    length = np.diff(edges, axis=1)
    moves = np.linalg.norm(rate - np.median(rate, axis=0), axis=1) > MOVES
    long = length[length > LONG].sum() > SHARE * len(unfollowed)
    return bool(long or unfollowed[moves].sum() > HALF * moves.sum())
