"""The alignment beside a truth, and shapes that bear on it, fitted together."""

from __future__ import annotations

from dataclasses import replace

from calib.effects import get_effect
from calib.mismatch.hypotheses.families import candidate_columns
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.estimate import settle
from calib.mismatch.search.refit import Problem, refit
from calib.mismatch.search.whole import CLOCK
from calib.types import FloatArray


def resettled(
    problem: Problem,
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    contrast: FloatArray,
) -> tuple[Rows, list[Accepted]]:
    """Return rows that are aligned beside the best shapes of what the model has not taken up.

    A low-pass is late by what its cut-off says, and what it takes away comes when the clocks say:
    where these are off by a hundredth of that delay, the cut-off is wrong by as much.
    """
    free = [i for i, a in enumerate(accepted) if _is_free(a)]
    if not (CLOCK in rows.aligned and free):
        return rows, accepted
    accepted = list(accepted)
    rows = _with_clock(rows, [accepted[i] for i in free])
    _, best = settle(rows, accepted, levels, contrast, reference=problem.reference)
    for i in free:
        accepted[i] = replace(accepted[i], candidate=best[i].candidate, columns=best[i].columns)
    rows, accepted, _, _ = refit(problem, rows, accepted, levels, refine=False)
    return _with_clock(rows, [accepted[i] for i in free]), accepted


def _is_free(a: Accepted) -> bool:
    """Whether the model has not taken up a finding with a size that is no matter of proportion."""
    sizes = get_effect(a.candidate.name).shape if a.candidate.physical else ()
    return not a.in_model and any(s.spacing == "log" for s in sizes)


def _with_clock(rows: Rows, beside: list[Accepted]) -> Rows:
    """Return rows where the clocks' offset moves what these take away as well, not the truth alone.

    All of them act alike at any time: so they do on what a step of the clocks adds to the truth.
    """
    state = rows.state
    moved = replace(state, force=-state.force_dot, rate=-state.rate_dot, angular_acceleration=None)
    there = replace(rows, state=moved)
    nuisance = rows.nuisance.copy()
    for a in beside:
        columns = candidate_columns(there, a.candidate, a.candidate.shape, reference=True)
        if columns is not None:
            nuisance[:, rows.aligned.index(CLOCK)] += columns.sum(axis=1)
    return replace(rows, nuisance=nuisance)
