"""The search: the best explanation, refitted with all that was found, until nothing is left.

Each round asks whether anything is left (the average of all Bayes factors, an e-value), and what:
the physics of the catalogue against each other and against honest rivals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from calib.mismatch.hypotheses.answers import evidence_near, grouped, leading, nearby
from calib.mismatch.hypotheses.bound import factors_that_count
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.windows import has_ends
from calib.mismatch.noise.noise import (
    Levels,
    Whitener,
    bare_levels,
    estimate_levels,
    expected_levels,
    make_whitener,
)
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import (
    Accepted,
    accept,
    again,
    contrast_noise,
    fitted,
    joined,
    lasting,
)
from calib.mismatch.search.choice import LEAST, Choice, choose, is_part, possible
from calib.mismatch.search.counts import parts_of_samples
from calib.mismatch.search.determined import determined
from calib.mismatch.search.estimate import Estimate, estimate, settle
from calib.mismatch.search.late import with_delay
from calib.mismatch.search.ranking import Ranking, make_stack, rank, with_fullest
from calib.mismatch.search.refit import Problem, Refit, put_back, refit, unmoved
from calib.mismatch.search.resettled import resettled
from calib.mismatch.search.twins import MIMICKED, turns_about_up, twins
from calib.mismatch.search.whole import whole_fit, whole_odds
from calib.types import FloatArray

TIE = 0.05
"""Posterior probability above which another name is reported as a rival."""

KEEP = 0.0
"""Log evidence below which an earlier finding is dropped, given the later ones."""

TWIN = 0.01
"""`TIE` for another effect of the catalogue: what sizes are typical is a weak argument between
two that a recording cannot tell apart."""

SHOWN = 1e-3
"""Posterior probability below which nothing is said of a group."""

BETWEEN = 20.0
"""Log evidence that a place between two of the grid may add, or as much again as it has there: they
are near enough for the larger part of an effect to show at one of them."""

LED = 5.0
"""Log evidence by which rivals lead before physics is tried as it is, and which it must mend: what
levels that are found step by step leave uncertain is less."""

ROUNDS = 8
"""At most so many findings are tried."""

BEATEN, EXCHANGES = 10.0, 3
"""Odds of another explanation from which on a finding is looked for anew, without it; and how
often, at most."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the search ends with: rows, what was accepted, and the noise under all of it.

    What was accepted is in the rows: its values are zero, and its sizes are yet to be estimated.
    """

    rows: Rows
    accepted: tuple[Accepted, ...]
    levels: FloatArray
    contrast: FloatArray
    total: float
    tried: frozenset[str]
    """Effects that the rows could show."""
    undetermined: tuple[str, ...] = ()
    """Parameters of what was found that the rows leave open."""

    def fit(self, *, reference: bool) -> Estimate:
        """Fit everything jointly."""
        return estimate(self.rows, self.accepted, self.levels, self.contrast, reference=reference)


@dataclass(frozen=True, eq=False)
class _State:
    """Where a search stands: rows, what was accepted, and every candidate beside it.

    ``seen`` is what is always fitted, as it was when the columns of the candidates were made, and
    ``broken`` are groups that would be the loss of a part of a sample.
    """

    rows: Rows
    accepted: list[Accepted]
    stack: Stack
    seen: FloatArray
    ranking: Ranking
    broken: frozenset[str] = frozenset()


class _Judged(NamedTuple):
    """Where a search ended, under the noise of all that was found.

    ``odds`` are the posteriors of every group in the place of each finding, ``against`` how many
    times the others together are as probable there, and ``instead`` the best of them, if any.
    """

    state: _State
    levels: FloatArray
    contrast: FloatArray
    odds: list[dict[str, float]]
    against: list[float]
    instead: list[str | None]


def search(problem: Problem, *, skip: tuple[str, ...] = ()) -> Outcome:
    """Find what was left out, one hypothesis after another."""
    found = _judged(problem, _rounds(problem, _start(problem, skip=skip), skip=skip))
    for _ in range(EXCHANGES):
        if max(found.against, default=0.0) < BEATEN:
            break
        other = _exchanged(problem, found, skip=skip)
        if other is None:
            break
        found = other
    if not problem.reference and max(found.against, default=0.0) >= BEATEN:
        # Between those that are tried a place may tell far more: what is said to be there is.
        # Beside a truth all samples tell of places.
        found = _exchanged(problem, found, skip=skip, by_name=True) or found
    state, levels, contrast = found.state, found.levels, found.contrast
    rows, stack = state.rows, state.stack
    accepted = [replace(a, posterior=p) for a, p in zip(state.accepted, found.odds, strict=True)]
    accepted = [
        whole_odds(problem, rows, stack, accepted, i, levels, mimicked=MIMICKED, least=2 * TWIN)
        for i in range(len(accepted))
    ]
    rows, accepted = resettled(problem, rows, accepted, levels, contrast)
    if not problem.reference:
        rows = with_delay(rows, accepted)
    rows, accepted = settle(rows, accepted, levels, contrast, reference=problem.reference)
    undetermined: tuple[str, ...] = ()
    if not problem.reference:
        # Beside a truth what windows say of the errors comes later, and drops what they do not.
        accepted, undetermined = determined(rows, accepted, levels, contrast)
    tried = frozenset(c.name for c in stack.physics.values())
    total = state.ranking.total
    return Outcome(rows, tuple(accepted), levels, contrast, total, tried, undetermined)


def _start(problem: Problem, *, skip: tuple[str, ...]) -> _State:
    """Return where a search starts: with nothing, or with the first of two that only both show."""
    accepted: list[Accepted] = []
    rows = problem.rows()
    stack, seen = make_stack(rows, skip=skip, reference=problem.reference), fitted(rows, [])
    ranking = rank(rows, stack, accepted, expected_levels(rows), base=bare_levels(rows))
    if not ranking.claims and ranking.pair is not None:
        (value, first), every = ranking.pair, ranking.every
        accepted.append(accept(stack, first, float(np.exp(value))))
        rows, accepted, levels, straight = refit(problem, rows, accepted, ranking.levels)
        if not (straight and unmoved(seen, rows)):
            del stack, ranking
            stack, seen = make_stack(rows, skip=skip, reference=problem.reference), fitted(rows, [])
        ranking = rank(rows, stack, accepted, levels, every=every)
    return _State(rows, accepted, stack, seen, ranking)


def _rounds(
    problem: Problem, state: _State, *, skip: tuple[str, ...], first: Candidate | None = None
) -> _State:
    """Go on until nothing is left; from what is ``first``, if anything is given."""
    rows, accepted, stack = state.rows, state.accepted, state.stack
    seen, ranking = state.seen, state.ranking
    dropped: set[str] = set()
    broken = set(state.broken)
    been = {_place_of(accepted)}
    del state
    for _ in range(ROUNDS):
        if not ranking.claims:
            break
        chosen = choose(rows, ranking, accepted)
        if first is not None:
            chosen, first = Choice(first, ranking.total), None
        if chosen is None:
            break
        rows, accepted, levels, straight = _fit_chosen(
            problem, rows, ranking, accepted, chosen, broken, skip=skip
        )
        extra, base = _superfluous(rows, accepted, levels)
        gone = _parts_of_last(rows, accepted)
        if extra is not None and extra not in gone and extra.candidate.group not in dropped:
            gone.append(extra)
        if gone:
            # What is found again after that is there, and not dropped in turn.
            dropped.update(a.candidate.group for a in gone if lasting(a.candidate))
            accepted = [a for a in accepted if a not in gone]
            if any(a.in_model for a in gone):
                rows = put_back(problem, rows, accepted)
            rows, accepted, levels, also = refit(problem, rows, accepted, levels)
            straight, base = straight and also, None
        every = ranking.every
        if not (straight and unmoved(seen, rows)):
            del stack, ranking  # their columns are most of the memory that is used
            stack, seen = make_stack(rows, skip=skip, reference=problem.reference), fitted(rows, [])
        ranking = rank(rows, stack, accepted, levels, base=base, every=every)
        if (place := _place_of(accepted)) in been:
            # What was found last was found before: it has taken the place of its like.
            break
        been.add(place)
    broken -= {a.candidate.group for a in accepted}
    return _State(rows, accepted, stack, seen, ranking, frozenset(broken))


def _place_of(accepted: list[Accepted]) -> frozenset[tuple[object, ...]]:
    """Return where a search stands, to tell whether it was there before."""
    return frozenset(
        (
            a.candidate.group,
            a.candidate.parameters,
            a.candidate.interval,
            *(f"{name} {value:.3g}" for name, value in a.candidate.shape.items()),
        )
        for a in accepted
    )


def _judged(problem: Problem, state: _State) -> _Judged:
    """Weigh what was found against what else may be there."""
    rows, accepted = state.rows, state.accepted
    contrast = contrast_noise(rows, accepted)
    # The ranking took the better of two maxima: its own is left to be approached more closely.
    levels = estimate_levels(rows, fitted(rows, accepted), state.ranking.levels).values
    odds, against, instead = [], [], list[str | None]()
    for i, a in enumerate(accepted):
        every = _posterior(rows, state.stack, accepted, i, levels, reference=problem.reference)
        odds.append({g: v for g, v in every.items() if g not in state.broken})
        others = {g: v for g, v in odds[-1].items() if g != a.candidate.group}
        own = max(odds[-1].get(a.candidate.group, 0.0), SHOWN)
        against.append(sum(others.values()) / own)
        instead.append(max(others, key=others.__getitem__, default=None))
    return _Judged(state, levels, contrast, odds, against, instead)


def _exchanged(
    problem: Problem, found: _Judged, *, skip: tuple[str, ...], by_name: bool = False
) -> _Judged | None:
    """Return what a search finds without the finding that is beaten most; None if no better.

    What is taken first is taken beside all that is found later, and may be part of that. If
    ``by_name``, the physics that beats it takes its place, whatever is more probable where places
    are tried.
    """
    place, state = problem.place(), found.state
    which = int(np.argmax(found.against))
    accepted = [a for i, a in enumerate(state.accepted) if i != which]
    rows = put_back(problem, state.rows, accepted)
    rows, accepted, levels, _ = refit(problem, rows, accepted, found.levels, refine=False)
    stack, seen = make_stack(rows, skip=skip, reference=problem.reference), fitted(rows, [])
    ranking = rank(rows, stack, accepted, levels)
    left = _State(rows, accepted, stack, seen, ranking, state.broken)
    first = ranking.best.get(found.instead[which] or "") if by_name else None
    if by_name and (
        first is None
        or not first.physical
        or again(first, accepted)
        or is_part(rows, first, accepted)
    ):
        problem.go_back(place)
        return None
    other = _judged(problem, _rounds(problem, left, skip=skip, first=first))
    better = bool(other.state.accepted) and max(other.against) < max(found.against)
    if by_name:
        # Nor may it leave anything that was explained before.
        better &= found.state.ranking.claims or not other.state.ranking.claims
    if better:
        return other
    problem.go_back(place)
    return None


def _fit_chosen(
    problem: Problem,
    rows: Rows,
    ranking: Ranking,
    accepted: list[Accepted],
    chosen: Choice,
    broken: set[str],
    *,
    skip: tuple[str, ...],
) -> Refit:
    """Fit what was chosen; something else, if that would be the loss of a part of a sample.

    A gain that is off for two turns is a sample less in one of them, but for a third of it. What
    would be ``broken`` so is added to that.
    """
    place = problem.place()
    fit = _bent(problem, rows, ranking, accepted, chosen, skip=skip)
    if fit is None:
        fit = _fit_with(problem, rows, ranking, accepted, chosen.candidate, chosen.worth)
    new = fit.accepted[-1]
    parts = parts_of_samples(fit.rows, fit.accepted, fit.levels)
    if new not in parts:
        return fit
    other = choose(rows, ranking, accepted, passed=frozenset({new.candidate.group}))
    if other is None:
        return fit
    problem.go_back(place)
    broken.add(new.candidate.group)
    return _fit_chosen(problem, rows, ranking, accepted, other, broken, skip=skip)


def _fit_with(
    problem: Problem,
    rows: Rows,
    ranking: Ranking,
    accepted: list[Accepted],
    chosen: Candidate,
    worth: float,
) -> Refit:
    """Fit a candidate with all that was accepted, and move the model there."""
    new = accept(ranking.stack, chosen, float(np.exp(min(worth, 700))))
    levels = ranking.levels_with(chosen)
    fit = whole_fit(problem, rows, ranking.stack, accepted, new, levels)
    if fit is not None:
        return fit
    both = joined(rows, accepted, new, reference=problem.reference)
    return refit(problem, rows, both, levels)


def _bent(
    problem: Problem,
    rows: Rows,
    ranking: Ranking,
    accepted: list[Accepted],
    chosen: Choice,
    *,
    skip: tuple[str, ...],
) -> Refit | None:
    """Return the fit of plain physics in the place of rivals, if it leaves less than their lead.

    Where rows go as columns promise it leaves what they lead by. What moves the twin so far that
    rows are bent is behind them for that alone: a bias that steps by a degree a second, in a turn,
    leaves the square of it in all turns, of which a fluctuation takes up more than a step does.
    Nor do axes that lie a degree off go as promised; rests that lean as they like close any turn.
    What other physics takes up then is left by that, and not by what was tried.
    """
    place = problem.place()
    for leader, lead in chosen.behind:
        if lead <= LED:
            continue
        fullest = with_fullest(ranking.stack, ranking.evidence, leader)[-1]
        candidate = leader if fullest.shape else fullest
        fit = _fit_with(problem, rows, ranking, accepted, candidate, chosen.worth)
        if not fit.straight:
            stack = make_stack(fit.rows, skip=skip, reference=problem.reference)
            after = rank(fit.rows, stack, fit.accepted, fit.levels, every=ranking.every)
            rivals = [v for g, v in after.groups.items() if not after.best[g].physical]
            if lead - max(float(logsumexp(rivals)), 0.0) > LED:
                return fit
        problem.go_back(place)
    return None


def _parts_of_last(rows: Rows, accepted: list[Accepted]) -> list[Accepted]:
    """Return earlier events that are part of something unexplained that was found last.

    What explains more, and reaches over the moment of an event on its channels, is no second cause
    there: where an output wanders, the first thing to be seen is a step, or several, all of which
    go with one of them.
    """
    *earlier, last = accepted
    if last.candidate.physical or last.candidate.interval is None:
        return []
    parts = [a for a in earlier if is_part(rows, a.candidate, [last])]
    return parts if any(a.e_value < last.e_value for a in parts) else []


def _superfluous(
    rows: Rows, accepted: list[Accepted], start: FloatArray
) -> tuple[Accepted | None, Levels | None]:
    """Return the finding that later ones have made worthless, if there is one.

    Beside it the levels with all findings in the mean, from some to start from, where they are
    wanted: drift must not take up again what these explained.
    """
    earlier = accepted[:-1]
    if not earlier:
        return None, None
    contrast = contrast_noise(rows, accepted)
    base = estimate_levels(rows, fitted(rows, accepted), start)
    worst: tuple[float, Accepted | None] = (KEEP, None)
    for a in earlier:
        others = [b for b in accepted if b is not a]
        judged = rows.judging(a.candidate.name) if a.candidate.physical else rows
        whitener = make_whitener(judged, base.values, contrast, fitted(judged, others))
        residual = rows.residual + a.columns @ (a.values / a.typical)
        value = _as_it_is(rows, a, whitener, whitener.project(residual))
        if value < worst[0]:
            worst = (value, a)
    return worst[1], base


def _as_it_is(rows: Rows, a: Accepted, whitener: Whitener, y: FloatArray) -> float:
    """Return the log evidence for a finding of its own shape, and for no others."""
    own = Stack(len(rows.residual))
    index = own.columns.add(a.columns)
    own.add(replace(a.candidate, index=index, summed=False, mixing=None))
    return float(own.log_bayes_factors(whitener, y)[0]) + float(np.log(a.candidate.weight))


def _is_there(candidate: Candidate, placed: Candidate) -> bool:
    """Whether a candidate is another kind of what was placed in a window, on the same channels.

    All kinds were weighed where that is, over all windows: what one of them has in its best window
    was said already, of the window that overlaps most.
    """
    own, other = placed.interval, candidate.interval
    if own is None or other is None or candidate.channels != placed.channels:
        return False
    return has_ends(candidate) and has_ends(placed) and own[0] < other[1] and other[0] < own[1]


def _posterior(
    rows: Rows,
    stack: Stack,
    accepted: list[Accepted],
    which: int,
    levels: FloatArray,
    *,
    reference: bool,
) -> dict[str, float]:
    """Return the posterior of every group in the place of one finding, the others kept.

    What would have to be of an impossible size is something else, beside the finding, and no rival.
    The finding itself may have come to be so since it was chosen.
    """
    others = [b for i, b in enumerate(accepted) if i != which]
    own = accepted[which]
    if own.candidate.physical:
        rows = rows.judging(own.candidate.name)
    mean = fitted(rows, others)
    whitener = make_whitener(rows, levels, contrast_noise(rows, others), mean)
    residual = rows.residual
    if own.in_model:
        residual = residual + own.columns @ (own.values / own.typical)
    y = whitener.project(residual)
    weight = stack.weight
    evidence = factors_that_count(stack, rows, whitener, y)[0] + weight
    best, groups = grouped(stack, evidence)
    least = logsumexp(list(groups.values())) + np.log(SHOWN)
    for g in leading(best, groups):
        if groups[g] + max(groups[g], BETWEEN) < least:
            continue
        near = nearby(rows, best[g])
        if len(near):
            i = stack.index(best[g])
            evidence[i] = max(evidence[i], evidence_near(rows, near, whitener, y) + weight[i])
    best, groups = grouped(stack, evidence)
    if own.candidate.present:
        # Its cut-off lies between those of the grid, which a strong one is far from.
        value = _as_it_is(rows, own, whitener, y)
        groups[own.candidate.group] = max(groups.get(own.candidate.group, -np.inf), value)
    if own.candidate.interval is not None and own.candidate.group in groups:
        # Its window lies between those of the grid.
        value = _as_it_is(rows, own, whitener, y)
        there = (groups[g] for g in groups if _is_there(best[g], own.candidate))
        groups[own.candidate.group] = max(groups[own.candidate.group], value, *there)
    likely = {g: possible(stack, best[g], whitener, y) if g in best else 0.0 for g in groups}
    groups = {
        g: v + max(likely[g], LEAST if g == own.candidate.group else -np.inf)
        for g, v in groups.items()
        if g == own.candidate.group or likely[g] > -np.inf
    }
    total = logsumexp(list(groups.values()))
    out = {g: float(np.exp(v - total)) for g, v in groups.items() if v - total > np.log(SHOWN)}
    if own.candidate.physical:
        for g in twins(rows, stack, own, evidence, whitener, y, reference=reference):
            if g in groups:
                out[g] = max(out.get(g, 0.0), 2 * TWIN)
        gravity = rows.state.gravity
        other = turns_about_up(own, whitener, y, gravity=gravity, reference=reference)
        if other is not None and likely.get(other, 0.0) > -np.inf:
            # The Earth turns everywhere but at its equator.
            out[other] = max(out.get(other, 0.0), out.get(own.candidate.group, 0.0))
    return out
