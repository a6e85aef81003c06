"""What tells of an effect: one turn alone, that its samples do not resolve, is no witness.

By how much samples miss a turn is known to a factor of two or so, and the worst turn of a recording
can miss by several times what is expected of it. An effect whose column is large in that turn
explains it as well as any jolt would. Another turn, or a rest, has to show it too. Nor is a part of
an effect that other causes have as well: what is its own has to show (`Effect.must_show`).
"""

from __future__ import annotations

import numpy as np

from calib.effects import get_effect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import candidate_columns
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.noise import Whitener, range_basis
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.ranking import Ranking
from calib.mismatch.search.refine import likelihood_gain
from calib.types import FloatArray

COUNTS = 0.05
"""E-value from which a group counts in what is left altogether."""

ELSEWHERE = 0.25
"""Share of what an effect gains that rows outside of one turn must tell."""

MOSTLY = 0.5
"""Share of a turn's variance that samples do not resolve, from which on it is no witness."""

CLEAR = 3.0
"""Log-likelihood that the part of an effect that is its own gains, if it shows: noise reaches that
in 1 of 70."""


def witnessed(rows: Rows, ranking: Ranking, whitener: Whitener, y: FloatArray) -> dict[str, float]:
    """Return the groups of a ranking without those that no witness tells of.

    What was not the whole time needs none, unless rows are `aliased`; samples that are lost never
    do, as the turn in which they are is all that tells of them.
    """
    alone = [
        g
        for g, v in ranking.groups.items()
        if v > np.log(COUNTS)
        and _needs_witness(best := ranking.best[g], aliased=rows.aliased)
        and (
            told_by_one_turn(rows, ranking.stack.of(best), ranking.levels, whitener, y)
            or (best.physical and not shows_its_own(rows, ranking.stack, best, whitener, y))
        )
    ]
    return {g: v for g, v in ranking.groups.items() if g not in alone}


def _needs_witness(candidate: Candidate, *, aliased: bool) -> bool:
    if candidate.name == "dropped_samples":
        return False
    lasts = candidate.physical and get_effect(candidate.name).kind != "event"
    return aliased or lasts


def shows_its_own(
    rows: Rows, stack: Stack, candidate: Candidate, whitener: Whitener, y: FloatArray
) -> bool:
    """Whether rows tell of the part of an effect that is its own, beside the rest of it.

    Parameters
    ----------
    rows : Rows
    stack, candidate : Stack, Candidate
    whitener : Whitener
        With all that is fitted projected out.
    y : (m,) array
        Whitened projected residual.
    """
    shape = get_effect(candidate.name).must_show(candidate.shape)
    if shape is None:
        return True
    whole = stack.of(candidate)
    own = candidate_columns(rows, candidate, shape, reference=True)
    if own is None:
        return False
    rest = range_basis(whitener.project(whole - own))
    seen, left = whitener.project(own), y - rest @ (rest.T @ y)
    gain = likelihood_gain(seen - rest @ (rest.T @ seen), left)
    return gain > min(CLEAR, ELSEWHERE * likelihood_gain(whitener.project(whole), y))


def is_resolved(rows: Rows, levels: FloatArray, turn: int) -> bool:
    """Whether most of what a turn may err by, at some levels, is no matter of its samples."""
    if not rows.aliased:
        return True
    own = np.flatnonzero(rows.segment[: rows.n_dense] == turn)
    return bool(np.median((rows.missed(levels) / rows.variance(levels))[own]) < MOSTLY)


def told_by_one_turn(
    rows: Rows, columns: FloatArray, levels: FloatArray, whitener: Whitener, y: FloatArray
) -> bool:
    """Whether one turn alone tells of an effect, and errs mostly by what its samples do not tell.

    Parameters
    ----------
    rows : Rows
    columns : (m, k) array
        Of the effect.
    levels : (c,) array
        Of the noise.
    whitener : Whitener
        At these levels, with all that is fitted projected out.
    y : (m,) array
        Whitened projected residual.
    """
    unresolved = rows.missed(levels)
    if not unresolved.any():
        return False
    seen = whitener.project(columns)
    fit = np.square(seen @ np.linalg.lstsq(seen, y, rcond=1e-9)[0])
    power = np.bincount(rows.segment, fit)
    turn = int(np.argmax(np.where(rows.is_rest, -1.0, power)))
    own = np.flatnonzero(rows.segment == turn)
    total = 0.5 * float(fit.sum())
    if 2 * power[turn] < fit.sum() or own[-1] >= rows.n_dense:
        return False
    share = unresolved[own] / rows.variance(levels)[own]
    if fit[own] @ share < MOSTLY * power[turn]:
        return False
    # With a column for each of its rows, these rows say nothing.
    alone = np.zeros((len(columns), len(own)))
    alone[own, np.arange(len(own))] = 1.0
    basis = range_basis(whitener.project(alone))
    seen, left = seen - basis @ (basis.T @ seen), y - basis @ (basis.T @ y)
    return likelihood_gain(seen, left) < ELSEWHERE * total
