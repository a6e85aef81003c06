"""The search: the best explanation, refitted with all that was found, until nothing is left.

Each round asks whether anything is left (the average of all Bayes factors, an e-value), and what:
the physics of the catalogue against each other and against honest rivals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, logsumexp

from calib.effects import get_effect
from calib.mismatch.hypotheses.answers import evidence_near, grouped, leading, nearby
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import candidate_columns
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.noise import (
    Whitener,
    estimate_levels,
    expected_levels,
    make_whitener,
)
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.estimate import Estimate, estimate, pseudo_inverse, settle
from calib.mismatch.search.ranking import (
    CLAIM,
    DRIFTING,
    Accepted,
    Ranking,
    contrast_noise,
    fitted,
    make_stack,
    rank,
)
from calib.mismatch.search.refit import Problem, put_back, refit, unmoved
from calib.mismatch.search.twins import MIMICKED, twins
from calib.mismatch.search.whole import whole_fit, whole_odds
from calib.mismatch.search.witness import witnessed
from calib.types import FloatArray

TIE = 0.05
"""Posterior probability above which another name is reported as a rival."""

KEEP = 0.0
"""Log evidence below which an earlier finding is dropped, given the later ones."""

TWIN = 0.01
"""The same for another effect of the catalogue: what sizes are typical is a weak argument between
two that a recording cannot tell apart."""

FIRST = float(np.log(2.0))
"""Log odds by which rivals must lead before what physics explains nearly as well is unexplained, if
physics alone reaches the claim. Either way both are said. A technician who is told a name can
check it."""

SHOWN = 1e-3
"""Posterior probability below which nothing is said of a group."""

BETWEEN = 20.0
"""Log evidence that a place between two of the grid may add, or as much again as it has there: they
are near enough for the larger part of an effect to show at one of them."""

SURE = 3.0
"""Standard errors by which an effect must be beyond what is physical to be none."""

LEAST = float(log_ndtr(-SURE) - log_ndtr(0.0))
"""Log probability of what is that far beyond."""

ROUNDS = 8
"""At most so many findings are tried."""


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

    def fit(self, *, reference: bool) -> Estimate:
        """Fit everything jointly."""
        return estimate(self.rows, self.accepted, self.levels, self.contrast, reference=reference)


def search(problem: Problem, *, skip: tuple[str, ...] = ()) -> Outcome:
    """Find what was left out, one hypothesis after another."""
    accepted: list[Accepted] = []
    dropped: set[str] = set()
    rows = problem.rows()
    stack, seen = make_stack(rows, skip=skip, reference=problem.reference), fitted(rows, [])
    ranking = rank(rows, stack, accepted, expected_levels(rows))
    if not ranking.claims and ranking.pair is not None:
        value, first = ranking.pair
        accepted.append(_accept(stack, first, float(DRIFTING * np.exp(value))))
        rows, accepted, levels, straight = refit(problem, rows, accepted, ranking.levels)
        if not (straight and unmoved(seen, rows)):
            del stack, ranking
            stack, seen = make_stack(rows, skip=skip, reference=problem.reference), fitted(rows, [])
        ranking = rank(rows, stack, accepted, levels)
    for _ in range(ROUNDS):
        if not ranking.claims:
            break
        chosen = choose(rows, ranking, accepted)
        if chosen is None:
            break
        new = _accept(stack, chosen, float(np.exp(min(ranking.worth, 700))))
        beside = ranking.levels_with(chosen)
        fit = whole_fit(problem, rows, stack, accepted, new, beside)
        if fit is None:
            accepted = _with(rows, accepted, new, reference=problem.reference)
            fit = refit(problem, rows, accepted, beside)
        rows, accepted, levels, straight = fit
        extra = _superfluous(rows, accepted, levels)
        if extra is not None and extra.candidate.group not in dropped:
            if _lasting(extra.candidate):
                # What is found again after that is there, and not dropped in turn.
                dropped.add(extra.candidate.group)
            accepted = [a for a in accepted if a is not extra]
            if extra.in_model:
                rows = put_back(problem, rows, accepted)
            rows, accepted, levels, again = refit(problem, rows, accepted, levels)
            straight &= again
        if not (straight and unmoved(seen, rows)):
            del stack, ranking  # their columns are most of the memory that is used
            stack, seen = make_stack(rows, skip=skip, reference=problem.reference), fitted(rows, [])
        ranking = rank(rows, stack, accepted, levels)
    contrast = contrast_noise(rows, accepted)
    # The ranking took the better of two maxima: its own is left to be approached more closely.
    levels = estimate_levels(rows, fitted(rows, accepted)[: rows.n_dense], ranking.levels).values
    accepted = [
        replace(
            a,
            posterior=_posterior(rows, stack, accepted, i, levels, reference=problem.reference),
        )
        for i, a in enumerate(accepted)
    ]
    accepted = [
        whole_odds(problem, rows, stack, accepted, i, levels, mimicked=MIMICKED, least=2 * TWIN)
        for i in range(len(accepted))
    ]
    rows, accepted = settle(rows, accepted, levels, contrast, reference=problem.reference)
    tried = frozenset(c.name for c in stack.physics.values())
    return Outcome(rows, tuple(accepted), levels, contrast, ranking.total, tried)


def choose(rows: Rows, ranking: Ranking, accepted: list[Accepted]) -> Candidate | None:
    """Return what explains most: physics, unless the rivals together are more probable.

    An event where something is unexplained already is part of that, and gets no name of its own.
    What an effect leaves that was found already is no second finding of it. What no channel of it
    shows is another cause, and lends it no weight. Nor does a turn that samples do not resolve, of
    what it alone shows.
    """
    best = ranking.best
    mean, contrast = fitted(rows, accepted), contrast_noise(rows, accepted)
    whitener = make_whitener(rows, ranking.levels, contrast, mean)
    y = whitener.project(rows.residual)
    groups = {
        g: v + _possible(ranking.stack, best[g], whitener, y)
        for g, v in witnessed(rows, ranking, whitener, y).items()
        if not _within(rows, best[g], accepted) and not _again(best[g], accepted)
    }
    groups = {g: v for g, v in groups.items() if v > -np.inf}
    ranking = replace(ranking, groups=groups)
    if not ranking.claims:
        return None
    if ranking.total < np.log(CLAIM / DRIFTING):
        # Not enough for what a drift can mimic by itself.
        groups = ranking.discounted
        others = [v for g, v in groups.items() if g not in ranking.drifting]
        if max(groups, key=lambda g: groups[g]) not in ranking.drifting and (
            logsumexp(others) < np.log(CLAIM)
        ):
            # Nor does it lend its weight to a name that is less probable.
            return None
    chosen = _most_probable(rows, ranking, groups, accepted)
    if chosen is None:
        return None
    alike = [v for g, v in groups.items() if set(best[g].channels) & set(chosen.channels)]
    return chosen if logsumexp(alike) >= np.log(CLAIM) else None


def _most_probable(
    rows: Rows, ranking: Ranking, groups: Mapping[str, float], accepted: list[Accepted]
) -> Candidate | None:
    """Return the best of the more probable side, physics or rivals, by what the groups count."""
    best = ranking.best
    physical = [g for g in groups if best[g].physical]
    rival = [g for g in groups if not best[g].physical]
    top = max(physical, key=lambda g: groups[g], default=None)
    other = max(rival, key=lambda g: groups[g], default=None)
    if top is None:
        return None if other is None else best[other]
    if other is None:
        return best[top]
    for_physics = logsumexp([groups[g] for g in physical])
    for_rivals = logsumexp([groups[g] for g in rival])
    ahead = for_physics - for_rivals
    if ahead >= 0 or (ahead >= -FIRST and for_physics >= np.log(CLAIM)):
        return best[top]
    # Two causes at once can look like one smooth rival: let physics try twice.
    if groups[top] > np.log(CLAIM):

        def beside(first: Candidate) -> Ranking:
            taken = _accept(ranking.stack, first, 1.0)
            levels = ranking.levels_with(first)
            return rank(rows, ranking.stack, [*accepted, taken], levels)

        second = beside(best[top])
        left = {g: v for g, v in second.groups.items() if second.best[g].physical}
        also = max(left, key=lambda g: left[g], default=None)
        if (
            also is not None
            and groups[top] + left[also] > for_rivals
            and left[also] > np.log(CLAIM)
        ):
            # A cause that is there beside the rival as well speaks for neither.
            apart = max(beside(best[other]).groups.get(also, 0.0), 0.0)
            if groups[top] + left[also] > for_rivals + apart:
                return best[top]
    return best[other]


def _within(rows: Rows, candidate: Candidate, accepted: list[Accepted]) -> bool:
    """Whether a candidate is part of what was accepted, and no second cause.

    So is an event in, or at the edge of, what is unexplained in one of its channels; and what is
    left in the turn of an event that was linearised at its moment.
    """
    event = candidate.physical and get_effect(candidate.name).kind == "event"
    moment = candidate.shape.get("moment")
    for a in accepted:
        if not set(a.candidate.channels) & set(candidate.channels):
            continue
        if a.candidate.physical:
            if not a.in_model and "moment" in a.candidate.shape:
                start, stop = _around(rows, a.candidate.shape["moment"])
                first, last = candidate.interval or (moment, moment)
                if first is not None and last is not None and start <= first and last <= stop:
                    return True
            continue
        if not event:
            continue
        if a.candidate.interval is None or moment is None:
            return True
        start, stop = a.candidate.interval
        edge = 0.5 * (stop - start)
        if start - edge <= moment <= stop + edge:
            return True
    return False


def _around(rows: Rows, moment: float) -> tuple[float, float]:
    """Return the rest or turn that a moment lies in, with those beside it."""
    k = int(np.searchsorted(rows.interval[:, 0], moment, side="right")) - 1
    return float(rows.interval[max(k - 1, 0), 0]), float(rows.interval[: k + 2, 1].max())


def _again(candidate: Candidate, accepted: list[Accepted]) -> bool:
    """Whether an effect was found already on all that a candidate touches."""
    return _lasting(candidate) and any(
        set(candidate.parameters) <= set(a.candidate.parameters)
        for a in accepted
        if a.candidate.name == candidate.name
    )


def _possible(stack: Stack, candidate: Candidate, whitener: Whitener, y: FloatArray) -> float:
    """Return how probable it is that an effect is no larger than any is, at best, as a logarithm.

    What would have to be clearly larger mimics something else: -inf.
    """
    if not candidate.physical:
        return 0.0
    about = {p.name: p for p in get_effect(candidate.name).parameters}
    least, most = (
        np.array([getattr(about[n], bound) for n in candidate.parameters])
        for bound in ("least", "most")
    )
    if not np.isfinite([least, most]).any():
        return 0.0
    columns = whitener.project(stack.of(candidate))
    inverse = pseudo_inverse(columns)
    typical = np.array([about[n].typical for n in candidate.parameters])
    value = typical * (inverse @ y)
    sigma = typical * np.linalg.norm(inverse, axis=1)
    beyond = np.maximum(np.maximum(value - most, least - value), 0.0)
    beyond = np.divide(beyond, sigma, out=np.zeros(len(value)), where=beyond > 0)
    if (beyond > SURE).any():
        return -np.inf
    return float((log_ndtr(-beyond) - log_ndtr(0.0)).sum())


def _lasting(candidate: Candidate) -> bool:
    """Whether a candidate is physics that a recording has once, and not at each of many moments."""
    return candidate.physical and get_effect(candidate.name).kind != "event"


def _with(
    rows: Rows, accepted: list[Accepted], new: Accepted, *, reference: bool
) -> list[Accepted]:
    """Return the findings with a new one; other parameters of one effect are one finding.

    But for what is there or not: how strong it is is in a shape, and each channel has its own.
    """
    old = next((a for a in accepted if a.candidate.name == new.candidate.name), None)
    if old is None or not _lasting(new.candidate) or new.candidate.present:
        return [*accepted, new]
    effect = get_effect(new.candidate.name)
    shape = {**new.candidate.shape, **old.candidate.shape}
    both = {*old.candidate.parameters, *new.candidate.parameters}
    chosen = [p for p in effect.parameters if p.name in both]
    names = tuple(p.name for p in chosen)
    candidate = replace(
        old.candidate,
        index=np.arange(len(names)),
        parameters=names,
        channels=tuple(dict.fromkeys(c for p in chosen for c in p.channels)),
        shape=shape,
    )
    columns = candidate_columns(rows, candidate, shape, reference=reference)
    if columns is None:
        return [*accepted, new]
    values = dict(zip(old.candidate.parameters, old.values, strict=True))
    merged = replace(
        old,
        candidate=candidate,
        columns=columns,
        typical=np.array([p.typical for p in chosen]),
        values=np.array([values.get(n, 0.0) for n in names]),
    )
    return [*(a for a in accepted if a is not old), merged]


def _accept(stack: Stack, chosen: Candidate, e_value: float) -> Accepted:
    columns = stack.of(chosen)
    typical = np.ones(columns.shape[1])
    if chosen.physical:
        sizes = {p.name: p.typical for p in get_effect(chosen.name).parameters}
        typical = np.array([sizes[n] for n in chosen.parameters])
    return Accepted(chosen, columns, typical, np.zeros(columns.shape[1]), False, e_value)


def _superfluous(rows: Rows, accepted: list[Accepted], levels: FloatArray) -> Accepted | None:
    """Return the finding that later ones have made worthless, if there is one."""
    earlier = accepted[:-1]
    if not earlier:
        return None
    contrast = contrast_noise(rows, accepted)
    # With all findings in the mean: drift must not take up again what they explained.
    levels = estimate_levels(rows, fitted(rows, accepted)[: rows.n_dense], levels).values
    worst: tuple[float, Accepted | None] = (KEEP, None)
    for a in earlier:
        others = [b for b in accepted if b is not a]
        judged = rows.judging(a.candidate.name) if a.candidate.physical else rows
        whitener = make_whitener(judged, levels, contrast, fitted(judged, others))
        own = Stack(len(rows.residual))
        index = own.columns.add(a.columns)
        own.add(replace(a.candidate, index=index, summed=False, mixing=None))
        residual = rows.residual + a.columns @ (a.values / a.typical)
        value = own.log_bayes_factors(whitener, whitener.project(residual))[0]
        value += np.log(a.candidate.weight)
        if value < worst[0]:
            worst = (float(value), a)
    return worst[1]


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
    evidence = stack.log_bayes_factors(whitener, y) + weight
    best, groups = grouped(stack, evidence)
    least = logsumexp(list(groups.values())) + np.log(SHOWN)
    for g in leading(best, groups):
        if groups[g] + max(groups[g], BETWEEN) < least:
            continue
        near = nearby(rows, best[g])
        if len(near):
            i = stack.index(best[g])
            factors = near.log_bayes_factors(whitener, y)
            evidence[i] = max(evidence[i], evidence_near(rows, near, factors) + weight[i])
    best, groups = grouped(stack, evidence)
    likely = {g: _possible(stack, best[g], whitener, y) for g in groups}
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
    return out
