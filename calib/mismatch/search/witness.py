"""Which turns tell of an effect: one alone, that its samples do not resolve, is no witness.

By how much samples miss a turn is known to a factor of two or so, and the worst turn of a recording
can miss by several times what is expected of it. An effect whose column is large in that turn
explains it as well as any jolt would. Another turn, or a rest, has to show it too.
"""

from __future__ import annotations

import numpy as np

from calib.effects import get_effect
from calib.mismatch.noise.noise import Whitener, range_basis
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.ranking import COUNTS, Ranking
from calib.mismatch.search.refine import likelihood_gain
from calib.types import FloatArray

ELSEWHERE = 0.25
"""Share of what an effect gains that rows outside of one turn must tell."""


def witnessed(rows: Rows, ranking: Ranking, whitener: Whitener, y: FloatArray) -> dict[str, float]:
    """Return the groups of a ranking without effects that last and that one turn alone tells of."""
    tried = [
        g
        for g, v in ranking.groups.items()
        if v > np.log(COUNTS)
        and ranking.best[g].physical
        and get_effect(ranking.best[g].name).kind != "event"
    ]
    alone = [
        g
        for g in tried
        if told_by_one_turn(rows, ranking.stack.of(ranking.best[g]), ranking.levels, whitener, y)
    ]
    return {g: v for g, v in ranking.groups.items() if g not in alone}


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
    if fit[own] @ share < 0.5 * power[turn]:
        return False
    # With a column for each of its rows, these rows say nothing.
    alone = np.zeros((len(columns), len(own)))
    alone[own, np.arange(len(own))] = 1.0
    basis = range_basis(whitener.project(alone))
    seen, left = seen - basis @ (basis.T @ seen), y - basis @ (basis.T @ y)
    return likelihood_gain(seen, left) < ELSEWHERE * total
