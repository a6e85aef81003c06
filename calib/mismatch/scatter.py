"""How far samples scatter about what a reference says of a motion that samples do not resolve.

What happens between two samples reaches a recording and its reference unlike: they sample at
moments and through filters of their own, and an angular acceleration of which the samples show a
part only is felt whole at the end of an arm. So the differences scatter more while the motion is
fast, and while it changes from one sample to the next. The variance of a sample is a sum of such
parts, found along with all that could explain the differences.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from calib.effects.base import State
from calib.mismatch.colour import Blur
from calib.recording import CHANNELS
from calib.types import FloatArray

PASSES = 6
"""How often columns and variance are fitted in turn."""

KNOCK = 25.0
"""Square of a difference, relative to its variance, from which on it is a knock of its own."""

LOOSE = 30.0
"""How large, in its typical size, an effect may be that takes its part before the rest scatters."""


def scatter(
    state: State, left: FloatArray, columns: list[tuple[str, FloatArray]], *, blur: Blur
) -> FloatArray:
    """Return the variance of the noise of n points on every channel, (n, 6).

    Parameters
    ----------
    state : State
        At the n points.
    left : (n, 6) array
        Recording minus model.
    columns : list of (channel, (n,) values)
        What the differences can have besides, each in its typical size.
    blur : Blur
        The n points scatter independently, and this is what their differences are seen through.
    """
    parts = _parts(state)
    size = parts.mean(axis=0)
    parts = parts[:, size > 0] / size[size > 0]
    out = np.empty((len(parts), len(CHANNELS)))
    for c, name in enumerate(CHANNELS):
        matrix = blur.matrices[c // 3]
        own = [values for channel, values in columns if channel == name]
        design = matrix @ np.stack([*own, np.ones(len(parts))], axis=1)
        y = matrix @ left[:, c]
        share = _of_parts(matrix.power(2) @ parts, y, design, blur.power)
        out[:, c] = parts @ share
    return out


def _parts(state: State) -> FloatArray:
    """Return what the variance may go with, (n, k): the same always; rate, and its changes."""
    rate = np.square(state.rate).sum(axis=1)
    turning = np.square(state.rate_dot).sum(axis=1)
    bent = [np.square(_bend(values)).sum(axis=1) for values in (state.rate, state.force)]
    return np.stack((np.ones(len(rate)), rate, np.square(rate), turning, *bent), axis=1)


def _bend(values: FloatArray) -> FloatArray:
    """Return second differences, the first and the last as their neighbours."""
    return np.pad(np.diff(values, n=2, axis=0), ((1, 1), (0, 0)), mode="edge")


def _of_parts(parts: FloatArray, y: FloatArray, design: FloatArray, power: float) -> FloatArray:
    """Return how much of each part is in the variance of y, beside what the design explains."""
    from scipy.optimize import nnls  # a fifth of a second to import

    least = 1e-12 + 1e-6 * float(np.mean(np.square(y)))
    share, left = np.zeros(parts.shape[1]), y
    variance = np.full(len(y), max(float(np.mean(np.square(y))), least))
    ridge = np.eye(design.shape[1]) / LOOSE**2
    for k in range(PASSES):
        square = np.minimum(np.square(left), KNOCK * variance) if k else np.square(left)
        share = nnls(parts / variance[:, None], square / variance)[0]
        variance = np.maximum(parts @ share, least)
        # Neighbours are alike by the blur: so many of them are worth one.
        weighted = design * (power / variance)[:, None]
        factor = linalg.cho_factor(design.T @ weighted + ridge)
        left = y - design @ linalg.cho_solve(factor, weighted.T @ y)
    return np.asarray(share)
