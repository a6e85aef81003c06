"""The search: the best explanation, refitted with all that was found, until nothing is left.

Each round asks whether anything is left (the average of all Bayes factors, an e-value), and what:
the physics of the catalogue against each other and against honest rivals. Noise is estimated under
each hypothesis that matters, so that drift competes with effects on equal terms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.special import logsumexp

from calib.effects import get_effect
from calib.effects.base import PRESENCE, Term, TransformEffect
from calib.mismatch.families import add_catalogue, effect_columns, neighbours
from calib.mismatch.noise import (
    Whitener,
    contrast_variance,
    estimate_levels,
    expected_levels,
    level_likelihood,
    make_whitener,
    range_basis,
)
from calib.mismatch.rivals import WINDOWED, add_rivals, window_columns
from calib.mismatch.rows import Rows
from calib.mismatch.score import SCALES, Candidate, Stack
from calib.recording import CHANNELS
from calib.types import FloatArray

CLAIM = 100.0
"""E-value at which something is claimed to be left. Markov's inequality bounds the share of clean
recordings that reach it by 1 % where the noise levels are known. Here they are estimated, so the
bound is a guide only: the share is measured by ``benchmarks/concealed.py``."""

TIE = 0.05
"""Posterior probability above which another name is reported as a rival."""

PAIRS = 3
"""How many effects of one channel are tried as the first of a pair."""

LEADERS = 5
"""How many of the best are scored with noise levels of their own."""

KEEP = 0.0
"""Log evidence below which an earlier finding is dropped, given the later ones."""

TWIN = 0.01
"""The same for another effect of the catalogue: what sizes are typical is a weak argument between
two that a recording cannot tell apart."""

ROUNDS = 8
"""At most so many findings are tried."""


class Problem(Protocol):
    """Where rows come from: a recording and its twin, a simulation, or a reference."""

    reference: bool
    moves_signals: bool

    def rows(self) -> Rows:
        """Return recording minus model, linearised where the model stands."""
        ...

    def move(
        self, baseline: Mapping[str, float], nuisance: FloatArray, terms: tuple[Term, ...]
    ) -> None:
        """Move the model: baseline and nuisances by steps, further terms to these."""
        ...


@dataclass(frozen=True, eq=False)
class Accepted:
    """A hypothesis that was accepted.

    ``values`` are its coefficients in the units of the effect's parameters, ``in_model`` whether
    the rows' residual already has them taken out.
    """

    candidate: Candidate
    columns: FloatArray
    typical: FloatArray
    values: FloatArray
    in_model: bool
    e_value: float
    posterior: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Ranking:
    """Log evidence (prior weight times Bayes factor) of every candidate, and of each group."""

    stack: Stack
    evidence: FloatArray
    best: dict[str, Candidate]
    groups: dict[str, float]
    levels: FloatArray
    pair: tuple[float, Candidate] | None = None

    @property
    def total(self) -> float:
        """Log e-value that anything is left."""
        return float(logsumexp(list(self.groups.values()))) if self.groups else -np.inf


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the search ends with: rows, what was accepted, and the noise under all of it."""

    rows: Rows
    accepted: tuple[Accepted, ...]
    levels: FloatArray
    contrast: FloatArray
    total: float
    candidates: tuple[Candidate, ...]


def search(problem: Problem, *, skip: tuple[str, ...] = ()) -> Outcome:
    """Find what was left out, one hypothesis after another."""
    accepted: list[Accepted] = []
    rows = problem.rows()
    stack = make_stack(rows, skip=skip, reference=problem.reference)
    start = expected_levels(rows)
    ranking = rank(rows, stack, accepted, start)
    if ranking.total < np.log(CLAIM) and ranking.pair is not None:
        accepted.append(_accept(rows, stack, ranking.pair[1], float(np.exp(ranking.pair[0]))))
        rows, stack, accepted = _refit(problem, rows, accepted, ranking.levels, skip)
        ranking = rank(rows, stack, accepted, ranking.levels)
    for _ in range(ROUNDS):
        if ranking.total < np.log(CLAIM):
            break
        chosen = choose(rows, ranking, accepted)
        if chosen is None:
            break
        accepted.append(_accept(rows, stack, chosen, float(np.exp(min(ranking.total, 700)))))
        rows, stack, accepted = _refit(problem, rows, accepted, ranking.levels, skip)
        extra = _superfluous(rows, accepted, ranking.levels)
        if extra is not None:
            accepted = [a for a in accepted if a is not extra]
            rows, stack, accepted = _refit(problem, rows, accepted, ranking.levels, skip)
        ranking = rank(rows, stack, accepted, ranking.levels)
    contrast = contrast_variance(rows)
    levels = estimate_levels(rows, fitted(rows, accepted)[: rows.n_dense], ranking.levels).values
    accepted = [
        replace(a, posterior=_posterior(rows, stack, accepted, i, levels))
        for i, a in enumerate(accepted)
    ]
    return Outcome(rows, tuple(accepted), levels, contrast, ranking.total, tuple(stack.candidates))


def make_stack(rows: Rows, *, skip: tuple[str, ...], reference: bool) -> Stack:
    """Return every candidate: the catalogue and its rivals."""
    stack = Stack(len(rows.residual))
    add_catalogue(stack, rows, skip=skip, reference=reference)
    add_rivals(stack, rows, skip=skip)
    return stack


def fitted(rows: Rows, accepted: list[Accepted] | tuple[Accepted, ...]) -> FloatArray:
    """Return all columns that are always fitted: baseline, nuisances, and what was accepted."""
    return np.hstack((rows.baseline, rows.nuisance, *(a.columns for a in accepted)))


def rank(rows: Rows, stack: Stack, accepted: list[Accepted], start: FloatArray) -> Ranking:
    """Score every candidate under the noise that it implies.

    An effect that was left out raises the drift of its channels. So each candidate is also scored
    with the drift of its own channels as it is with all physics in the mean, and the leaders with
    drift estimated anew for each of them. Lower drift costs the likelihood of the null, and that
    cost is in the evidence: drift and effect compete on equal terms.
    """
    mean = fitted(rows, accepted)
    dense = mean[: rows.n_dense]
    basis = range_basis(dense)
    contrast = contrast_variance(rows)
    base = estimate_levels(rows, dense, start)
    wide = np.hstack((dense, _physics(stack)[: rows.n_dense]))
    every = estimate_levels(rows, wide, base.values)
    weight = np.log(np.array([c.weight for c in stack.candidates]))

    def score(levels: FloatArray, null: float, which: list[int] | None) -> FloatArray:
        whitener = make_whitener(rows, levels, contrast, mean)
        y = whitener.project(rows.residual)
        return stack.log_bayes_factors(whitener, y, which=which) + (null - base.log_likelihood)

    evidence = score(base.values, base.log_likelihood, None)
    hidden: list[tuple[FloatArray, float, list[int], FloatArray]] = []
    for channels in (*((c,) for c in CHANNELS), CHANNELS[:3], CHANNELS[3:]):
        which = [i for i, c in enumerate(stack.candidates) if c.channels == channels]
        if which:
            levels = _swap(rows, base.values, every.values, channels)
            null = level_likelihood(rows, basis, levels)
            scored = score(levels, null, which)
            evidence = np.maximum(evidence, scored)
            hidden.append((scored + weight, null - base.log_likelihood, which, levels))
    evidence += weight
    best, groups = _grouped(stack, evidence)
    for name in sorted(groups, key=lambda g: -groups[g])[:LEADERS]:
        if groups[name] < np.log(CLAIM) - 7:
            break
        own = stack.of(best[name])[: rows.n_dense]
        levels = estimate_levels(rows, np.hstack((dense, own)), every.values).values
        which = [i for i, c in enumerate(stack.candidates) if c.group == name]
        again = score(levels, level_likelihood(rows, basis, levels), which) + weight
        if name.endswith("_bias_step"):
            i = stack.candidates.index(best[name])
            null = level_likelihood(rows, basis, levels) - base.log_likelihood
            whitener = make_whitener(rows, levels, contrast, mean)
            again[i] = max(again[i], _moved(rows, best[name], whitener) + null + weight[i])
        evidence = np.maximum(evidence, again)
    best, groups = _grouped(stack, evidence)
    ranking = Ranking(stack, evidence, best, groups, base.values)
    if accepted or ranking.total >= np.log(CLAIM):
        return ranking
    return replace(ranking, pair=_pair(rows, stack, hidden, contrast, mean, weight))


def _moved(rows: Rows, event: Candidate, whitener: Whitener) -> float:
    """Return the log Bayes factor of an event, averaged over moments within its rest or turn."""
    effect, stack = get_effect(event.name), Stack(len(rows.residual))
    for shape in neighbours(effect, rows, event.shape):
        found = effect_columns(effect, rows, shape, reference=True)
        if all(n in found for n in event.parameters):
            index = stack.add(np.stack([found[n] for n in event.parameters], axis=1))
            stack.candidates.append(replace(event, index=index, shape=shape))
    if not stack.candidates:
        return -np.inf
    factors = stack.log_bayes_factors(whitener, whitener.project(rows.residual))
    return float(logsumexp(factors) - np.log(len(factors)))


def _pair(
    rows: Rows,
    stack: Stack,
    hidden: list[tuple[FloatArray, float, list[int], FloatArray]],
    contrast: FloatArray,
    mean: FloatArray,
    weight: FloatArray,
) -> tuple[float, Candidate] | None:
    """Return two effects on the same channels that hide each other: evidence, and the first.

    Either alone leaves the other, which then counts as drift, and neither reaches the claim.
    """
    best: tuple[float, Candidate | None] = (float(np.log(CLAIM)), None)
    for evidence, null, which, levels in hidden:
        order = [
            i for i in sorted(which, key=lambda i: -evidence[i]) if stack.candidates[i].physical
        ]
        tried: list[str] = []
        for i in order:
            first = stack.candidates[i]
            if first.name in tried:
                continue
            tried.append(first.name)
            # Only where the first gains something by itself is there a pair to find.
            if len(tried) > PAIRS or evidence[i] - null + weight[i] < 0:
                break
            whitener = make_whitener(rows, levels, contrast, np.hstack((mean, stack.of(first))))
            y = whitener.project(rows.residual)
            rest = [
                k
                for k in which
                if stack.candidates[k].physical and stack.candidates[k].name != first.name
            ]
            if not rest:
                continue
            second = stack.log_bayes_factors(whitener, y, which=rest) + weight
            value = float(evidence[i] + second[rest].max())
            if value > best[0]:
                best = (value, first)
    return None if best[1] is None else (best[0], best[1])


def _swap(rows: Rows, base: FloatArray, every: FloatArray, channels: tuple[str, ...]) -> FloatArray:
    """Return the levels of `every` for the drift of some channels, and of `base` for the rest."""
    own = np.array([c.name.split(" ")[0] in channels for c in rows.components])
    return np.where(own, np.minimum(base, every), base)


def _grouped(stack: Stack, evidence: FloatArray) -> tuple[dict[str, Candidate], dict[str, float]]:
    index: dict[str, list[int]] = {}
    for i, c in enumerate(stack.candidates):
        index.setdefault(c.group, []).append(i)
    best = {g: stack.candidates[k[int(np.argmax(evidence[k]))]] for g, k in index.items()}
    return best, {g: float(logsumexp(evidence[k])) for g, k in index.items()}


def _physics(stack: Stack) -> FloatArray:
    """Return the physical columns, thinned where an effect has many shapes."""
    index: list[int] = []
    shapes: dict[str, list[Candidate]] = {}
    for c in stack.candidates:
        if c.physical:
            shapes.setdefault(c.name, []).append(c)
    for items in shapes.values():
        each = list(dict.fromkeys(int(k) for c in items for k in c.index))
        limit = 6
        index += each if len(each) <= limit else each[:: -(-len(each) // limit)]
    return stack.columns[:, index]


def choose(rows: Rows, ranking: Ranking, accepted: list[Accepted]) -> Candidate | None:
    """Return what explains most: physics, unless the rivals together are more probable.

    An event where something is unexplained already is part of that, and gets no name of its own.
    """
    best = ranking.best
    groups = {g: v for g, v in ranking.groups.items() if not _within(best[g], accepted)}
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
    if for_physics >= for_rivals:
        return best[top]
    # Two causes at once can look like one smooth rival: let physics try twice.
    if groups[top] > np.log(CLAIM):
        stack = ranking.stack
        pair = _accept(rows, stack, best[top], 1.0)
        second = rank(rows, stack, [*accepted, pair], ranking.levels)
        left = [v for g, v in second.groups.items() if second.best[g].physical]
        if left and groups[top] + max(left) > for_rivals and max(left) > np.log(CLAIM):
            return best[top]
    return best[other]


def _within(candidate: Candidate, accepted: list[Accepted]) -> bool:
    """Whether an event lies in, or at the edge of, what is unexplained in one of its channels."""
    if not candidate.physical or get_effect(candidate.name).kind != "event":
        return False
    moment = candidate.shape.get("moment")
    for a in accepted:
        if a.candidate.physical or not set(a.candidate.channels) & set(candidate.channels):
            continue
        if a.candidate.interval is None or moment is None:
            return True
        start, stop = a.candidate.interval
        edge = 0.5 * (stop - start)
        if start - edge <= moment <= stop + edge:
            return True
    return False


def _accept(rows: Rows, stack: Stack, chosen: Candidate, e_value: float) -> Accepted:
    columns = stack.of(chosen)
    typical = np.ones(columns.shape[1])
    if chosen.physical:
        sizes = {p.name: p.typical for p in get_effect(chosen.name).parameters}
        typical = np.array([sizes[n] for n in chosen.parameters])
    return Accepted(chosen, columns, typical, np.zeros(columns.shape[1]), False, e_value)


def _refit(
    problem: Problem,
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    skip: tuple[str, ...],
) -> tuple[Rows, Stack, list[Accepted]]:
    """Fit everything jointly, move the model there, and linearise anew."""
    contrast = contrast_variance(rows)
    levels = estimate_levels(rows, fitted(rows, accepted)[: rows.n_dense], levels).values
    if accepted and not accepted[-1].in_model:
        accepted[-1] = _refine(problem, rows, accepted, levels, contrast)
    step = solve(rows, accepted, levels, contrast)
    p, q = rows.baseline.shape[1], rows.nuisance.shape[1]
    terms, at = [], p + q
    moved = []
    for a in accepted:
        k = a.columns.shape[1]
        change = step[at : at + k] * a.typical
        at += k
        if _movable(a.candidate, signals=problem.moves_signals):
            a = replace(a, values=a.values + change, in_model=True)
            values = dict(zip(a.candidate.parameters, a.values, strict=True))
            terms.append(Term(a.candidate.name, {**values, **a.candidate.shape}))
        moved.append(a)
    baseline = dict(zip(rows.names, step[:p], strict=True))
    problem.move(baseline, step[p : p + q], tuple(terms))
    rows = problem.rows()
    stack = make_stack(rows, skip=skip, reference=problem.reference)
    return rows, stack, [_renew(a, rows, reference=problem.reference) for a in moved]


def _movable(candidate: Candidate, *, signals: bool) -> bool:
    """Return whether a model can take up a finding.

    What is added always; what acts on the signals where the model predicts them, in proportion.
    """
    if not candidate.physical:
        return False
    effect = get_effect(candidate.name)
    if not isinstance(effect, TransformEffect):
        return True
    return signals and all(p.unit != PRESENCE for p in effect.parameters)


def _renew(a: Accepted, rows: Rows, *, reference: bool) -> Accepted:
    if not a.candidate.physical:
        return a
    found = effect_columns(
        get_effect(a.candidate.name), rows, a.candidate.shape, reference=reference
    )
    columns = [found[n] for n in a.candidate.parameters]
    return replace(a, columns=np.stack(columns, axis=1))


def prior_rows(rows: Rows, accepted: list[Accepted] | tuple[Accepted, ...]) -> FloatArray:
    """Return rows (k, p) of the prior on the coefficients of rivals, beside a reference.

    A smooth function can take the place of the baseline. Against a twin the two are exactly alike,
    and the smallest step is taken; against a truth with noise they are only nearly so, and what
    keeps them apart is the size that the evidence gave the rival, at most the largest of `SCALES`.
    """
    start = rows.baseline.shape[1] + rows.nuisance.shape[1]
    width = start + sum(a.columns.shape[1] for a in accepted)
    at = start
    index: list[int] = []
    for a in accepted:
        if not a.candidate.physical:
            index += range(at, at + a.columns.shape[1])
        at += a.columns.shape[1]
    if not rows.aligned:
        index = []
    out: FloatArray = np.eye(width)[np.array(index, np.int64)] / SCALES[-1]
    return out


def solve(
    rows: Rows,
    accepted: list[Accepted] | tuple[Accepted, ...],
    levels: FloatArray,
    contrast: FloatArray,
) -> FloatArray:
    """Return the generalised least-squares step of all that is fitted."""
    mean = fitted(rows, accepted)
    whitener = make_whitener(rows, levels, contrast, mean[:, :0])
    scale = np.maximum(np.linalg.norm(mean, axis=0), 1e-300)
    prior = prior_rows(rows, accepted) / scale
    step = np.linalg.lstsq(
        np.vstack((whitener.whiten(mean / scale), prior)),
        np.append(whitener.whiten(rows.residual), np.zeros(len(prior))),
        rcond=1e-9,
    )[0]
    return np.asarray(step / scale)


def _refine(
    problem: Problem, rows: Rows, accepted: list[Accepted], levels: FloatArray, contrast: FloatArray
) -> Accepted:
    """Refine the shape parameters of the last accepted between the grid's values."""
    last = accepted[-1]
    if last.candidate.name in WINDOWED:
        whitener = make_whitener(rows, levels, contrast, fitted(rows, accepted[:-1]))
        return _refine_window(rows, last, whitener, whitener.project(rows.residual))
    if not last.candidate.physical or not last.candidate.shape:
        return last
    whitener = make_whitener(rows, levels, contrast, fitted(rows, accepted[:-1]))
    y = whitener.project(rows.residual)
    effect = get_effect(last.candidate.name)
    best = last

    def gain(a: Accepted) -> float:
        return _gain(whitener.project(a.columns), y)

    value = gain(best)
    for shape in neighbours(effect, rows, last.candidate.shape):
        found = effect_columns(effect, rows, shape, reference=problem.reference)
        if not all(n in found for n in last.candidate.parameters):
            continue
        tried = replace(
            last,
            candidate=replace(last.candidate, shape=shape),
            columns=np.stack([found[n] for n in last.candidate.parameters], axis=1),
        )
        new = gain(tried)
        if new > value:
            best, value = tried, new
    return best


def _refine_window(rows: Rows, last: Accepted, whitener: Whitener, y: FloatArray) -> Accepted:
    """Move the ends of a window to where it explains most, within half its length of the grid's."""
    assert last.candidate.interval is not None
    start, stop = last.candidate.interval
    reach = 0.5 * (stop - start)
    edges = np.unique(np.concatenate((rows.interval.ravel(), rows.interval.mean(axis=1))))
    column, ends = last.columns, [start, stop]
    white = whitener.project(column)
    value = float((white.T @ y)[0] ** 2 / max(float(np.square(white).sum()), 1e-300))
    for which in (0, 1, 0, 1):
        tried = edges[np.abs(edges - (start, stop)[which]) <= reach]
        other = ends[1 - which]
        tried = tried[tried < other] if which == 0 else tried[tried > other]
        if not len(tried):
            continue
        found = window_columns(
            rows, last.candidate, [(t, other) if which == 0 else (other, t) for t in tried]
        )
        white = whitener.project(found)
        gain = np.square(y @ white) / np.maximum(np.square(white).sum(axis=0), 1e-300)
        # Where a window gains nothing (a gain at rest), it need not reach.
        good = np.flatnonzero(gain >= gain.max() - 0.5)
        k = int(good[np.argmin(np.abs(tried[good] - other))])
        if gain[k] > value - 0.5:
            value, column, ends[which] = float(gain[k]), found[:, [k]], float(tried[k])
    return replace(
        last, candidate=replace(last.candidate, interval=(ends[0], ends[1])), columns=column
    )


def _superfluous(rows: Rows, accepted: list[Accepted], levels: FloatArray) -> Accepted | None:
    """Return the rival or transform that later findings have made worthless, if there is one."""
    contrast = contrast_variance(rows)
    # With all findings in the mean: drift must not take up again what they explained.
    levels = estimate_levels(rows, fitted(rows, accepted)[: rows.n_dense], levels).values
    worst: tuple[float, Accepted | None] = (KEEP, None)
    for a in accepted[:-1]:
        if a.in_model:
            continue
        others = [b for b in accepted if b is not a]
        whitener = make_whitener(rows, levels, contrast, fitted(rows, others))
        own = Stack(len(rows.residual))
        index = own.add(a.columns)
        own.candidates.append(replace(a.candidate, index=index, summed=False))
        value = own.log_bayes_factors(whitener, whitener.project(rows.residual))[0]
        value += np.log(a.candidate.weight)
        if value < worst[0]:
            worst = (float(value), a)
    return worst[1]


def _posterior(
    rows: Rows, stack: Stack, accepted: list[Accepted], which: int, levels: FloatArray
) -> dict[str, float]:
    """Return the posterior of every group in the place of one finding, the others kept."""
    others = [b for i, b in enumerate(accepted) if i != which]
    own = accepted[which]
    mean = fitted(rows, others)
    whitener = make_whitener(rows, levels, contrast_variance(rows), mean)
    residual = rows.residual
    if own.in_model:
        residual = residual + own.columns @ (own.values / own.typical)
    scores = stack.log_bayes_factors(whitener, whitener.project(residual))
    evidence = scores + np.log(np.array([c.weight for c in stack.candidates]))
    best, groups = _grouped(stack, evidence)
    total = logsumexp(list(groups.values()))
    out = {g: float(np.exp(v - total)) for g, v in groups.items() if v - total > np.log(1e-3)}
    if own.candidate.physical:
        y = whitener.project(residual)
        reached = _gain(whitener.project(own.columns), y)
        for g, candidate in best.items():
            # A twin fits as well with no more parameters, whatever size it then has.
            few = len(candidate.index) <= own.columns.shape[1]
            small = candidate.physical and few and out.get(g, 0.0) < 2 * TWIN
            if small and _gain(whitener.project(stack.of(candidate)), y) > reached - 2.0:
                out[g] = 2 * TWIN
    return out


def _gain(columns: FloatArray, y: FloatArray) -> float:
    """Return the log-likelihood that whitened columns gain at their best fit."""
    fit = columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    return 0.5 * float(fit @ fit)
