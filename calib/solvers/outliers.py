"""Which poses or segments do not belong: Rosner's sequential test for a weighted linear fit."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri, stdtr

from calib.types import BoolArray, FloatArray

LEVEL = 0.01
"""Probability of leaving anything out of a clean recording, per test."""
FEW = 60
"""Up to here all pairs of rows are tried."""
LEAST_REST = 1e-6
"""One minus leverage of a row that determines a parameter alone: it cannot be judged."""
MANY = 1000
"""From here on leverages are small, and a robust scale finds all outliers at once."""


def between_variance(residual: FloatArray, variance: FloatArray, freedom: int) -> float:
    """Return the variance t² >= 0, beside the known ones, that the residuals ask for.

    Solves ``sum(r² / (variance + t²)) = freedom`` (Paule and Mandel's estimate); Newton's method
    from 0 climbs to the root of this convex falling function without passing it.
    """
    if freedom <= 0:
        return 0.0
    square = residual**2
    # Relative to the smallest variance that can matter, or exact data would divide by zero.
    least = max(float(square.sum()) / freedom * 1e-12, np.finfo(float).tiny)
    known = np.maximum(variance, least)
    extra = 0.0
    for _ in range(50):
        weight = 1.0 / (known + extra)
        excess = float(square @ weight) - freedom
        if excess <= 1e-6 * freedom:
            break
        extra += excess / float(square @ weight**2)
    return extra


def find_outliers(residual: FloatArray, jacobian: FloatArray, variance: FloatArray) -> BoolArray:
    """Return a mask of the rows that do not belong to the model.

    Model: ``residual = jacobian @ x + e``, ``var e = variance + t²`` with t² unknown and common.

    Sets of one, two, three ... rows, up to a fifth of all, are taken out: those without which the
    rest fits best, two found at a time where that is quick, so that two outliers cannot hide each
    other. The outliers are the largest set of which the rest, fitted alone, rejects every member
    (by its predicted residual, at `LEVEL` over all rows).

    Parameters
    ----------
    residual : (n,) array
    jacobian : (n, p) array
        Of full column rank.
    variance : (n,) array
        What is known of the variances: a lower bound.

    References
    ----------
    .. [1] B. Rosner, "Percentage Points for a Generalized ESD Many-Outlier Procedure",
       Technometrics 25(2), 1983 (the number of outliers is the last one that is significant).
    .. [2] R. D. Cook, S. Weisberg, Residuals and Influence in Regression, 1982, section 2.2
       (residuals without one row, or a set of rows).
    """
    n, p = jacobian.shape
    if n > MANY:
        return _bulk(residual, variance)
    width = 2 if n <= FEW else 1
    sets: list[BoolArray] = [np.zeros(n, bool)]
    found = sets[0]
    for size in range(1, min(n // 5, (n - p) // 3) + 1):
        base = sets[max(0, size - width)]
        active = np.flatnonzero(~base)
        error, hat = _refit(residual[active], jacobian[active], variance[active])
        out = base.copy()
        out[active[_worst_pair(error, hat) if size >= width > 1 else _worst(error, hat)]] = True
        sets.append(out)
        if _rejected(residual, jacobian, variance, out).all():
            found = out
    return found


def _worst(error: FloatArray, hat: FloatArray) -> int:
    """Return the row without which the weighted squares of the others are least."""
    rest = 1.0 - np.einsum("ij,ij->i", hat, hat)
    return int(np.argmax(np.where(rest > LEAST_REST, error**2 / np.maximum(rest, LEAST_REST), 0)))


def _worst_pair(error: FloatArray, hat: FloatArray) -> list[int]:
    """Return the two rows without which the weighted squares of the others are least."""
    projection = hat @ hat.T
    rest = 1.0 - np.diag(projection)
    determinant = np.outer(rest, rest) - projection**2
    square = error**2
    fall = np.add.outer(square * 0, square) * rest[:, None]
    fall = fall + fall.T + 2 * np.outer(error, error) * projection
    usable = (determinant > LEAST_REST) & (rest > LEAST_REST) & (rest > LEAST_REST)[:, None]
    np.fill_diagonal(usable, val=False)
    fall = np.where(usable, fall / np.where(usable, determinant, 1.0), -1.0)
    return [int(k) for k in np.unravel_index(np.argmax(fall), fall.shape)]


def _refit(
    residual: FloatArray, jacobian: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return standardised residuals of the fit, and Q of which ``Q @ Q.T`` is the hat matrix."""
    weight = _weights(residual, jacobian, variance)
    q, _ = np.linalg.qr(jacobian * weight[:, None])
    scaled = residual * weight
    return scaled - q @ (q.T @ scaled), q


def _weights(residual: FloatArray, jacobian: FloatArray, variance: FloatArray) -> FloatArray:
    """Return ``1 / sqrt(variance + t²)`` with t² from the fit's own residuals."""
    freedom = len(residual) - jacobian.shape[1]
    extra = 0.0
    for _ in range(3):
        weight = 1.0 / np.sqrt(np.maximum(variance + extra, np.finfo(float).tiny))
        q, _ = np.linalg.qr(jacobian * weight[:, None])
        scaled = residual * weight
        error = (scaled - q @ (q.T @ scaled)) / weight
        new = between_variance(error, variance, freedom)
        if abs(new - extra) <= 0.02 * (new + float(variance.mean())):
            break
        extra = new
    return np.asarray(1.0 / np.sqrt(np.maximum(variance + extra, np.finfo(float).tiny)))


def _rejected(
    residual: FloatArray, jacobian: FloatArray, variance: FloatArray, out: BoolArray
) -> BoolArray:
    """Return, for each row that is out, whether the fit of the others rejects it."""
    keep = ~out
    weight = _weights(residual[keep], jacobian[keep], variance[keep])
    q, r = np.linalg.qr(jacobian[keep] * weight[:, None])
    size = np.abs(np.diag(r))
    if size.min(initial=np.inf) < 1e-9 * size.max(initial=0.0):
        return np.zeros(int(out.sum()), bool)  # nothing could be said without them
    predict = np.linalg.solve(r.T, jacobian[out].T).T
    error = residual[out] - predict @ (q.T @ (residual[keep] * weight))
    freedom = int(keep.sum()) - jacobian.shape[1]
    # The extra variance is the same for the rows that are out.
    extra = float(np.mean(1.0 / weight**2 - variance[keep]))
    spread = np.square(predict).sum(axis=1) + variance[out] + max(extra, 0.0)
    rejected: BoolArray = (
        2 * stdtr(freedom, -np.abs(error) / np.sqrt(spread)) * len(residual) < LEVEL
    )
    return rejected


def _bulk(residual: FloatArray, variance: FloatArray) -> BoolArray:
    """Return the rows beyond the largest of n normal deviates, in units of a robust scale."""
    sigma = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    scaled = np.abs(residual) / sigma
    scale = max(1.0, float(np.median(scaled)) / ndtri(0.75))
    far: BoolArray = scaled > scale * -ndtri(LEVEL / 2 / len(residual))
    return far
