"""One disturbance that the axes of a triad share: a supply, a cable, or what shakes the package.

It has one course in time, and each axis its own share of it. As three disturbances it would need
three courses, and on one axis it shows but in part.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.special import logsumexp

from calib.mismatch.hypotheses.factors import log_bayes_factors
from calib.types import FloatArray

_SIGNS = [d for d in product((-1, 0, 1), repeat=3) if d > (0, 0, 0) and d.count(0) < 2]

DIRECTIONS = np.array(_SIGNS) / np.linalg.norm(_SIGNS, axis=1, keepdims=True)
"""Shares that three axes may have, unit vectors up to their sign. One axis alone is a channel."""


def with_shared(factors: FloatArray, gram: FloatArray, match: FloatArray) -> FloatArray:
    """Return log B where each axis may have a course of its own, or a share of one: both as likely.

    Parameters
    ----------
    factors : (n,) array
        log B of a course on each axis.
    gram, match : (n, 3 k, 3 k) and (n, 3 k) arrays
        As `log_bayes_factors` takes them, the k columns of one axis after those of the other.
    """
    each = factors_of_shares(gram, match)
    shared = np.logaddexp.reduce(each, axis=1) - np.log(each.shape[1])
    return np.asarray(np.logaddexp(factors, shared) - np.log(2.0))


def factors_of_shares(gram: FloatArray, match: FloatArray) -> FloatArray:
    """Return log B of n hypotheses with shares along each of the `DIRECTIONS`, (n, directions)."""
    n, k = len(match), match.shape[1] // 3
    axes = gram.reshape(n, 3, k, 3, k)
    inner = np.einsum("sa,sb,naibj->nsij", DIRECTIONS, DIRECTIONS, axes, optimize=True)
    along = DIRECTIONS @ match.reshape(n, 3, k)
    flat = inner.reshape(-1, k, k), along.reshape(-1, k)
    return np.asarray(log_bayes_factors(*flat, np.zeros(len(flat[0]), bool)).reshape(n, -1))


def likely_share(white: FloatArray, y: FloatArray) -> FloatArray | None:
    """Return the most probable of the `DIRECTIONS`; None where a course on each axis is more so.

    ``white`` are (m, 3 k) whitened projected columns, and ``y`` the residual.
    """
    gram, match = (white.T @ white)[None], (y @ white)[None]
    shared = factors_of_shares(gram, match)[0]
    apart = log_bayes_factors(gram, match, np.zeros(1, bool))[0]
    if logsumexp(shared) - np.log(len(shared)) < apart:
        return None
    return np.asarray(DIRECTIONS[int(np.argmax(shared))])


def likely_course(columns: FloatArray, white: FloatArray, y: FloatArray) -> FloatArray:
    """Return the (m, k) columns of one course where that is more probable, else all (m, 3 k)."""
    share = likely_share(white, y)
    return columns if share is None else one_course(columns, share)


def one_course(columns: FloatArray, share: FloatArray) -> FloatArray:
    """Return the (..., k) columns of one course, from (..., 3 k) of one on each axis."""
    axes = columns.reshape(*columns.shape[:-1], len(share), -1)
    return np.asarray(np.einsum("a,...ak->...k", share, axes))
