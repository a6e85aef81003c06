"""Which poses or segments do not belong: Rosner's test, carried over to a weighted linear fit."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri, stdtr

from calib.types import BoolArray, FloatArray

LEVEL = 0.01
"""Probability of leaving anything out of a clean recording, per test."""
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

    The worst row, by its externally studentised residual (which takes its leverage into account),
    is taken out, the rest is fitted again, and so on up to a fifth of the rows; the outliers are
    the rows up to the *last* step at which the one taken out was significant, so that two outliers
    cannot hide each other. Rows that fit what the others say are put back.

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
       Technometrics 25(2), 1983.
    .. [2] R. D. Cook, S. Weisberg, Residuals and Influence in Regression, 1982, eq. (2.2.8).
    """
    n, p = jacobian.shape
    out = np.zeros(n, bool)
    if n > MANY:
        return _bulk(residual, variance)
    most = min(n // 5, (n - p) // 3)
    order: list[int] = []
    significant = 0
    active = np.arange(n)
    for step in range(most):
        error, leverage, extra = _refit(residual[active], jacobian[active], variance[active])
        freedom = len(active) - p
        rest = np.maximum(1.0 - leverage, 1e-9)
        outside = (float(error @ error) - error**2 / rest) / (freedom - 1)
        # Known variances are a lower bound: what is left must not look better than that.
        known = variance[active] / np.maximum(variance[active] + extra, np.finfo(float).tiny)
        t = np.abs(error) / np.sqrt(rest * np.maximum(outside, known))
        worst = int(np.argmax(np.where(leverage < 1 - 1e-6, t, 0.0)))
        if 2 * stdtr(freedom - 1, -t[worst]) * len(active) < LEVEL:
            significant = step + 1
        order.append(int(active[worst]))
        active = np.delete(active, worst)
    out[order[:significant]] = True
    if significant:
        out[out] = _still_outside(residual, jacobian, variance, out)
    return out


def _refit(
    residual: FloatArray, jacobian: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return standardised residuals of the fit, leverages, and the extra variance."""
    freedom = len(residual) - jacobian.shape[1]
    extra = 0.0
    error = leverage = residual
    for _ in range(3):
        sigma = np.sqrt(np.maximum(variance + extra, np.finfo(float).tiny))
        q, _ = np.linalg.qr(jacobian / sigma[:, None])
        scaled = residual / sigma
        error = scaled - q @ (q.T @ scaled)
        leverage = np.square(q).sum(axis=1)
        new = between_variance(error * sigma, variance, freedom)
        if abs(new - extra) <= 0.02 * (new + float(variance.mean())):
            break
        extra = new
    return error, leverage, extra


def _still_outside(
    residual: FloatArray, jacobian: FloatArray, variance: FloatArray, out: BoolArray
) -> BoolArray:
    """Return, for the rows that are out, whether the fit of the others still rejects them."""
    keep = ~out
    _, _, extra = _refit(residual[keep], jacobian[keep], variance[keep])
    weight = 1.0 / np.maximum(variance + extra, np.finfo(float).tiny)
    design = jacobian[keep] * np.sqrt(weight[keep])[:, None]
    x, *_ = np.linalg.lstsq(design, residual[keep] * np.sqrt(weight[keep]), rcond=None)
    inverse = np.linalg.pinv(design.T @ design)
    spread = np.einsum("ni,ij,nj->n", jacobian[out], inverse, jacobian[out]) + 1 / weight[out]
    t = np.abs(residual[out] - jacobian[out] @ x) / np.sqrt(spread)
    freedom = int(keep.sum()) - jacobian.shape[1]
    rejected: BoolArray = 2 * stdtr(freedom, -t) * len(out) < LEVEL
    return rejected


def _bulk(residual: FloatArray, variance: FloatArray) -> BoolArray:
    """Return the rows beyond the largest of n normal deviates, in units of a robust scale."""
    sigma = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    scaled = np.abs(residual) / sigma
    scale = max(1.0, float(np.median(scaled)) / ndtri(0.75))
    far: BoolArray = scaled > scale * -ndtri(LEVEL / 2 / len(residual))
    return far
