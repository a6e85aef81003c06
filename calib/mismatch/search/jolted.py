"""Turns of which samples miss more than of most.

What samples do not resolve of a turn is known from what varies from sample to sample to a factor of
a few: where between two of them a push begins, nobody saw. So errors of turns that consist of
little else have the tails of Student's t, and not those of normal ones: their variance is what is
expected, times a factor of the turn's own from an inverse gamma distribution. The factor that is
the most probable goes into the covariance. Where white noise is most of what a turn errs by, such
factors change nothing.
"""

from __future__ import annotations

import numpy as np

from calib.effects import effects
from calib.mismatch.hypotheses.answers import physics
from calib.mismatch.hypotheses.families import add_catalogue
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import covariance, expected_levels, find_levels, make_whitener
from calib.mismatch.rows.rows import SAMPLING, Rows
from calib.types import FloatArray

FREEDOM = 4.0
"""Degrees of freedom of the tails: about as many pushes are in a turn."""

FACTORS = np.geomspace(1.0, 32.0, 11)
"""Factors that are tried. Beyond these, something else is wrong with a turn."""

MATTERS = 0.1
"""Share of the variance of most turns' angles or velocities that samples do not resolve, from which
it matters how that is distributed."""

STRONG = ("bandwidth", "gyro_misalignment", "time_offset")
"""Effects that may be more in some turns than all else that they err by: turns are judged beside
them if that is the more probable. Of others, samples that resolve so little show what many turns
say together; and with as many columns in the mean as turns have rows, none would seem worse than
others."""

ROUNDS = 4
"""How often levels and factors are found, each beside the other, at most."""

ROUNDED = 1e-3
"""Share of a variance that is left of it at least where what is fitted takes it up."""


def jolted(rows: Rows, *, skip: tuple[str, ...]) -> FloatArray | None:
    """Return the factor of each segment's unresolved variance, (s,); None where it is too little.

    Parameters
    ----------
    rows : Rows
    skip : tuple of str
        Effects that are not tried.
    """
    index = rows.turns.index
    if not len(index) or _share(rows, expected_levels(rows)) < MATTERS:
        return None
    found = [_beside(rows, mean) for mean in means(rows, skip=skip)]
    factors, _ = max(found, key=lambda one: one[1])
    return factors


def means(rows: Rows, *, skip: tuple[str, ...] = ()) -> list[FloatArray]:
    """Return what is always fitted, (m, k), and that beside `STRONG` effects but those to skip."""
    stack = Stack(len(rows.residual))
    add_catalogue(stack, rows, skip=(*skip, *(slug for slug in effects() if slug not in STRONG)))
    plain = np.hstack((rows.baseline, rows.nuisance))
    return [plain, np.hstack((plain, physics(stack)))] if len(stack) else [plain]


def _beside(rows: Rows, mean: FloatArray) -> tuple[FloatArray | None, float]:
    """Return factors, and how probable they and the mean make the rows, as a logarithm."""
    segments = rows.segment[rows.turns.index[:, 0]]
    factors, matters = np.ones(len(rows.interval)), True
    for _ in range(ROUNDS):
        now = rows.jolted(factors)
        levels = find_levels(now, mean, expected_levels(now)).values
        matters = _share(now, levels) >= MATTERS
        if not matters:
            break
        before = factors[segments]
        factors[segments] = _most_probable(rows, now, levels, mean)
        if np.array_equal(before, factors[segments]):
            break
    now = rows.jolted(factors)
    levels = find_levels(now, mean, expected_levels(now)).values
    whitener = make_whitener(now, levels, contrast_variance(now), mean)
    left = np.square(whitener.project(rows.residual)).sum()
    number = whitener.basis.shape[1] * np.log(len(rows.residual))
    value = -0.5 * (now.arrow.factorise(levels).log_det + left + number)
    value += float(_log_prior(factors[segments]).sum())
    return factors if matters else None, value


def _log_prior(factors: FloatArray) -> FloatArray:
    """Return the logarithm of the density of factors, but for a constant."""
    return -0.5 * FREEDOM * (np.log(factors) + 1.0 / factors)


def _share(rows: Rows, levels: FloatArray) -> float:
    """Return the share of the variance of most turns, of angles or velocities, by sampling."""
    share = (rows.missed(levels) / rows.variance(levels))[rows.turns.index]
    return float(max(np.median(share[:, :2]), np.median(share[:, 2:])))


def _most_probable(rows: Rows, now: Rows, levels: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the factors of all turns, (k,), from what `now`, with some factors, leaves of them."""
    n, index = rows.n_dense, rows.turns.index
    whole = covariance(now, levels)
    whitener = make_whitener(now, levels, contrast_variance(now), mean, coupled=False)
    # With V = L L' of the dense rows, L is V times the transposed inverse of L.
    reach = whole @ whitener.factor.solve_transposed(whitener.basis[:n])
    left = now.residual[:n] - reach @ (whitener.basis.T @ whitener.whiten(now.residual))
    fitted = reach[index] @ reach[index].transpose(0, 2, 1)
    # Without components by sampling the covariance is what a level of zero leaves of it.
    others = covariance(rows, np.where(_by_sampling(rows), 0.0, levels))
    rest = _blocks(others, rows)
    unresolved = _blocks(covariance(rows, levels), rows) - rest
    seen = rest - (1.0 - ROUNDED) * fitted + FACTORS[:, None, None, None] * unresolved
    off = left[index]
    square = np.einsum("ki,fki->fk", off, np.linalg.solve(seen, off[None, :, :, None])[..., 0])
    value = _log_prior(FACTORS)[:, None] - 0.5 * (np.linalg.slogdet(seen)[1] + square)
    return np.asarray(FACTORS[np.argmax(value, axis=0)])


def _by_sampling(rows: Rows) -> FloatArray:
    return np.array([c.name.endswith(SAMPLING) for c in rows.components])


def _blocks(matrix: FloatArray, rows: Rows) -> FloatArray:
    """Return what a matrix of the dense rows has of each turn by itself, (k, 5, 5)."""
    index = rows.turns.index
    return np.asarray(matrix[index[:, :, None], index[:, None]])
