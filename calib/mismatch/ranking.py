"""Every candidate scored under the noise that it implies.

Noise is estimated under each hypothesis that matters, so that drift competes with effects on equal
terms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from calib.effects import get_effect
from calib.mismatch.families import add_catalogue, candidate_columns, neighbours
from calib.mismatch.noise import (
    Whitener,
    contrast_likelihood,
    contrast_variance,
    estimate_levels,
    find_levels,
    level_likelihood,
    make_whitener,
    range_basis,
)
from calib.mismatch.rivals import WINDOWED, add_rivals, moved_window, nearby_windows, window_columns
from calib.mismatch.rows import Rows
from calib.mismatch.score import Candidate, Stack, log_bayes_factor
from calib.recording import CHANNELS
from calib.types import FloatArray

CLAIM = 5.0
"""E-value at which something is claimed to be left. Markov's inequality bounds the share of clean
recordings that reach it by 20 %, but only evidence that is all or nothing attains that: of normal
errors under as many looks as here, ``benchmarks/evidence.py`` counts less than 1 in 500."""

DRIFTING = 0.1
"""What evidence counts where a drift can mimic it: it stands or falls with the slow end of the
noise, of which a recording shows a few modes only."""

SLOW_MODES = 8
"""Half waves over the recording in the fastest drift that is meant by that."""

PAIRS = 3
"""How many effects of one channel are tried as the first of a pair."""

LEADERS = (4, 3)
"""How many of the best, of physics and of rivals, are scored at places nearer to their own, with
noise levels of their own."""

PLAIN, AHEAD = 50.0, 20.0
"""Log evidence from which, and by how much more than any other, the best is plain. Levels that are
not raised by what was left out would put it further ahead, and are found for it alone."""


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
    drifting: frozenset[str] = frozenset()
    pair: tuple[float, Candidate] | None = None

    @property
    def total(self) -> float:
        """Log e-value that anything is left."""
        return float(logsumexp(list(self.groups.values()))) if self.groups else -np.inf

    @property
    def discounted(self) -> dict[str, float]:
        """Log evidence of each group, where what a drift can mimic counts for less."""
        return {g: v + np.log(DRIFTING) * (g in self.drifting) for g, v in self.groups.items()}

    @property
    def claims(self) -> bool:
        """Whether that is enough to say that anything is left."""
        less = list(self.discounted.values())
        return bool(less) and float(logsumexp(less)) >= np.log(CLAIM)


def make_stack(rows: Rows, *, skip: tuple[str, ...], reference: bool) -> Stack:
    """Return every candidate: the catalogue and its rivals."""
    stack = Stack(len(rows.residual))
    add_catalogue(stack, rows, skip=skip, reference=reference)
    add_rivals(stack, rows, skip=skip)
    return stack


def fitted(rows: Rows, accepted: list[Accepted] | tuple[Accepted, ...]) -> FloatArray:
    """Return all columns that are always fitted: baseline, nuisances, and what was accepted."""
    return np.hstack((rows.baseline, rows.nuisance, *(a.columns for a in accepted)))


def contrast_noise(rows: Rows, accepted: Sequence[Accepted], *also: Candidate) -> FloatArray:
    """Return the variance of the contrast rows, as it is outside of what is found in windows."""
    apart = np.zeros(len(rows.residual) - rows.n_dense, bool)
    for item in (*(a.candidate for a in accepted), *also):
        if item.physical or item.interval is None:
            continue
        start, stop = item.interval
        inside = (rows.interval[:, 0] < stop) & (rows.interval[:, 1] > start)
        own = np.isin(rows.channel, [CHANNELS.index(c) for c in item.channels])
        apart |= (inside[rows.segment] & own)[rows.n_dense :]
    return contrast_variance(rows, apart=apart)


def rank(rows: Rows, stack: Stack, accepted: list[Accepted], start: FloatArray) -> Ranking:
    """Score every candidate under the noise that it implies.

    What was left out raises the drift of its channels. So each candidate is also scored with the
    drift of its own channels as it is with all physics in the mean (a rival: with the strongest
    rivals), and the leaders with drift estimated anew for each of them. Lower drift costs the
    likelihood of the null, and that cost is in the evidence: drift and effect compete on equal
    terms. So does what the null needs to take an effect for noise: levels that are just so.
    """
    mean = fitted(rows, accepted)
    dense = mean[: rows.n_dense]
    basis = range_basis(dense)
    contrast = contrast_noise(rows, accepted)
    base = find_levels(rows, dense, start)
    weight = np.log(np.array([c.weight for c in stack.candidates]))

    def score(
        levels: FloatArray, contrast: FloatArray, null: float, which: list[int] | None
    ) -> FloatArray:
        whitener = make_whitener(rows, levels, contrast, mean)
        y = whitener.project(rows.residual)
        return stack.log_bayes_factors(whitener, y, which=which) + (null - base.log_likelihood)

    def suited(levels: FloatArray, rival: Candidate, own: FloatArray) -> tuple[FloatArray, float]:
        """Return the variance of contrasts that suits a rival better, and what it costs the null.

        It is that outside of the rival's window, or that of all.
        """
        if rival.physical or rival.interval is None:
            return contrast, 0.0
        outside = contrast_noise(rows, accepted, rival)
        # Where the null prefers it as well, that is no merit of the rival.
        cost = contrast_likelihood(rows, outside) - contrast_likelihood(rows, contrast)
        cost = min(cost, 0.0)
        value = []
        for variance in (contrast, outside):
            whitener = make_whitener(rows, levels, variance, mean)
            value.append(log_bayes_factor(whitener.project(own), whitener.project(rows.residual)))
        return (outside, cost) if value[1] + cost > value[0] else (contrast, 0.0)

    def sharing(channels: tuple[str, ...], *, physical: bool) -> list[int]:
        return [
            i
            for i, c in enumerate(stack.candidates)
            if c.channels == channels and c.physical == physical
        ]

    evidence = score(base.values, contrast, base.log_likelihood, None)
    best, groups = grouped(stack, evidence + weight)
    first, second = sorted([*groups.values(), 0.0, 0.0], reverse=True)[:2]
    plain = first > PLAIN and first - second > AHEAD
    every = base
    hidden: list[tuple[FloatArray, float, list[int], FloatArray]] = []
    if not plain:
        wide = np.hstack((dense, _physics(stack)[: rows.n_dense]))
        every = find_levels(rows, wide, base.values)
        rivals = _strongest(stack, evidence)
        alone = [stack.of(c) for c in rivals.values() if len(c.channels) == 1]
        strongest = np.hstack(alone)[: rows.n_dense]
        free = estimate_levels(rows, np.hstack((dense, strongest)), every.values)
        for channels in (*((c,) for c in CHANNELS), CHANNELS[:3], CHANNELS[3:]):
            for physical, other in ((True, every), (False, free)):
                which = sharing(channels, physical=physical)
                if not which:
                    continue
                levels = _swap(rows, base.values, other.values, channels)
                null = level_likelihood(rows, basis, levels)
                if physical:
                    scored = score(levels, contrast, null, which)
                    hidden.append((scored + weight, null - base.log_likelihood, which, levels))
                else:
                    strong = rivals[channels]
                    outside, cost = suited(levels, strong, stack.of(strong))
                    scored = score(levels, outside, null + cost, which)
                evidence = np.maximum(evidence, scored)
    evidence += weight
    best, groups = grouped(stack, evidence)
    for name in [max(groups, key=lambda g: groups[g])] if plain else leading(best, groups):
        if groups[name] < np.log(CLAIM) - 7:
            continue
        leader = best[name]
        here, moved = leader, nearby(rows, leader)
        own = stack.of(leader)
        if moved.candidates:
            whitener = make_whitener(rows, base.values, contrast, mean)
            factors = moved.log_bayes_factors(whitener, whitener.project(rows.residual))
            here = moved.candidates[int(np.argmax(factors))]
            own = moved.of(here)
        dense_own = np.hstack((dense, own[: rows.n_dense]))
        with_own = estimate_levels(rows, dense_own, every.values)
        levels = with_own.values
        outside, cost = suited(levels, here, own)
        null = level_likelihood(rows, basis, levels) + cost + with_own.log_share - base.log_share
        names, code = stack.groups()
        which = np.flatnonzero(code == names.index(name)).tolist()
        again = score(levels, outside, null, which) + weight
        if moved.candidates:
            whitener = make_whitener(rows, levels, outside, mean)
            average = moved.average(whitener, whitener.project(rows.residual))
            i = stack.candidates.index(leader)
            again[i] = max(again[i], average + null - base.log_likelihood + weight[i])
        evidence = np.maximum(evidence, again)
    best, groups = grouped(stack, evidence)
    whitener = make_whitener(rows, base.values, contrast, mean)
    drifting = _drifting(rows, stack, whitener, [best[g] for g, v in groups.items() if v > 0])
    ranking = Ranking(stack, evidence, best, groups, base.values, drifting)
    if accepted or ranking.claims:
        return ranking
    return replace(ranking, pair=_pair(rows, stack, hidden, contrast, mean, weight))


def _drifting(
    rows: Rows, stack: Stack, whitener: Whitener, candidates: list[Candidate]
) -> frozenset[str]:
    """Return the groups of those candidates of which a drift can mimic more than half."""
    if not candidates:
        return frozenset()
    time = rows.state.time - rows.state.time[0]
    phase = np.pi * time[:, None] / max(float(time[-1]), 1e-9) * np.arange(1, SLOW_MODES + 1)
    slow = np.hstack([rows.columns(c, np.cos(phase)) for c in range(len(CHANNELS))])
    basis = range_basis(whitener.project(slow))
    out = []
    for c in candidates:
        columns = whitener.project(stack.of(c))
        if np.square(basis.T @ columns).sum() > 0.5 * np.square(columns).sum():
            out.append(c.group)
    return frozenset(out)


def nearby(rows: Rows, leader: Candidate) -> Stack:
    """Return a candidate at the shapes and places nearest to its own; nothing for what has none.

    An event is moved within its rest or turn, a time constant between its neighbours on the grid,
    a window at both of its ends.
    """
    stack = Stack(len(rows.residual))
    if leader.physical and not leader.present:
        for shape in neighbours(get_effect(leader.name), rows, leader.shape):
            columns = candidate_columns(rows, leader, shape, reference=True)
            if columns is not None:
                stack.candidates.append(replace(leader, index=stack.add(columns), shape=shape))
    if leader.name in WINDOWED:
        for window in nearby_windows(rows, leader):
            there = moved_window(leader, *window)
            index = stack.add(window_columns(rows, there))
            stack.candidates.append(replace(there, index=index, mixing=None, summed=False))
    return stack


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
    best: tuple[float, Candidate | None] = (float(np.log(CLAIM / DRIFTING)), None)
    for evidence, null, which, levels in hidden:
        order = sorted(which, key=lambda i: -evidence[i])
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
            rest = [k for k in which if stack.candidates[k].name != first.name]
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


def grouped(stack: Stack, evidence: FloatArray) -> tuple[dict[str, Candidate], dict[str, float]]:
    """Return the best candidate of each group, and the group's evidence."""
    names, code = stack.groups()
    order = np.lexsort((-np.arange(len(code)), evidence, code))
    best = order[np.append(np.diff(code[order]) > 0, True)]
    top = evidence[best]
    total = top + np.log(np.bincount(code, np.exp(evidence - top[code])))
    return (
        {g: stack.candidates[i] for g, i in zip(names, best, strict=True)},
        {g: float(v) for g, v in zip(names, total, strict=True)},
    )


def leading(best: Mapping[str, Candidate], groups: Mapping[str, float]) -> list[str]:
    """Return the groups with the most evidence."""
    order = sorted(groups, key=lambda g: -groups[g])
    physics, rivals = ([g for g in order if best[g].physical is kind] for kind in (True, False))
    return physics[: LEADERS[0]] + rivals[: LEADERS[1]]


def _strongest(stack: Stack, evidence: FloatArray) -> dict[tuple[str, ...], Candidate]:
    """Return the rival with the largest Bayes factor of each channel, and of each triad."""
    best: dict[tuple[str, ...], int] = {}
    for i, c in enumerate(stack.candidates):
        if not c.physical and evidence[i] > evidence[best.setdefault(c.channels, i)]:
            best[c.channels] = i
    return {channels: stack.candidates[i] for channels, i in best.items()}


def _physics(stack: Stack) -> FloatArray:
    """Return the physical columns, thinned where an effect has many shapes."""
    index: list[int] = []
    shapes: dict[str, list[Candidate]] = {}
    for c in stack.candidates:
        # Every parameter is tried alone, but for refinements of others.
        if c.physical and c.is_single:
            shapes.setdefault(c.name, []).append(c)
    for items in shapes.values():
        each = list(dict.fromkeys(int(k) for c in items for k in c.index))
        limit = 6
        index += each if len(each) <= limit else each[:: -(-len(each) // limit)]
    return stack.columns[:, index]
