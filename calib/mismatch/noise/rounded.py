"""Rounding to coarse counts: the noise that was there before, and how far means are off.

Samples are ``round(x / LSB) LSB`` with x normal around the level of a rest. Where the noise is less
than about half a count it no longer averages rounding out: a mean is off by up to half a count,
wherever between two counts the level happens to be. How far depends on that and on the noise before
rounding. The variance of the samples tells neither: near a count it is less, halfway to the next
one more. The shares of the counts do, as far as anything does:

    P(k) = Phi((k + 1/2 - x) / s) - Phi((k - 1/2 - x) / s)

References
----------
.. [1] Widrow, Kollar, "Quantization Noise", Cambridge 2008, ch. 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtr, softmax

from calib.types import FloatArray

REACH = 4
"""Counts to either side of a rest's most frequent one that are looked at."""

SIZES = np.geomspace(0.02, 1.0, 50)
"""Sizes that the noise may have, in counts: any factor is as likely."""

MOST = 1000
"""Samples that a rest counts as, at most: beyond it drifts."""

TOGETHER = 64
"""Rests that are worked on at a time."""

SHAKEN = 0.01
"""Likelihood, relative to that of its own noise, that a rest which is shaken has at any other."""

SWEPT = 8.0
"""Counts over which means of rests are spread from which these tell something anyhow."""

WHOLE = 0.05
"""Distance from a whole count, in counts, within which a sample is on it."""


class Rounding(NamedTuple):
    """Counts of ``lsb``, the noise ``sigma`` before, and by how much the means of r rests err.

    The ``error`` (r,) is what is expected of mean minus level. How large the noise was nobody knows
    for sure, and all errors go with it: of that is the ``covariance`` (r, r). What counts leave
    open by themselves is the ``variance`` (r,). The noise of the samples comes on top.
    """

    lsb: float
    sigma: float
    error: FloatArray
    covariance: FloatArray
    variance: FloatArray
    span: float
    """How far apart the means are."""

    @property
    def total(self) -> FloatArray:
        """Return the mean square of each error, (r,)."""
        return np.square(self.error) + np.diag(self.covariance) + self.variance

    @property
    def hidden(self) -> bool:
        """Whether means err by less than half of a sample's noise."""
        return float(self.total.mean()) <= (0.5 * self.sigma) ** 2

    @property
    def swept(self) -> bool:
        """Whether means are all over many counts.

        Errors that come back with every count mimic nothing that changes by many.
        """
        return self.span > SWEPT * self.lsb


def look_at_counts(rests: Sequence[FloatArray], lsb: float) -> Rounding:
    """Return what rounding makes of the means of rests.

    Each rest has a level of its own, and all one noise, but for those that are shaken: the larger
    noise of these averages rounding out better than is said.

    Parameters
    ----------
    rests : sequence of r (n,) arrays
        Samples of one channel, rest by rest. Where they are not whole counts apart (resampled to
        even times) their means err as those of rounded noise do on average [1]_.
    lsb : float
    """
    shares = np.zeros((len(rests), 2 * REACH + 1))
    span = float(np.ptp([values.mean() for values in rests]))
    for r, values in enumerate(rests):
        count = (values - values.min()) / lsb
        if np.median(np.abs(count - np.rint(count))) > WHOLE:
            sigma = float(np.sqrt(np.median([np.var(own) for own in rests])))
            off = lsb**2 / 12 * np.exp(-np.square(2 * np.pi * sigma / lsb))
            number = len(rests)
            return Rounding(
                lsb, sigma, np.zeros(number), np.zeros((number, number)), np.full(number, off), span
            )
        whole = np.rint(count).astype(np.int64)
        beside = np.clip(whole - np.bincount(whole).argmax(), -REACH, REACH)
        shares[r] = np.bincount(beside + REACH, minlength=2 * REACH + 1)
    mean = shares @ np.arange(-REACH, REACH + 1) / shares.sum(axis=1)
    shares *= np.minimum(MOST / shares.sum(axis=1, keepdims=True), 1.0)
    known, places, middle, left = np.concatenate(
        [_by_size(shares[r : r + TOGETHER]) for r in range(0, len(shares), TOGETHER)], axis=1
    )
    # Rests may well be at one place between two counts, as the bias is one: that there are so many
    # of them there counts once. What no place explains counts each time.
    known = np.logaddexp(known - known.max(axis=1, keepdims=True), np.log(SHAKEN))
    size = softmax(known.sum(axis=0) + places.mean(axis=0))
    off = mean[:, None] - middle
    # What the noise that is seen does to a mean is not counted again.
    seen = [np.var(own) / (lsb**2 * len(own)) for own in rests]
    variance = np.maximum(left @ size - seen, 0.0)
    typical = lsb * float(np.exp(size @ np.log(SIZES)))
    error = off @ size
    apart = off - error[:, None]
    return Rounding(
        lsb, typical, lsb * error, lsb**2 * (apart * size) @ apart.T, lsb**2 * variance, span
    )


def _by_size(shares: FloatArray) -> FloatArray:
    """Return what (r, k) numbers of counts tell, beside each of `SIZES`, (4, r, s).

    Their likelihood at the best level; how much more places there are at others, as a logarithm;
    the mean of the level, and its variance.
    """
    levels, width = _levels()
    edges = np.arange(-REACH, REACH) + 0.5
    below = ndtr((edges - levels[:, :, None]) / SIZES[:, None, None])
    each = np.log(np.maximum(np.diff(below, axis=2, prepend=0.0, append=1.0), 1e-12))
    likelihood = np.einsum("rk,slk->rsl", shares, each)
    known = likelihood.max(axis=2)
    likelihood += width - known[:, :, None]
    places = logsumexp(likelihood, axis=2)
    level = np.exp(likelihood - places[:, :, None])
    middle = np.einsum("rsl,sl->rs", level, levels)
    left = np.einsum("rsl,sl->rs", level, np.square(levels)) - np.square(middle)
    return np.stack((known, places, middle, left))


def _levels() -> tuple[FloatArray, FloatArray]:
    """Return the levels that a rest may have beside each of `SIZES`, and how much each stands for.

    They are in counts from its most frequent one, (s, l), the latter as logarithms. Where the next
    count is as near as the noise reaches, a small part of that changes its share.
    """
    near = SIZES[:, None] * np.linspace(-3.0, 3.0, 121)
    rest = np.tile(np.linspace(-0.6, 0.6, 25), (len(SIZES), 1))
    levels = np.clip(np.sort(np.hstack((near - 0.5, rest, near + 0.5)), axis=1), -0.6, 0.6)
    width = np.gradient(levels, axis=1)
    return levels, np.log(np.maximum(width, 1e-12))
