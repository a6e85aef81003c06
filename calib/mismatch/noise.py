"""The noise model: white noise, jitter and random walk of each bias, the closures' own errors.

Their levels are estimated by restricted maximum likelihood: the likelihood of what no column of
the mean can reach. With the columns of every effect in the mean, an effect cannot hide as drift.

References
----------
.. [1] Patterson, Thompson, "Recovery of inter-block information when block sizes are unequal",
   Biometrika 58, 1971, p. 545 (restricted likelihood).
.. [2] Gilmour, Thompson, Cullis, "Average information REML", Biometrics 51, 1995, p. 1440, eq. (7).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import linalg

from calib.mismatch.rows import Component, Rows
from calib.types import BoolArray, FloatArray, IntArray

WITHIN = 0.7
"""How much levels of one group differ among each other: standard deviation of the logarithm of a
level (a variance)."""


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels of the components, and the penalised restricted log-likelihood that they reach.

    ``log_share`` is the logarithm of the share of the prior that reaches about as much: the
    likelihood averaged over the prior is the product of both (Laplace's method). It is 0 for levels
    that the rows say nothing of, and the lower, the more closely they determine them.
    """

    values: FloatArray
    log_likelihood: float
    log_share: float


def covariance(rows: Rows, levels: FloatArray) -> FloatArray:
    """Return the covariance of the dense rows."""
    out = rows.white.copy()
    at = 0
    for index, matrices in _by_rows(rows):
        part = levels[at] * matrices[0]
        for k, matrix in enumerate(matrices[1:], start=1):
            part += levels[at + k] * matrix
        out[index[:, None], index] += part
        at += len(matrices)
    return out


def _by_rows(rows: Rows) -> list[tuple[IntArray, list[FloatArray]]]:
    """Return the components' matrices in their order, those on the same rows side by side.

    The drift of a channel acts on its own rows, a fraction of all: so that is where to work.
    """
    out: list[tuple[IntArray, list[FloatArray]]] = []
    for c in rows.components:
        if not out or not np.array_equal(out[-1][0], c.index):
            out.append((c.index, []))
        out[-1][1].append(c.matrix)
    return out


def expected_levels(rows: Rows) -> FloatArray:
    """Return the levels that the priors are centred on."""
    return np.array([c.expected for c in rows.components])


def prior_precision(rows: Rows) -> FloatArray:
    """Return the precision of the logarithms of the levels.

    Each is uncertain by its ``spread``; components of one group (the drift of one triad) share most
    of that, and differ among each other by `WITHIN` only.
    """
    spread = np.array([c.spread for c in rows.components])
    group = np.array([c.group for c in rows.components])
    same = (group[:, None] == group) & (group != "")
    shared = np.where(same, np.outer(spread, spread) - WITHIN**2, 0.0)
    own = np.where(group != "", WITHIN**2, np.square(spread))
    return np.asarray(np.linalg.inv(shared + np.diag(own)))


def estimate_levels(
    rows: Rows, mean: FloatArray, start: FloatArray, *, iterations: int = 15
) -> Levels:
    """Estimate the levels by penalised average-information REML.

    Parameters
    ----------
    rows : Rows
    mean : (n_dense, p) array
        Columns of the mean; any rank.
    start : (c,) array
        Levels to start from.
    """
    y = rows.residual[: rows.n_dense]
    centre = np.log(expected_levels(rows))
    precision = prior_precision(rows)
    basis = range_basis(mean)
    logs = np.log(start)
    best: tuple[float, FloatArray] | None = None
    halved, caution, log_share = 0, 0.1, 0.0
    for _ in range(iterations):
        levels = np.exp(logs)
        factor = factorise(rows, levels)
        likelihood, white, left = _restricted(factor, basis, y)
        value = likelihood - 0.5 * float((logs - centre) @ precision @ (logs - centre))
        if best is not None and value < best[0] - 1e-6:
            # Too long a step: go back half way.
            halved, caution = halved + 1, 0.1
            if halved > 4:
                break
            logs = 0.5 * (logs + best[1])
            continue
        gain = np.inf if best is None else value - best[0]
        best = (value, logs)
        if gain < 0.02:
            break
        projector, py = _projector(factor, white, left)
        vpy, trace = _slopes(rows, levels, projector, py)
        gradient = 0.5 * (vpy.T @ py - trace) - precision @ (logs - centre)
        information = 0.5 * vpy.T @ linalg.blas.dsymm(1.0, projector, vpy, lower=1) + precision
        log_share = -0.5 * float(np.linalg.slogdet(np.linalg.solve(precision, information))[1])
        # Average information is poor far from the optimum; near it, caution only costs steps.
        information += np.diag(caution * np.abs(trace))
        caution *= 0.3
        step = np.linalg.solve(information, gradient)
        logs = logs + np.clip(step, -2.0, 2.0)
    assert best is not None
    return Levels(np.exp(best[1]), best[0], log_share)


def _slopes(
    rows: Rows, levels: FloatArray, projector: FloatArray, py: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``V_i P y`` (n, c) and ``tr(P V_i)`` (c,), V_i the level's part of the covariance."""
    vpy, trace = np.zeros((len(py), len(levels)), order="F"), np.empty(len(levels))
    at = 0
    for index, matrices in _by_rows(rows):
        # The lower half of a symmetric matrix, as long as the rows are in order.
        own = projector[np.ix_(index, index)]
        middle = np.diag(own)
        for matrix in matrices:
            vpy[index, at] = levels[at] * (matrix @ py[index])
            both = 2.0 * float(np.vdot(own, matrix)) - float(middle @ np.diag(matrix))
            trace[at] = levels[at] * both
            at += 1
    return vpy, trace


def spread_of_variance(
    rows: Rows,
    mean: FloatArray,
    levels: FloatArray,
    influence: FloatArray,
    variance: FloatArray,
) -> FloatArray:
    """Return how uncertain variances are: the standard deviation of the logarithm of each.

    An estimate ``a' y`` has the variance ``v = a' V a``, in which the levels of V are estimates
    themselves. With W the precision of their logarithms and ``g_i = level_i a' V_i a``, log v has
    the variance ``g' inv(W) g / v²``.

    Parameters
    ----------
    rows : Rows
    mean : (n_dense, p) array
        Columns of the mean beside which the levels were estimated.
    levels : (c,) array
        Their estimates.
    influence : (n_dense, k) array
        One a in each column, as far as it weighs rows with levels.
    variance : (k,) array
        What each v is.

    References
    ----------
    .. [1] Giesbrecht, Burns, "Two-stage analysis based on a mixed model: large-sample asymptotic
       theory and small-sample simulation results", Biometrics 41, 1985, p. 477.
    """
    factor = factorise(rows, levels)
    _, white, left = _restricted(factor, range_basis(mean), rows.residual[: rows.n_dense])
    projector, py = _projector(factor, white, left)
    vpy, _ = _slopes(rows, levels, projector, py)
    precision = 0.5 * vpy.T @ linalg.blas.dsymm(1.0, projector, vpy, lower=1)
    precision += prior_precision(rows)
    slopes, at = np.empty((len(levels), influence.shape[1])), 0
    for index, matrices in _by_rows(rows):
        own = influence[index]
        for matrix in matrices:
            slopes[at] = levels[at] * np.einsum("ik,ik->k", own, matrix @ own)
            at += 1
    spread = np.einsum("ik,ik->k", slopes, np.linalg.solve(precision, slopes))
    return np.asarray(np.sqrt(spread) / np.maximum(variance, 1e-300))


def find_levels(rows: Rows, mean: FloatArray, start: FloatArray) -> Levels:
    """Estimate the levels from `start` and from closures that explain themselves; keep the better.

    The likelihood has two maxima where turns close badly (shocks, a coarse clock): closures with
    errors of their own, or drift that is far too large for the rests. From levels that expect good
    closures only the second is reached. Where white noise is most of what closures err, there is
    one.
    """
    above = expected_levels(rows)
    square = np.square(rows.residual[: rows.n_dense])
    white = np.diag(rows.white)
    worst = 0.0
    for i, component in enumerate(rows.components):
        if component.group or component.spread < Component.spread:
            continue  # of these more is known beforehand
        size = np.diag(component.matrix)
        own = size > 0
        if own.any():
            index = component.index[own]
            above[i] = max(above[i], _typical(square[index] / size[own]))
            worst = max(worst, _typical(square[index] / white[index]))
    alone = worst < 2.0 or np.array_equal(start, above)
    found = [estimate_levels(rows, mean, at) for at in ([start] if alone else [start, above])]
    return max(found, key=lambda levels: levels.log_likelihood)


def _typical(squares: FloatArray) -> float:
    """Return the variance of normal errors by the median of their squares."""
    # The median of chi-squared with one degree of freedom is 0.4549.
    return float(np.median(squares)) / 0.4549


def range_basis(mean: FloatArray, *, tolerance: float = 1e-9) -> FloatArray:
    """Return independent columns with the span of `mean`, scaled to unit length."""
    size = np.linalg.norm(mean, axis=0)
    scaled = mean[:, size > 0] / size[size > 0]
    if not scaled.size:
        return np.asarray(scaled)
    q, r, _ = linalg.qr(scaled, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(r)) > tolerance * abs(r[0, 0])).sum())
    return np.asarray(q[:, :rank])


def _restricted(
    factor: FloatArray, basis: FloatArray, y: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Return the restricted log-likelihood, the whitened mean (orthonormal), and what it leaves."""
    right = np.asfortranarray(np.column_stack((basis, y)))
    both = linalg.blas.dtrsm(1.0, factor, right, lower=1, overwrite_b=1)
    mean, left = both[:, :-1], both[:, -1]
    log_det = 2 * np.log(np.diag(factor)).sum()
    if basis.size:
        inner = linalg.cholesky(mean.T @ mean, lower=True, check_finite=False)
        mean = linalg.blas.dtrsm(1.0, inner, mean, side=1, lower=1, trans_a=1)
        left = left - mean @ (mean.T @ left)
        log_det += 2 * np.log(np.diag(inner)).sum()
    return float(-0.5 * (log_det + left @ left)), mean, left


def _projector(
    factor: FloatArray, mean: FloatArray, left: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``P = inv(V) - inv(V) X inv(X' inv(V) X) X' inv(V)``, and P y.

    Of P the lower triangle, in Fortran's order, and zeros above.
    """
    py = linalg.solve_triangular(factor, left, lower=True, trans="T", check_finite=False)
    projector, _ = linalg.lapack.dpotri(factor, lower=1)
    if mean.size:
        half = linalg.blas.dtrsm(1.0, factor, mean, lower=1, trans_a=1)
        projector = linalg.blas.dsyrk(-1.0, half, beta=1.0, c=projector, lower=1, overwrite_c=1)
    return projector, py


def contrast_variance(rows: Rows, *, apart: BoolArray | None = None) -> FloatArray:
    """Return the variance of the contrast rows: white noise times one robust factor a channel.

    Restless segments have a factor of their own, each. Rows that are marked in ``apart``, by number
    of contrast, hold more than noise: their channel's factor is that of the others.

    Drift within a rest and correlated noise lift it above white noise. What repeats in every rest
    or goes with time (an effect) is taken out first.
    """
    variance = rows.white_diagonal.copy()
    start = rows.n_dense
    y, channel = rows.residual[start:], rows.channel[start:]
    time = rows.interval[rows.segment[start:]].mean(axis=1)
    order = (
        np.tile(np.repeat([0, 1], 6), len(y) // 12) if len(y) % 12 == 0 else np.zeros(len(y), int)
    )
    restless = rows.restless[start:] if rows.restless.size else np.zeros(len(y), bool)
    for c, moved in product(range(6), (False, True)):
        mine = (channel == c) & (restless == moved)
        squares = []
        for k in (0, 1):
            own = np.flatnonzero(mine & (order == k))
            if apart is not None and (~apart[own]).sum() >= 5:
                own = own[~apart[own]]
            if len(own) < 5:
                continue
            scaled = y[own] / np.sqrt(variance[own])
            design = np.stack((np.ones(len(own)), (time[own] - time[own].mean())), axis=1)
            left = scaled - design @ np.linalg.lstsq(design, scaled, rcond=None)[0]
            squares.append(np.square(left) * len(own) / (len(own) - 2))
        if not squares:
            continue
        values = np.concatenate(squares)
        level = _typical(values)
        level = max(level, float(np.minimum(values, 9.0 * max(level, 1e-12)).mean()))
        variance[mine] *= _inflation(len(values) * level, len(values))
        if not moved:
            continue
        # A knock or a slip errs by far more than shaking does elsewhere.
        for s in np.unique(rows.segment[start:][mine]):
            own = mine & (rows.segment[start:] == s)
            variance[own] *= _inflation(float(np.square(y[own]) @ (1 / variance[own])), own.sum())
    return variance


def contrast_likelihood(rows: Rows, variance: FloatArray) -> float:
    """Return the log-likelihood of the contrast rows as noise of this variance."""
    y = rows.residual[rows.n_dense :]
    return float(-0.5 * (np.log(variance) + np.square(y) / variance).sum())


def _inflation(total: float, count: int) -> float:
    """Return a factor on variance from a sum of squares, shrunk to 1 as by six more; at least 1."""
    return max(1.0, (total + 6.0) / (count + 6.0))


@dataclass(frozen=True, eq=False)
class Whitener:
    """Whitens rows and projects out what is always fitted (baseline and nuisances)."""

    factor: FloatArray
    scale: FloatArray
    basis: FloatArray
    n_dense: int

    def whiten(self, values: FloatArray) -> FloatArray:
        """Return whitened (m, ...) rows."""
        out = np.empty_like(values, dtype=np.float64)
        out[: self.n_dense] = linalg.solve_triangular(
            self.factor, values[: self.n_dense], lower=True, check_finite=False
        )
        rest = values[self.n_dense :]
        out[self.n_dense :] = rest / (self.scale if rest.ndim == 1 else self.scale[:, None])
        return out

    def unwhiten_transposed(self, values: FloatArray) -> FloatArray:
        """Return the transposed whitening applied to (m, k) rows: ``inv(L)' values``."""
        out = np.empty_like(values)
        out[: self.n_dense] = linalg.solve_triangular(
            self.factor, values[: self.n_dense], lower=True, trans="T", check_finite=False
        )
        out[self.n_dense :] = values[self.n_dense :] / self.scale[:, None]
        return out

    def project(self, values: FloatArray) -> FloatArray:
        """Return whitened rows without what the fitted columns can reach."""
        white = self.whiten(values)
        return white - self.basis @ (self.basis.T @ white)


def factorise(rows: Rows, levels: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of the covariance of the dense rows."""
    # The transpose is in Fortran's order, so that LAPACK copies nothing.
    cov = covariance(rows, levels)
    factor = linalg.cholesky(cov.T, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(factor)


def make_whitener(
    rows: Rows,
    levels: FloatArray,
    contrast: FloatArray,
    fitted: FloatArray,
    *,
    factor: FloatArray | None = None,
) -> Whitener:
    """Return the whitener for these levels, with the (m, p) `fitted` columns projected out.

    ``factor`` is what `factorise` makes of the levels, where it is known.
    """
    factor = factorise(rows, levels) if factor is None else factor
    plain = Whitener(factor, np.sqrt(contrast), np.zeros((len(rows.residual), 0)), rows.n_dense)
    return Whitener(factor, plain.scale, range_basis(plain.whiten(fitted)), rows.n_dense)


def level_likelihood(
    rows: Rows, basis: FloatArray, levels: FloatArray, *, factor: FloatArray | None = None
) -> float:
    """Return the penalised restricted log-likelihood of given levels.

    ``basis`` is the `range_basis` of the mean's dense rows; ``factor`` as in `make_whitener`.
    """
    factor = factorise(rows, levels) if factor is None else factor
    both = np.column_stack((basis, rows.residual[: rows.n_dense]))
    white = linalg.solve_triangular(factor, both, lower=True, check_finite=False)
    q, r = linalg.qr(white[:, :-1], mode="economic", check_finite=False)
    y = white[:, -1]
    left = float(y @ y - np.square(q.T @ y).sum())
    log_det = 2 * np.log(np.diag(factor)).sum() + 2 * np.log(np.abs(np.diag(r))).sum()
    logs = np.log(levels / expected_levels(rows))
    prior = float(logs @ prior_precision(rows) @ logs)
    return float(-0.5 * (log_det + left + prior))
