"""Flicker of a sensor within windows, beside which what is slow there is judged.

The cosine k = 1, 2, ... of unit length over n points with white noise of variance v has that
variance. Under 1/f noise of instability B, one-sided density ``B² / (pi f)``, it has more::

    v + B² n / (pi k)

since the cosine is at f = k / (2 T), and T / n is the time between points. The means of windows
have the drift as levels of their own; within a window a quiet part flickers by several times the
white noise at the slowest cosines, and that would be significant as whatever is slow there.

Which instability a channel has follows from the slowest cosines of its windows, without what the
shapes that effects have there take of them. The windows are as those of a Student distribution: in
one of them something else may happen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calib.mismatch.noise.sensornoise import DRIFT, SPREAD
from calib.recording import CHANNELS
from calib.types import FloatArray

SLOWEST = 8
"""Cosines of a window that tell of its flicker."""

BESIDE = 32
"""Cosines whose flicker can be seen in these, beside shapes that have both."""

LEFT = 0.5
"""Of a cosine the share that shapes leave, at least, so that it tells."""

FREEDOM = 20.0
"""Degrees of freedom of the Student distribution of windows. Of normal ones it makes the
level lower by 7 %."""

GRID = np.geomspace(1e-4, 1e8, 481)
"""Levels that are tried, relative to the expected one."""


@dataclass(frozen=True, eq=False)
class Slow:
    """What a window has left of its slowest cosines, beside shapes.

    ``square`` (k,) are the squares, ``white`` and ``flicker`` (k,) their variances under white
    noise of a variance of one and under an instability of one.
    """

    square: FloatArray
    white: FloatArray
    flicker: FloatArray


def slow_left(rest: FloatArray, mean: FloatArray, shapes: FloatArray) -> Slow:
    """Return what is left of the slowest cosines in a window of n points.

    Parameters
    ----------
    rest : (n,) array
        The differences without their part in mean and shapes.
    mean, shapes : (n, r) and (n, s) arrays
        Orthonormal.
    """
    cosines = _slowest_cosines(len(rest))
    known = np.column_stack((cosines @ mean, cosines @ shapes))
    slowest = min(SLOWEST, len(cosines))
    kept = np.eye(len(known))[:slowest] - known[:slowest] @ known.T
    white = np.diagonal(kept)
    tells = white > LEFT
    square = np.square(cosines[:slowest] @ rest)
    flicker = np.square(kept) @ _of_cosines(len(rest))[: len(known)]
    return Slow(square[tells], white[tells], flicker[tells])


@lru_cache(maxsize=8)
def _slowest_cosines(n: int) -> FloatArray:
    """Return the `BESIDE` slowest cosines of unit length over n points, one in each row."""
    order = np.arange(1, min(BESIDE + 1, n))[:, None]
    return np.asarray(np.sqrt(2.0 / n) * np.cos(np.pi / n * order * (np.arange(n) + 0.5)))


def flicker_of(shapes: Sequence[FloatArray]) -> FloatArray:
    """Return the variances (k,) of projections on k unit vectors, for an instability of one."""
    from scipy import fft  # only comparisons need it

    length = np.array([len(x) for x in shapes], np.int64)
    out = np.empty(len(shapes))
    for n in np.unique(length).tolist():
        own = np.flatnonzero(length == n)
        part = fft.dct(np.stack([shapes[i] for i in own.tolist()]), norm="ortho")[:, 1:]
        out[own] = np.square(part) @ _of_cosines(n)
    return out


def flicker_levels(
    slow: list[dict[int, Slow]], noise: FloatArray, interval: FloatArray
) -> FloatArray:
    """Return the squares (6,) of the instabilities, from windows with points `interval` (k,) apart.

    Parameters
    ----------
    slow : six dict of {window: Slow}
    noise : (k, 6) array
    interval : (k,) array, s
    """
    out = np.zeros(len(CHANNELS))
    for c, own in enumerate(slow):
        if own:
            at = list(own)
            density = 2.0 * np.median(noise[at, c] * interval[at])
            expected = DRIFT[CHANNELS[c].split(".")[0]] ** 2 * density
            out[c] = _level(list(own.values()), noise[at, c], expected)
    return out


def _level(windows: list[Slow], noise: FloatArray, expected: float) -> float:
    """Return the square of a channel's instability.

    Parameters
    ----------
    windows : list of k Slow
    noise : (k,) array
        Variance of the points of each, white part.
    expected : float
        What the prior is centred on.
    """
    level = expected * GRID
    log = -0.5 * np.square(np.log(GRID) / SPREAD)
    for slow, white in zip(windows, noise.tolist(), strict=True):
        variance = white * slow.white + level[:, None] * slow.flicker
        total = (slow.square / variance).sum(axis=1)
        log -= 0.5 * np.log(variance).sum(axis=1)
        log -= 0.5 * (FREEDOM + len(slow.square)) * np.log1p(total / FREEDOM)
    return float(level[np.argmax(log)])


def _of_cosines(n: int) -> FloatArray:
    """Return the variance of the cosines 1 to n - 1 over n points, for an instability of one."""
    return n / (np.pi * np.arange(1.0, n))
