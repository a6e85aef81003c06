"""Evidence for what was left out: closed-form Bayes factors that are e-values.

A hypothesis adds columns ``Z`` (whitened, with all that is fitted projected out, in units of their
typical size) with coefficients drawn from ``N(0, s²)``, s running over `SCALES`. Against the
residual y alone its Bayes factor is

    log B(s) = -1/2 log det(I + s² Z'Z) + 1/2 y'Z (I/s² + Z'Z)^-1 Z'y.

Averaged over scales, places and shapes with weights that sum to one it has expectation at most one
where nothing was left out, so that P(B > 100) < 1 %: the price of all looks is in the weights.

Of an effect most of the weight is on sizes that would show, and not by far. Smaller ones explain
nothing, and larger ones need no weight; both would cost those between them what they hold. Which
these are, columns and noise say, so that the expectation is the same. What is counted (samples that
are lost) comes whole.

References
----------
.. [1] Vovk, Wang, "E-values: calibration, combination and applications", Ann. Statist. 49, 2021.
.. [2] Liang et al., "Mixtures of g priors for Bayesian variable selection", JASA 103, 2008.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack
from scipy.special import log_ndtr

from calib.types import BoolArray, FloatArray

PRESENT = 0.6
"""How far from 1 the coefficient of what is there or not may be: neighbouring cut-off frequencies
on the grid differ by a factor of 2, and what a low-pass takes away goes with their inverse or its
square."""

LARGE = 30.0
"""Size relative to the typical one beyond which a number is hardly physical."""

SCALES = np.append(np.geomspace(0.01, 3.0, 8), [10.0, LARGE, 100.0, 300.0])
"""Sizes that are tried, relative to the typical one; the last for what is far beyond typical. A
part may be broken, and what is typical is known to a power of ten: the shape must speak then."""

SHARES = np.append(np.full(8, 0.1175), [0.02, 0.02, 0.01, 0.01])
"""How probable each of them is."""

_LOG_SHARES = np.log(SHARES)

SHOWN = (2.0, 2000.0)
"""Mean powers, in units of the noise, between which a scale is one that would show, not by far."""

FAINT = 0.1
"""How much of its share any other scale of an effect keeps."""

NOTHING = 1e-290
"""Square of a length that rounding leaves of none, and that has no inverse."""

ROUNDED = 1e-12
"""Share of its power that rounding may leave of a column that others make up."""

ALL_AT_ONCE = 12
"""Columns of candidates up to which these are reduced side by side, unless they are few; of more,
one by one."""


def single_factors(power: FloatArray, along: FloatArray, sought: BoolArray) -> FloatArray:
    """Return log B of single columns, from their power and their match with the residual."""
    strength = np.square(SCALES)[:, None] * power
    gain = 0.5 * np.square(along) / np.maximum(power, 1e-300) * strength / (1 + strength)
    return _average(gain - 0.5 * np.log1p(strength) + log_shares(power, sought))


def log_shares(power: FloatArray, sought: BoolArray) -> FloatArray:
    """Return the logarithms of the shares that n hypotheses give to the `SCALES`, (scales, n).

    Parameters
    ----------
    power : (n,) array
        Of their columns, whitened and projected, in the mean over the coefficients.
    sought : (n,) array of bool
        Those that are looked for at sizes that would show.
    """
    if not sought.any():
        return np.broadcast_to(_LOG_SHARES[:, None], (len(SCALES), len(power)))
    strength = np.square(SCALES)[:, None] * power
    shows = (strength > SHOWN[0]) & (strength < SHOWN[1])
    shares = SHARES[:, None] * np.where(shows | ~sought, 1.0, FAINT)
    return np.asarray(np.log(shares / shares.sum(axis=0)))


def log_bayes_factor(columns: FloatArray, y: FloatArray) -> float:
    """Return log B of one rival, its whitened projected columns given."""
    gram, match = columns.T @ columns, y @ columns
    return float(log_bayes_factors(gram[None], match[None], np.zeros(1, bool))[0])


def most_told(gram: FloatArray, match: FloatArray) -> float:
    """Return the log-likelihood that any combination of columns can gain at most.

    Log B is no more, whatever combines them. It is not known, and infinite, where rounding leaves
    no positive Gram matrix.
    """
    known = gram + np.diag(ROUNDED * np.diag(gram) + np.finfo(float).tiny)
    root, failed = lapack.dpotrf(known, lower=1)
    if failed:
        return np.inf
    told, _ = lapack.dtrtrs(root, match, lower=1)
    return 0.5 * float(told @ told)


def present_factors(power: FloatArray, along: FloatArray) -> FloatArray:
    """Return log B of single columns with a positive coefficient from ``N(1, PRESENT²)``."""
    strength = PRESENT**2 * power
    more = along - power
    gain: FloatArray = along - 0.5 * power + 0.5 * PRESENT**2 * np.square(more) / (1 + strength)
    mean = 1.0 + PRESENT**2 * more / (1 + strength)
    positive = log_ndtr(mean * np.sqrt(1 + strength) / PRESENT) - log_ndtr(1.0 / PRESENT)
    return np.where(power > 0, gain - 0.5 * np.log1p(strength) + positive, 0.0)


def log_bayes_factors(gram: FloatArray, match: FloatArray, sought: BoolArray) -> FloatArray:
    """Return log B of n hypotheses with Gram matrices (n, k, k) and matches (n, k).

    In a basis that begins with the match and has a tridiagonal Gram matrix T, only the corner of
    the inverse of ``I + s² T`` counts, which elimination from the other end gives with the
    determinant, for all scales at once.
    """
    diagonal, beside = _tridiagonal(gram, match)
    square = np.square(SCALES)[:, None]
    # What is left of a pivot is never below one: the rest is rounding.
    pivot = np.maximum(1.0 + square * diagonal[-1], 1.0)
    log_det = np.log(pivot)
    for d, b in zip(diagonal[-2::-1], beside[:0:-1], strict=True):
        pivot = np.maximum(1.0 + square * (d - square * (np.square(b) / pivot)), 1.0)
        log_det += np.log(pivot)
    gain = square * (np.square(beside[0]) / pivot)
    power = np.einsum("nkk->n", gram) / gram.shape[1]
    return _average(0.5 * (gain - log_det) + log_shares(power, sought))


def _tridiagonal(gram: FloatArray, match: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return n Gram matrices as tridiagonal ones: their diagonals and what is beside, (k, n) each.

    The first of what is beside is the length of the match, which lies along the first direction:
    Householder's reduction of a matrix that has the match as its first row leaves that row alone.
    """
    n, k = match.shape
    one_by_one = k > min(ALL_AT_ONCE, n)
    # Else the hypotheses lie side by side in memory, so that each step is one of long rows.
    left = np.zeros((k + 1, k + 1, n), order="F" if one_by_one else "C")
    left[0, 1:] = left[1:, 0] = match.T
    left[1:, 1:] = gram.transpose(1, 2, 0)
    diagonal, beside = np.empty((k + 1, n)), np.empty((k, n))
    if one_by_one:
        for i in range(n):
            one = lapack.dsytrd(left[:, :, i], lower=1, overwrite_a=1)
            diagonal[:, i], beside[:, i] = one[1:3]
        return diagonal[1:], beside
    for j in range(k):
        diagonal[j], first, left = left[0, 0], left[1:, 0], left[1:, 1:]
        beside[j] = size = np.sqrt(np.einsum("in,in->n", first, first))
        if j < k - 1:
            mirror = first.copy()
            mirror[0] += np.copysign(size, first[0])
            square = np.einsum("in,in->n", mirror, mirror)
            mirror *= np.sqrt(2.0 / np.where(square > NOTHING, square, 1.0))
            along = np.einsum("ijn,jn->in", left, mirror)
            along -= 0.5 * np.einsum("in,in->n", along, mirror) * mirror
            left -= mirror[:, None] * along
            left -= along[:, None] * mirror
    diagonal[k] = left[0, 0]
    return diagonal[1:], beside


def average_of_scales(log_factors: FloatArray) -> FloatArray:
    """Return log B over all `SCALES`, from its values (n, ...) at each."""
    shares = _LOG_SHARES.reshape(-1, *[1] * (log_factors.ndim - 1))
    return _average(log_factors + shares)


def _average(log_factors: FloatArray) -> FloatArray:
    """Return the logarithm of the sum over the first axis of factors that hold their shares."""
    top = log_factors.max(axis=0)
    mean: FloatArray = top + np.log(np.exp(log_factors - top).sum(axis=0))
    return mean
