"""How far samples scatter about what a reference with noise of its own says of them.

More while the sensor vibrates, for that is no motion of the body. And where samples do not resolve
the motion, what happens between two of them reaches a recording and its reference unlike: they
sample at moments and through filters of their own, and an angular acceleration of which the samples
show a part only is felt whole at the end of an arm. So the variance of a sample is a sum of parts
that go with the vibration, the rate and its changes, found along with all that could explain the
differences.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import linalg

from calib.effects.base import State
from calib.mismatch.reference.colour import Blur
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray

PASSES = 8
"""How often columns and variance are fitted in turn, at most: what scatters most is reached from
what is at rest by a factor of `KNOCK` each."""

SETTLED = 1e-3
"""By how much of itself the variance of a sample may still change: ten thousand samples tell it to
a hundredth."""

KNOCK = 9.0
"""Square of a difference, relative to its variance, from which on it is a knock of its own."""

QUIETEST, LOUD = 0.2, 2.0
"""Share of a recording that is taken to be free of vibration, and the short-time variance relative
to what it is there above which there is some: that of noise alone differs by less from second to
second."""

LOOSE = 30.0
"""How large, in its typical size, an effect may be that takes its part before the rest scatters."""


NOTHING_SAID = 1e8
"""Variance, in that of others, of points whose truth is not known: a hundred standard errors are a
hundredth."""

ALIKE = 1e-13
"""Of a column's square, that rounding leaves of it beside others."""


class Scatter(NamedTuple):
    """The noise of n points on every channel, but for a factor.

    ``variance`` (n, 6) is that of slow noise; the m points that are seen show the share ``seen``
    (m, 6) of it. It is 1 but where a blur that whitens takes most of what is white away.
    """

    variance: FloatArray
    seen: FloatArray


def scatter(
    state: State,
    left: FloatArray,
    views: list[list[FloatArray]],
    *,
    blur: Blur,
    resolved: bool,
    folded: FloatArray | None = None,
    struck: FloatArray | None = None,
) -> Scatter:
    """Return how far points scatter.

    Parameters
    ----------
    state : State
        At the n points.
    left : (n, 6) array
        Recording minus model.
    views : lists of (m,) arrays, of six channels
        What the differences can have besides, each in its typical size, as the blur sees it.
    blur : Blur
        What their differences are seen through. What they scatter more than always is white.
    resolved : bool
        Whether the samples resolve the motion.
    folded : (n, k) array, optional
        Power of what is beyond the band of the differences, and partly folded into it.
    struck : (n, 2) array, optional
        Variance that knocks have on both triads. It is not fitted: knocks are few, each folds
        another share, and effects that come and go with turns would take it.
    """
    parts = _parts(state, resolved=resolved)
    if folded is not None:
        parts = np.hstack((parts, folded))
    size = parts.mean(axis=0)
    parts = parts[:, size > 0] / size[size > 0]
    variance = np.empty((len(parts), len(CHANNELS)))
    shown = np.ones((len(blur.seen), len(CHANNELS)))
    same = np.ones(len(parts))
    always = blur.see_columns([(name, same) for name in CHANNELS])
    left = blur.see(left)
    for c, own in enumerate(views):
        matrix = blur.matrices[c // 3]
        design, y = np.stack([*own, *always[c]], axis=1), left[:, c]
        heard = np.stack([_spread(part, blur.heard[c // 3]) for part in parts.T], axis=1)
        seen = heard[blur.seen] if blur.whitens else matrix.power(2) @ heard
        counts = blur.counts(c)
        if not counts.any():
            variance[:, c] = 1.0
            continue
        knock, white = np.zeros(len(parts)), blur.white[c // 3]
        if struck is not None:
            knock = _spread(struck[:, c // 3], blur.heard[c // 3])
        knocks = knock[blur.seen] if blur.whitens else matrix.power(2) @ knock
        share = _of_parts(
            seen[counts], y[counts], design[counts], blur.power[c // 3], white * knocks[counts]
        )
        known = seen @ share + white * knocks
        share[1:] /= white
        variance[:, c] = heard @ share + knock
        # A point through which nothing is seen shows no share of anything.
        whole = seen @ share + knocks
        shown[:, c] = np.divide(known, whole, out=np.ones(len(whole)), where=whole > 0)
    return Scatter(variance, shown)


def silenced(unknown: BoolArray) -> Scatter:
    """Return the scatter of points that are as noisy as each other, but for n that say nothing."""
    variance = np.where(unknown, NOTHING_SAID, 1.0)[:, None] * np.ones(len(CHANNELS))
    return Scatter(variance, np.where(unknown, 0.0, 1.0)[:, None] * np.ones(len(CHANNELS)))


def _parts(state: State, *, resolved: bool) -> FloatArray:
    """Return what the variance may go with, (n, k): the same always, vibration, rate, changes."""
    same = np.ones(len(state.time))
    vibration = _shaking(state)
    if resolved:
        return np.stack((same, vibration), axis=1)
    rate = np.square(state.rate).sum(axis=1)
    turning = np.square(state.rate_dot).sum(axis=1)
    bent = [np.square(_bend(values)).sum(axis=1) for values in (state.rate, state.force)]
    return np.stack((same, vibration, rate, np.square(rate), turning, *bent), axis=1)


def _shaking(state: State) -> FloatArray:
    """Return the variance of what shakes the sensor, (n,): more than its own noise explains.

    That noise is always there. Counted as vibration it would be the part that is always the same
    once more, and which of the two it is would be left to chance.
    """
    if state.vibration is None:
        return np.zeros(len(state.time))
    total = state.vibration.sum(axis=1)
    return np.asarray(np.maximum(total - LOUD * np.quantile(total, QUIETEST), 0.0))


def _spread(values: FloatArray, heard: FloatArray) -> FloatArray:
    """Return (n,) variances as they are heard, what is before the first and after the last alike.

    What shakes is a thousand times louder than what does not: its echo is heard beside it.
    """
    reach = len(heard) // 2
    return np.convolve(np.pad(values, reach, mode="edge"), heard, mode="valid")


def _bend(values: FloatArray) -> FloatArray:
    """Return second differences, the first and the last as their neighbours."""
    return np.pad(np.diff(values, n=2, axis=0), ((1, 1), (0, 0)), mode="edge")


def _of_parts(
    parts: FloatArray, y: FloatArray, design: FloatArray, power: float, known: FloatArray
) -> FloatArray:
    """Return how much of each part is in the variance of y, beside what the design explains.

    Of that variance some is ``known``.
    """
    from scipy.optimize import nnls  # a fifth of a second to import

    least = 1e-12 + 1e-6 * float(np.mean(np.square(y)))
    share, left = np.zeros(parts.shape[1]), y
    # Half of a normal variable's squares are below 0.455 of their mean.
    variance = max(float(np.median(np.square(y))) / 0.455, least) + known
    ridge = np.eye(design.shape[1]) / LOOSE**2
    for _ in range(PASSES):
        square = np.minimum(np.square(left), KNOCK * variance)
        share = nnls(parts / variance[:, None], np.maximum(square - known, 0.0) / variance)[0]
        before, variance = variance, np.maximum(parts @ share + known, least)
        if np.abs(variance / before - 1.0).max() < SETTLED:
            break
        # Neighbours are alike by the blur: so many of them are worth one.
        weighted = design * (power / variance)[:, None]
        normal = design.T @ weighted + ridge
        size = np.sqrt(np.diag(normal))
        # Columns may be the same but for rounding.
        factor = linalg.cho_factor(normal / np.outer(size, size) + ALIKE * np.eye(len(size)))
        left = y - design @ (linalg.cho_solve(factor, weighted.T @ y / size) / size)
    # At rest nothing else is left of it, and no sample is without noise.
    share[0] = max(share[0], least)
    return np.asarray(share)
