"""The noise model: white noise, drift of each bias, a lean, and the closures' own errors.

A bias jitters from rest to rest, flickers, and walks; what samples miss of a turn is among the
closures' errors.

Their levels are estimated by restricted maximum likelihood: the likelihood of what no column of
the mean can reach. With the columns of every effect in the mean, an effect cannot hide as drift.
Contrasts have a say in them too: a bias that flickers, or a sensor that leans, changes within rests
as it does from rest to rest, and most effects do not.

References
----------
.. [1] Patterson, Thompson, "Recovery of inter-block information when block sizes are unequal",
   Biometrika 58, 1971, p. 545 (restricted likelihood).
.. [2] Gilmour, Thompson, Cullis, "Average information REML", Biometrics 51, 1995, p. 1440, eq. (7).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from calib.mismatch.noise.contrast import MOSTLY_WHITE, telling, typical
from calib.mismatch.noise.coupling import Foretold, drift_in_contrasts, foretold
from calib.mismatch.noise.sensornoise import DRIFT, LEAN
from calib.mismatch.rows.arrow import Factor, times_inverse
from calib.mismatch.rows.rows import UNKNOWN, Rows
from calib.types import FloatArray, IntArray

WITHIN = 0.7
"""How much levels of one group differ among each other: standard deviation of the logarithm of a
level (a variance)."""

SOONER = 1.0
"""How much walks differ from jitter and flicker besides, all of a group together: the minutes to
hours after which a bias walks further than it flickers (where an Allan plot begins to rise) differ
from part to part, and axes of one part have them in common. Without that a part that walks soon
would have to be a chance for each of its axes, and an effect on all of them the simpler answer."""

PACKAGE = 0.5
"""Share of what levels of a triad have in common, and of `SOONER`, that the other triad of the
package has as well: its grade, its supply, and heat that comes and goes. Rests tell of an
accelerometer hardly more than the size of gravity: of its drift the gyroscope's says most."""

INDEPENDENT = 1e-5
"""Share of a column's length that those before it must leave for it to be clearly independent."""

CLEAR = 0.1
"""The same above which rounding leaves their basis orthogonal."""

NEAR = 0.02
"""What the log-likelihood may be short of its maximum: evidence counts in nats."""

ITERATIONS = 15
"""Levels that are tried on the way to a maximum, at most."""

STRAINED = 4.0
"""How far levels must be from what is expected of them, in nats of the prior, for another maximum
to be looked for: that of a sensor that leans."""

LEANS = 1e3
"""Where that search starts, times what is expected of a lean: tenths of a degree in ten seconds."""

ROUNDING = 1e-12
"""Products of unit vectors up to which these are orthogonal."""

RANK = 1e-9
"""Share of a column up to which what the others leave of it is rounding."""

KNOWN = 30.0
"""Times better than the prior, from which on the rows alone tell a parameter."""

COARSE = 1e-4
"""Share of a column's length that others leave, below which its square is not told by squares."""


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
    for level, c in zip(levels, rows.components, strict=True):
        out[np.ix_(c.index, c.index)] += level * c.matrix
    return out


def expected_levels(rows: Rows) -> FloatArray:
    """Return the levels that the priors are centred on."""
    return np.array([c.expected for c in rows.components])


def prior_precision(rows: Rows) -> FloatArray:
    """Return the precision of the logarithms of the levels.

    Each is uncertain by its ``spread``; components of one group (the drift of one triad) share most
    of that, and differ among each other by `WITHIN` only. Walks share `SOONER` as well. Of either
    the drift of the other triad has the share `PACKAGE`.
    """
    if "prior precision" not in rows.kept:
        rows.kept["prior precision"] = _prior_precision(rows)
    return np.asarray(rows.kept["prior precision"])


def _prior_precision(rows: Rows) -> FloatArray:
    spread = np.array([c.spread for c in rows.components])
    group = np.array([c.group for c in rows.components])
    same = (group[:, None] == group) & (group != "")
    drifts = np.isin(group, list(DRIFT))
    alike = np.where(same, 1.0, PACKAGE * (drifts & drifts[:, None]))
    walks = np.array([c.name.endswith(" walk") for c in rows.components])
    common = np.outer(spread, spread) - WITHIN**2 + SOONER**2 * (walks & walks[:, None])
    own = np.where(group != "", WITHIN**2, np.square(spread))
    return np.asarray(np.linalg.inv(alike * common + np.diag(own)))


def estimate_levels(
    rows: Rows, mean: FloatArray, start: FloatArray, *, beside: FloatArray | None = None
) -> Levels:
    """Estimate the levels by penalised average-information REML.

    Parameters
    ----------
    rows : Rows
    mean : (m, p) array
        Columns of the mean; any rank. Only rows that tell of levels count (`level_basis`).
    start : (c,) array
        Levels to start from.
    beside : (n, q) array, optional
        The `level_basis` of what else is in the mean.
    """
    return _climbed(rows, level_basis(rows, mean, beside), start)


def _climbed(rows: Rows, basis: FloatArray, start: FloatArray) -> Levels:
    """Return the levels at the maximum above some, ``basis`` being that of the mean."""
    centre = np.log(expected_levels(rows))
    precision = prior_precision(rows)
    both = _beneath(rows, basis)
    logs = np.log(start)
    best: tuple[float, FloatArray] | None = None
    halved, caution, gain, information = 0, 0.1, np.inf, precision
    for _ in range(ITERATIONS):
        levels = np.exp(logs)
        weighing = Weighing.of(rows, levels)
        likelihood, white, root = _factored(weighing, both)
        value = likelihood - 0.5 * float((logs - centre) @ precision @ (logs - centre))
        if best is not None and value < best[0] - 1e-6:
            # Too long a step: go back half way.
            halved, caution = halved + 1, 0.1
            if halved > 4:
                break
            logs = 0.5 * (logs + best[1])
            continue
        before, gain = gain, np.inf if best is None else value - best[0]
        best = (value, logs)
        # Near the maximum gains are a geometric series, of which this is what is left.
        ratio = gain / before if np.isfinite(before) else 1.0
        if gain < NEAR or (ratio < 0.5 and gain * ratio / (1 - ratio) < NEAR):
            break
        mean, left = _parted(white, root)
        py, trace, vpy = weighing.slopes(rows, mean, left)
        trace, vpy = trace * levels, vpy * levels
        gradient = 0.5 * (vpy.T @ py - trace) - precision @ (logs - centre)
        information = _information(weighing, mean, vpy) + precision
        step = np.linalg.solve(information, gradient)
        if (more := 0.5 * float(gradient @ step)) < NEAR:
            # The last step leads where the information says, and gains what it says.
            best = (value + more, logs + step)
            break
        # Average information is poor far from the optimum; near it, caution only costs steps.
        step = np.linalg.solve(information + np.diag(caution * np.abs(trace)), gradient)
        caution *= 0.3
        logs = logs + np.clip(step, -2.0, 2.0)
    assert best is not None
    log_share = -0.5 * float(np.linalg.slogdet(np.linalg.solve(precision, information))[1])
    return Levels(np.exp(best[1]), best[0], log_share)


class Felt(NamedTuple):
    """Columns on the rows that tell of levels: the dense ones, and contrasts.

    ``dense`` is (n, p), and ``contrast`` (k, q): contrasts feel the last q columns only, of which
    there is one at least. Of attitudes, which are most of what is fitted, they know nothing.
    """

    dense: FloatArray
    contrast: FloatArray

    @classmethod
    def of(cls, columns: FloatArray, dense: int) -> Felt:
        """Return columns (n + k, p) of which the first n rows are the dense ones."""
        felt = columns[dense:].any(axis=0)
        first = int(np.argmax(felt)) if felt.any() else max(columns.shape[1] - 1, 0)
        return cls(columns[:dense], columns[dense:, first:])

    @property
    def whole(self) -> FloatArray:
        """The columns on all rows, (n + k, p)."""
        out = np.zeros((len(self.dense) + len(self.contrast), self.dense.shape[1]))
        out[: len(self.dense)] = self.dense
        out[len(self.dense) :, self.first :] = self.contrast
        return out

    @property
    def first(self) -> int:
        """The first column that contrasts feel."""
        return int(self.dense.shape[1] - self.contrast.shape[1])

    def times(self, other: Felt) -> FloatArray:
        """Return the products of its columns with all others, (p, r)."""
        out = self.dense.T @ other.dense
        out[self.first :, other.first :] += self.contrast.T @ other.contrast
        return np.asarray(out)

    def times_inverse(self, lower: FloatArray) -> Felt:
        """Return the columns times ``L'^-1``, of a lower triangle L."""
        k = self.first
        return Felt(times_inverse(self.dense, lower), times_inverse(self.contrast, lower[k:, k:]))


@dataclass(frozen=True, eq=False)
class Weighing:
    """What whitens the rows that tell of levels, at some: dense ones, and independent contrasts.

    Beside a truth no component shows in contrasts, and they tell nothing.

    Parameters
    ----------
    factor : Factor
        Of the covariance of the dense rows.
    scale : (n,) array
        Standard deviations of the contrasts.
    drift : (c, n) array
        Their variances by each component, for levels of one.
    """

    factor: Factor
    scale: FloatArray
    drift: FloatArray

    @classmethod
    def of(cls, rows: Rows, levels: FloatArray) -> Weighing:
        """Return the weighing at some levels."""
        contrasts, drift = _contrasts(rows)
        variance = rows.white_diagonal[contrasts] + levels @ drift
        return cls(rows.arrow.factorise(levels), np.sqrt(variance), drift)

    def solve(self, values: Felt) -> Felt:
        """Return whitened columns."""
        return Felt(self.factor.solve(values.dense), values.contrast / self.scale[:, None])

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of the covariance."""
        return self.factor.log_det + 2.0 * float(np.log(self.scale).sum())

    def slopes(
        self, rows: Rows, mean: Felt, left: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the restricted likelihood needs to climb, as `Arrow.slopes` does."""
        dense = rows.n_dense
        py, trace, vpy = rows.arrow.slopes(self.factor, mean.dense, left[:dense])
        free = 1.0 - np.einsum("np,np->n", mean.contrast, mean.contrast)
        trace = trace + self.drift @ (free / np.square(self.scale))
        rest = left[dense:] / self.scale
        return np.append(py, rest), trace, np.concatenate((vpy, (self.drift * rest).T))


def _contrasts(rows: Rows) -> tuple[IntArray, FloatArray]:
    """Return the numbers of the contrasts that tell of levels, and `Weighing.drift` of them."""
    if "drift in contrasts" not in rows.kept:
        rows.kept["drift in contrasts"] = drift_in_contrasts(rows)
    known, contrasts, drift = rows.kept.get("telling", (None, None, None))
    if known is not rows.residual:
        every = rows.kept["drift in contrasts"]
        contrasts = telling(rows)
        contrasts = contrasts[every[:, contrasts].any(axis=0)]
        drift = every[:, contrasts]
        rows.kept["telling"] = rows.residual, contrasts, drift
    return contrasts, drift


def rows_of_levels(rows: Rows) -> IntArray:
    """Return the numbers of the rows that tell of levels: dense ones, and some contrasts."""
    return np.append(np.arange(rows.n_dense), rows.n_dense + _contrasts(rows)[0])


def _information(weighing: Weighing, white: Felt, vpy: FloatArray) -> FloatArray:
    """Return the average information ``(V_i P y)' P (V_j P y) / 2``, (c, c)."""
    pulled = weighing.solve(Felt(*np.split(vpy, [len(white.dense)])))
    kept = white.times(pulled)
    return np.asarray(0.5 * (pulled.times(pulled) - kept.T @ kept))


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
    mean : (m, p) array
        Columns of the mean beside which the levels were estimated.
    levels : (c,) array
        Their estimates.
    influence : (m, k) array
        One a in each column.
    variance : (k,) array
        What each v is.

    References
    ----------
    .. [1] Giesbrecht, Burns, "Two-stage analysis based on a mixed model: large-sample asymptotic
       theory and small-sample simulation results", Biometrics 41, 1985, p. 477.
    """
    weighing = Weighing.of(rows, levels)
    told = rows_of_levels(rows)
    _, white, root = _factored(weighing, _beneath(rows, level_basis(rows, mean)))
    white, left = _parted(white, root)
    vpy = weighing.slopes(rows, white, left)[2] * levels
    precision = _information(weighing, white, vpy) + prior_precision(rows)
    slopes = np.empty((len(levels), influence.shape[1]))
    for i, c in enumerate(rows.components):
        felt = c.response.T @ influence[c.index]
        slopes[i] = levels[i] * np.einsum("sk,sk->k", felt, c.kernel @ felt)
    slopes += levels[:, None] * (weighing.drift @ np.square(influence[told[rows.n_dense :]]))
    # Beside priors a variance is less than its parts would make: they are shares of it.
    share = slopes / np.maximum(np.maximum(variance, slopes.sum(axis=0)), 1e-300)
    spread = np.einsum("ik,ik->k", share, np.linalg.solve(precision, share))
    return np.asarray(np.sqrt(np.maximum(spread, 0.0)))


def find_levels(
    rows: Rows, mean: FloatArray, start: FloatArray, *, beside: FloatArray | None = None
) -> Levels:
    """Estimate the levels from `start` and from closures that explain themselves; keep the better.

    Parameters are those of `estimate_levels`.

    The likelihood has two maxima where turns close badly (shocks, a coarse clock): closures with
    errors of their own, or drift that is far too large for the rests. From levels that expect good
    closures only the second is reached. Where white noise is most of what closures err, there is
    one. And a sensor that leans in its rests looks like one with far too much drift.
    """
    basis = level_basis(rows, mean, beside)
    found = [_climbed(rows, basis, start)]
    above = expected_levels(rows)
    square = np.square(rows.residual[: rows.n_dense])
    white = np.diag(rows.white)
    worst = 0.0
    for i, component in enumerate(rows.components):
        if component.group or component.spread < UNKNOWN:
            continue  # of these more is known beforehand
        size = component.variance
        own = size > 0
        if own.any():
            index = component.index[own]
            above[i] = max(above[i], typical(square[index] / size[own]))
            worst = max(worst, typical(square[index] / white[index]))
    if worst >= MOSTLY_WHITE and not np.array_equal(start, above):
        found.append(_climbed(rows, basis, above))
    best = max(found, key=lambda levels: levels.log_likelihood)
    if level_penalty(rows, best.values) > STRAINED:
        leaning = expected_levels(rows)
        leaning[[c.group == LEAN for c in rows.components]] *= LEANS
        best = max(best, _climbed(rows, basis, leaning), key=lambda levels: levels.log_likelihood)
    return best


def bare_levels(rows: Rows) -> Levels:
    """Return what `find_levels` finds from what is expected, beside what is always fitted alone.

    They are kept: several questions are asked of the rows before anything else is in the mean.
    """
    known, levels = rows.kept.get("bare levels", (None, None))
    if known is not rows.residual:
        mean = np.hstack((rows.baseline, rows.nuisance))
        levels = find_levels(rows, mean, expected_levels(rows))
        rows.kept["bare levels"] = rows.residual, levels
    assert isinstance(levels, Levels)
    return levels


def level_basis(rows: Rows, mean: FloatArray, beside: FloatArray | None = None) -> FloatArray:
    """Return the `range_basis` of (m, p) columns on the rows that tell of levels.

    Of columns that are clearly independent it begins with what contrasts do not feel.
    """
    told = mean[rows_of_levels(rows)]
    order = np.argsort(told[rows.n_dense :].any(axis=0), kind="stable")
    return range_basis(told[:, order], beside)


def range_basis(mean: FloatArray, beside: FloatArray | None = None) -> FloatArray:
    """Return independent columns with the span of `mean`, scaled to unit length.

    After those of another basis ``beside`` it, whose span is in theirs then.
    """
    size = np.sqrt(np.einsum("np,np->p", mean, mean))
    some = size > 0
    scaled = (mean if some.all() else mean[:, some]) / size[some]
    if beside is None:
        return _independent(scaled)
    for _ in range(2):  # what rounding leaves in the first time goes in the second
        scaled = scaled - beside @ (beside.T @ scaled)
    return np.hstack((beside, _independent(scaled)))


def _independent(scaled: FloatArray) -> FloatArray:
    """Return an orthonormal basis of columns, of which short ones are rounding."""
    if not scaled.size:
        return np.asarray(scaled)
    plain = _orthonormal(scaled)
    if plain is not None:
        return plain
    q, r, _ = linalg.qr(scaled, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(r)) > RANK).sum())
    return np.asarray(q[:, :rank])


def _orthonormal(scaled: FloatArray) -> FloatArray | None:
    """Return an orthonormal basis of clearly independent columns; None of others.

    Cholesky QR, twice unless they are `CLEAR`: the second makes up for the rounding of the first,
    which squares how nearly dependent the columns are [1]_. It is products alone, many times faster
    than pivoting.

    References
    ----------
    .. [1] Yamamoto, Nakatsukasa, Yanagisawa, Fukaya, "Roundoff error analysis of the CholeskyQR2
       algorithm", ETNA 44, 2015, p. 306.
    """
    q = scaled
    for most in (np.inf, 0.1):
        gram = q.T @ q
        off = np.abs(gram - np.eye(len(gram))).max()
        if off < ROUNDING:
            return q
        if off > most:
            return None
        try:
            inner = linalg.cholesky(gram, lower=True, check_finite=False)
        except linalg.LinAlgError:
            return None
        if np.diag(inner).min() < INDEPENDENT:
            return None
        q = times_inverse(q, inner)
        if np.diag(inner).min() > CLEAR:
            break
    return q


def _beneath(rows: Rows, basis: FloatArray) -> Felt:
    """Return the `level_basis` of a mean, and the residual after it."""
    return Felt.of(np.column_stack((basis, rows.residual[rows_of_levels(rows)])), rows.n_dense)


def _factored(weighing: Weighing, both: Felt) -> tuple[float, Felt, FloatArray]:
    """Return the restricted log-likelihood, and what `_parted` makes the rest of.

    That is mean and y whitened, and a root of their products: a lower triangle, of which the last
    element is the length of what the mean leaves of y. The columns of ``both``, p + 1, are those of
    the mean, and y.
    """
    white = weighing.solve(both)
    root = _root(white.times(white))
    if root is None:
        found, upper = np.linalg.qr(white.whole)
        root, size = np.eye(len(upper)), np.diag(upper)
        found[:, -1] *= size[-1]
        white = Felt.of(found, len(white.dense))
    else:
        size = np.diag(root)
    log_det = weighing.log_det + 2 * np.log(np.abs(size[:-1])).sum()
    return float(-0.5 * (log_det + size[-1] ** 2)), white, root


def _root(products: FloatArray) -> FloatArray | None:
    """Return a root of products of columns, a lower triangle; None where squares are too coarse.

    Squared, a mean that noise weighs as 1e8 to one is singular; and of a last column of which the
    others leave a ten-thousandth, no more is left than half of the digits.
    """
    try:
        root = linalg.cholesky(products, lower=True, check_finite=False)
    except linalg.LinAlgError:
        return None
    return None if root[-1, -1] < COARSE * np.sqrt(products[-1, -1]) else np.asarray(root)


def _parted(white: Felt, root: FloatArray) -> tuple[Felt, FloatArray]:
    """Return the whitened mean, orthonormal, and what it leaves of y, as `_factored` has them."""
    found = white.times_inverse(root)
    left = np.concatenate((found.dense[:, -1], found.contrast[:, -1])) * root[-1, -1]
    return Felt(found.dense[:, :-1], found.contrast[:, :-1]), left


@dataclass(frozen=True, eq=False)
class Whitener:
    """Whitens rows and projects out what is always fitted (baseline and nuisances)."""

    factor: Factor
    scale: FloatArray
    basis: FloatArray
    n_dense: int
    foretold: tuple[Foretold, ...] = ()

    def whiten(self, values: FloatArray) -> FloatArray:
        """Return whitened (m, ...) rows."""
        scale = self.scale if values.ndim == 1 else self.scale[:, None]
        rest = values[self.n_dense :] / scale
        for known in self.foretold:
            own = known.contrast
            told = known.weight @ values[known.mean] / scale[own]
            rest[own] = known.root @ (rest[own] - told)
        return np.concatenate((self.factor.solve(values[: self.n_dense]), rest))

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of the covariance of all rows."""
        total = self.factor.log_det + 2.0 * float(np.log(self.scale).sum())
        return total - 2.0 * sum(float(np.log(np.diag(k.root)).sum()) for k in self.foretold)

    def unwhiten_transposed(self, values: FloatArray) -> FloatArray:
        """Return the transposed whitening applied to (m, k) rows: ``inv(L)' values``."""
        first = self.factor.solve_transposed(values[: self.n_dense])
        rest = values[self.n_dense :].copy()
        for known in self.foretold:
            rest[known.contrast] = known.root.T @ rest[known.contrast]
        rest /= self.scale[:, None]
        for known in self.foretold:
            first[known.mean] -= known.weight.T @ rest[known.contrast]
        return np.concatenate((first, rest))

    def restricted(self, rows: IntArray) -> Whitener:
        """Return the whitener of values that are zero but on some rows, of which it takes those.

        They are those of turns and of whole channels, in their order.
        """
        dense = int(np.searchsorted(rows, self.n_dense))
        factor, contrast = self.factor.restricted(rows[:dense]), rows[dense:] - self.n_dense
        own = (known.restricted(rows[:dense], contrast) for known in self.foretold)
        return Whitener(
            factor,
            self.scale[contrast],
            self.basis[rows],
            dense,
            tuple(known for known in own if known is not None),
        )

    def project(self, values: FloatArray) -> FloatArray:
        """Return whitened rows without what the fitted columns can reach."""
        white = self.whiten(values)
        return white - self.basis @ (self.basis.T @ white)


def make_whitener(
    rows: Rows,
    levels: FloatArray,
    contrast: FloatArray,
    fitted: FloatArray,
    *,
    coupled: bool = True,
) -> Whitener:
    """Return the whitener for these levels, with the (m, p) `fitted` columns projected out.

    The first of these, if there are any, are the baseline's: what is `foreknown` is of those.
    Unless ``coupled``, contrasts are taken as they are: by what a part of the rows says alone.
    """
    factor = rows.arrow.factorise(levels)
    known = foretold(rows, levels) if coupled else ()
    none = np.zeros((len(rows.residual), 0))
    plain = Whitener(factor, np.sqrt(contrast), none, rows.n_dense, known)
    white, known_before = plain.whiten(fitted), rows.foreknown[: fitted.shape[1]]
    return replace(plain, basis=_basis_beside(white, known_before))


def _basis_beside(white: FloatArray, spread: FloatArray) -> FloatArray:
    """Return a basis B of (m, p) whitened columns, of which the first have a prior `spread`.

    What ``1 - B B'`` leaves is what rows tell with these coefficients integrated out: of a
    direction that the rows know s times better than the prior, the share ``s² / (1 + s²)`` goes. A
    column that shows next to nothing must not take what it would have to be impossible for.
    """
    uncertain = np.flatnonzero(np.isfinite(spread))
    if not len(uncertain):
        return range_basis(white)
    others = range_basis(np.delete(white, uncertain, axis=1))
    own = white[:, uncertain] * spread[uncertain]
    own -= others @ (others.T @ own)
    along, known, _ = np.linalg.svd(own, full_matrices=False)
    share = np.where(known > KNOWN, 1.0, known / np.sqrt(1.0 + np.square(known)))
    return np.hstack((others, along * share))


def level_likelihood(rows: Rows, basis: FloatArray, levels: FloatArray) -> float:
    """Return the penalised restricted log-likelihood of given levels.

    ``basis`` is the `level_basis` of the mean.
    """
    likelihood, _, _ = _factored(Weighing.of(rows, levels), _beneath(rows, basis))
    return likelihood - level_penalty(rows, levels)


def whole_likelihood(
    rows: Rows, basis: FloatArray, levels: FloatArray, contrast: FloatArray
) -> float:
    """Return what `level_likelihood` does, by all rows: contrasts of some variance as well.

    ``basis`` is the `range_basis` of the mean on all rows.
    """
    drift = np.zeros((len(levels), len(contrast)))
    weighing = Weighing(rows.arrow.factorise(levels), np.sqrt(contrast), drift)
    both = Felt.of(np.column_stack((basis, rows.residual)), rows.n_dense)
    return _factored(weighing, both)[0] - level_penalty(rows, levels)


def level_penalty(rows: Rows, levels: FloatArray) -> float:
    """Return how far levels are from what is expected of them, in nats of the prior."""
    logs = np.log(levels / expected_levels(rows))
    return 0.5 * float(logs @ prior_precision(rows) @ logs)
