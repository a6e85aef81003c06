"""Tails of a channel's noise: how far means of a few samples go by chance, if it is not normal."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from calib.faults import ROBUST
from calib.types import FloatArray


def _scale(freedom: FloatArray) -> FloatArray:
    """Return what makes the median of Student's t, without sign, that of a normal variable."""
    return np.asarray(ndtri(0.75) / stdtrit(freedom, 0.75))


FREEDOM = np.array([4.5, 5.0, 6.0, 7.0, 8.0, 10.0, 14.0, 20.0, 40.0, 100.0])
BEYOND_THREE = 2.0 * stdtr(FREEDOM, -3.0 / _scale(FREEDOM))
"""Tails that noise has, and how many are beyond three noises then."""


def usual_of(off: FloatArray, step: FloatArray) -> FloatArray:
    """Return the noise of what is ``off`` (n, 6), (6,), and infinite where there is none.

    Counts, of size ``step`` (6,), make it multiples of half a count, and its median wrong by half
    that.
    """
    usual = ROBUST * (np.median(np.abs(off), axis=0) + 0.25 * step)
    return np.where(usual > 0.0, usual, np.inf)


def tails(off: FloatArray, step: FloatArray) -> FloatArray:
    """Return the degrees of freedom of Student's t, (6,), with the tails that channels have.

    By how many samples are ``off`` (n, 6) their neighbours' mean by more than three noises:
    infinite for normal noise, or next to it.
    """
    share = (off > 3.0 * usual_of(off, step)).mean(axis=0)
    normal = 2.0 * ndtr(-3.0)
    plain = share > normal + 3.0 * np.sqrt(normal / len(off))
    return np.where(plain, np.interp(-share, -BEYOND_THREE, FREEDOM), np.inf)


def beyond(freedom: FloatArray, width: int, chance: float) -> FloatArray:
    """Return what means of so many samples are beyond by such a chance, (6,), in noises.

    A mean of n has an n-th of the excess kurtosis, which is ``6 / (v - 4)`` for Student's t of v
    degrees of freedom.
    """
    of_mean = 4.0 + width * (freedom - 4.0)
    limit = np.full(len(freedom), -float(ndtri(chance)))
    heavy = np.isfinite(of_mean)
    limit[heavy] = -stdtrit(of_mean[heavy], chance) * _scale(of_mean[heavy])
    return limit
