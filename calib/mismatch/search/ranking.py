"""Every candidate scored under the noise that it implies.

Noise is estimated under each hypothesis that matters, so that drift competes with effects on equal
terms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from calib.mismatch.hypotheses.answers import (
    evidence_near,
    grouped,
    leading,
    nearby,
    physics,
    strongest_rivals,
)
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import add_catalogue
from calib.mismatch.hypotheses.rivals import add_rivals
from calib.mismatch.hypotheses.score import Stack, log_bayes_factor
from calib.mismatch.noise.contrast import contrast_likelihood, contrast_variance
from calib.mismatch.noise.noise import (
    Levels,
    Whitener,
    estimate_levels,
    find_levels,
    level_likelihood,
    make_whitener,
    range_basis,
)
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray

CLAIM = 2.5
"""E-value at which something is claimed to be left. Markov's inequality bounds the share of clean
recordings that reach it by 40 %, but only evidence that is all or nothing attains that: of normal
errors under as many looks as here, ``benchmarks/evidence.py`` counts 1 in 280."""

DRIFTING = 0.125
"""What evidence counts where a drift can mimic it and rests alone show that: it stands or falls
with the slow end of the noise, of which a recording's rests show a few modes only. So it has to
reach twenty times what is as likely as not. Beside a truth every moment shows it."""

COUNTS = 0.05
"""E-value from which a group counts in what is left altogether."""

SLOW_MODES = 8
"""Half waves over the recording in the fastest drift that is meant by that."""

RARE = 0.02
"""Share of recordings of nothing but noise that reach an e-value of e, times e: at most, where
``benchmarks/evidence.py`` counts them (Markov's inequality has 1 for any noise at all)."""

PAIRS = 3
"""How many effects of one channel are tried as the first of a pair."""

PLAIN, AHEAD = 20.0, 20.0
"""Log evidence from which something is plainly left, and how far behind the best an answer then is
out of the running. Levels that are not raised by what was left out would put the best further
ahead, and are found for those in the running alone."""


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
    beside: Mapping[str, FloatArray] = field(default_factory=dict)
    """Levels with the best of a group in the mean, of those groups for which they were found."""

    def levels_with(self, candidate: Candidate) -> FloatArray:
        """Return levels to start from where a candidate is fitted too."""
        return self.beside.get(candidate.group, self.levels)

    @property
    def total(self) -> float:
        """Log e-value that anything is left."""
        return float(logsumexp(list(self.groups.values()))) if self.groups else -np.inf

    @property
    def discounted(self) -> dict[str, float]:
        """Log evidence of each group, where what a drift can mimic counts for less."""
        return {g: v + np.log(DRIFTING) * (g in self.drifting) for g, v in self.groups.items()}

    @property
    def worth(self) -> float:
        """Log e-value that anything is left, where what a drift can mimic counts for less."""
        less = list(self.discounted.values())
        return float(logsumexp(less)) if less else -np.inf

    @property
    def claims(self) -> bool:
        """Whether that is enough to say that anything is left."""
        return bool(self.worth >= np.log(CLAIM))


def chance(e_value: float) -> float:
    """Return the p-value of evidence, all looks counted: how rarely noise alone reaches it."""
    return min(1.0, RARE / e_value)


def make_stack(rows: Rows, *, skip: tuple[str, ...], reference: bool) -> Stack:
    """Return every candidate: the catalogue and its rivals."""
    stack = Stack(len(rows.residual))
    add_rivals(stack, rows, skip=skip)
    add_catalogue(stack, rows, skip=skip, reference=reference)
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
    scores = _Scores.of(rows, stack, accepted, start)
    base = scores.base
    evidence = scores.at(base.values, scores.contrast, base.log_likelihood)
    best, groups = grouped(stack, evidence)
    running = _running(groups)
    every = base
    hidden: list[_Hidden] = []
    if len(running) > 1:
        names, code = stack.groups()
        which = np.array([g in running for g in names])[code]
        evidence, every, hidden = scores.with_drift_of_all(evidence, which)
        best, groups = grouped(stack, evidence)
    beside = {}
    for name in leading(best, {g: groups[g] for g in running}):
        if groups[name] <= np.log(CLAIM) - 7:
            continue
        most = -np.inf
        for leader in _with_fullest(stack, evidence, best[name]):
            scored, levels = scores.with_own_drift(leader, every)
            evidence = np.maximum(evidence, scored)
            if scored.max() > most:
                most, beside[name] = float(scored.max()), levels
    best, groups = grouped(stack, evidence)
    whitener = scores.whitener(base.values, scores.contrast)
    counted = [best[g] for g, v in groups.items() if v > np.log(COUNTS)]
    drifting = _drifting(rows, stack, whitener, counted)
    ranking = Ranking(stack, evidence, best, groups, base.values, drifting, beside=beside)
    if accepted or ranking.claims:
        return ranking
    return replace(ranking, pair=_pair(scores, hidden))


def _with_fullest(stack: Stack, evidence: FloatArray, leader: Candidate) -> list[Candidate]:
    """Return the leader of a group, and the best that has all of its effect's parameters.

    Levels that are those of no candidate, or of one axis alone, take what other axes show for
    drift, and then they do not count.
    """
    own = {i: len(c.index) for i, c in stack.physics.items() if c.name == leader.name}
    most = max(own.values(), default=0)
    if not leader.physical or len(leader.index) == most:
        return [leader]
    return [leader, stack[max((i for i in own if own[i] == most), key=evidence.item)]]


def _running(groups: Mapping[str, float]) -> list[str]:
    """Return the groups that may be the answer: all, but where something is plainly left."""
    top = max(groups.values())
    return [g for g, v in groups.items() if top <= PLAIN or v >= top - AHEAD]


@dataclass(frozen=True, eq=False)
class _Hidden:
    """Evidence for the candidates `which` under levels that the null likes less, by ``null``."""

    evidence: FloatArray
    null: float
    which: BoolArray
    levels: FloatArray


@dataclass(frozen=True, eq=False)
class _Scores:
    """What all scores of one ranking share: what is fitted, and the noise under that alone."""

    rows: Rows
    stack: Stack
    accepted: list[Accepted]
    mean: FloatArray
    contrast: FloatArray
    base: Levels
    basis: FloatArray
    weight: FloatArray
    _whiteners: dict[tuple[bytes, bytes], Whitener] = field(default_factory=dict)

    @classmethod
    def of(cls, rows: Rows, stack: Stack, accepted: list[Accepted], start: FloatArray) -> _Scores:
        mean = fitted(rows, accepted)
        dense = mean[: rows.n_dense]
        # Beside what was accepted they start from what was found with it.
        find = estimate_levels if accepted else find_levels
        return cls(
            rows=rows,
            stack=stack,
            accepted=accepted,
            mean=mean,
            contrast=contrast_noise(rows, accepted),
            base=find(rows, dense, start),
            basis=range_basis(dense),
            weight=stack.weight,
        )

    def at(
        self,
        levels: FloatArray,
        contrast: FloatArray,
        null: float,
        which: BoolArray | None = None,
    ) -> FloatArray:
        """Return the evidence at some levels, of which the null has the log-likelihood `null`."""
        whitener = self.whitener(levels, contrast)
        y = whitener.project(self.rows.residual)
        factors = self.stack.log_bayes_factors(whitener, y, which=which)
        return factors + (null - self.base.log_likelihood) + self.weight

    def whitener(self, levels: FloatArray, contrast: FloatArray) -> Whitener:
        """Return the whitener at some levels, with what is fitted projected out.

        Those at the first levels are kept, and those at the last.
        """
        known, key = self._whiteners, (levels.tobytes(), contrast.tobytes())
        if key not in known:
            for old in [k for k in known if k[0] not in (self.base.values.tobytes(), key[0])]:
                del known[old]
            known[key] = make_whitener(self.rows, levels, contrast, self.mean)
        return known[key]

    def _null(self, levels: FloatArray) -> float:
        """Return the log-likelihood of some levels."""
        return level_likelihood(self.rows, self.basis, levels)

    def with_drift_of_all(
        self, evidence: FloatArray, running: BoolArray
    ) -> tuple[FloatArray, Levels, list[_Hidden]]:
        """Return the evidence where physics, or rivals, take up the drift of their channels.

        Of those candidates that are marked as running.

        Beside it the levels with all physics in the mean, and the evidence for physics there.
        """
        rows, stack, base = self.rows, self.stack, self.base
        dense = self.basis
        wide = np.hstack((dense, physics(stack)[: rows.n_dense]))
        every = find_levels(rows, wide, base.values)
        rivals = strongest_rivals(stack, evidence - self.weight)
        alone = [stack.of(c) for c in rivals.values() if len(c.channels) == 1]
        strongest = np.hstack(alone)[: rows.n_dense]
        free = estimate_levels(rows, np.hstack((dense, strongest)), every.values)
        hidden: list[_Hidden] = []
        for channels in (*((c,) for c in CHANNELS), CHANNELS[:3], CHANNELS[3:]):
            for physical, other in ((True, every), (False, free)):
                which = stack.of_channels(channels, physical=physical) & running
                if not which.any():
                    continue
                levels = _swap(rows, base.values, other.values, channels)
                null = self._null(levels)
                if physical:
                    scored = self.at(levels, self.contrast, null, which)
                    hidden.append(_Hidden(scored, null - base.log_likelihood, which, levels))
                else:
                    strong = rivals[channels]
                    outside, cost = self._suited(levels, strong, stack.of(strong))
                    scored = self.at(levels, outside, null + cost, which)
                evidence = np.maximum(evidence, scored)
        return evidence, every, hidden

    def with_own_drift(self, leader: Candidate, every: Levels) -> tuple[FloatArray, FloatArray]:
        """Return the evidence for a candidate's group with levels of its own, and these levels.

        Near its place, too.
        """
        rows, stack, base = self.rows, self.stack, self.base
        here, moved = leader, nearby(rows, leader)
        own = stack.of(leader)
        if len(moved):
            whitener = self.whitener(base.values, self.contrast)
            factors = moved.log_bayes_factors(whitener, whitener.project(rows.residual))
            here = moved[int(np.argmax(factors))]
            own = moved.of(here)
        with_own = np.hstack((self.basis, own[: rows.n_dense]))
        start = _swap(rows, base.values, every.values, leader.channels)
        found = estimate_levels(rows, with_own, start)
        outside, cost = self._suited(found.values, here, own)
        null = self._null(found.values) + cost
        null += found.log_share - base.log_share
        names, code = stack.groups()
        evidence = self.at(found.values, outside, null, code == names.index(leader.group))
        if len(moved):
            whitener = self.whitener(found.values, outside)
            factors = moved.log_bayes_factors(whitener, whitener.project(rows.residual))
            average = evidence_near(rows, moved, factors) + null - base.log_likelihood
            i = stack.index(leader)
            evidence[i] = max(evidence[i], average + self.weight[i])
        return evidence, found.values

    def _suited(
        self, levels: FloatArray, rival: Candidate, own: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return the variance of contrasts that suits a rival better, and what it costs the null.

        It is that outside of the rival's window, or that of all.
        """
        if rival.physical or rival.interval is None:
            return self.contrast, 0.0
        rows = self.rows
        outside = contrast_noise(rows, self.accepted, rival)
        # Where the null prefers it as well, that is no merit of the rival.
        cost = contrast_likelihood(rows, outside) - contrast_likelihood(rows, self.contrast)
        cost = min(cost, 0.0)
        value = []
        for variance in (self.contrast, outside):
            whitener = self.whitener(levels, variance)
            value.append(log_bayes_factor(whitener.project(own), whitener.project(rows.residual)))
        return (outside, cost) if value[1] + cost > value[0] else (self.contrast, 0.0)


def _drifting(
    rows: Rows, stack: Stack, whitener: Whitener, candidates: list[Candidate]
) -> frozenset[str]:
    """Return the groups of those candidates of which a drift can mimic more than half.

    None where windows that follow one another without a gap show how a bias goes on.
    """
    if not candidates or not rows.is_rest.any():
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


def _pair(scores: _Scores, hidden: list[_Hidden]) -> tuple[float, Candidate] | None:
    """Return two effects on the same channels that hide each other: evidence, and the first.

    Either alone leaves the other, which then counts as drift, and neither reaches the claim.
    """
    rows, stack = scores.rows, scores.stack
    best: tuple[float, Candidate | None] = (float(np.log(CLAIM / DRIFTING)), None)
    for item in hidden:
        tried: list[str] = []
        own = np.flatnonzero(item.which)
        for i in own[np.argsort(-item.evidence[own], kind="stable")].tolist():
            first = stack[i]
            if first.name in tried:
                continue
            tried.append(first.name)
            # Only where the first gains something by itself is there a pair to find.
            if len(tried) > PAIRS or item.evidence[i] - item.null + scores.weight[i] < 0:
                break
            mean = np.hstack((scores.mean, stack.of(first)))
            whitener = make_whitener(rows, item.levels, scores.contrast, mean)
            y = whitener.project(rows.residual)
            rest = np.zeros(len(item.which), bool)
            rest[[k for k in own.tolist() if stack[k].name != first.name]] = True
            if not rest.any():
                continue
            second = stack.log_bayes_factors(whitener, y, which=rest) + scores.weight
            value = float(item.evidence[i] + second[rest].max())
            if value > best[0]:
                best = (value, first)
    return None if best[1] is None else (best[0], best[1])


def _swap(rows: Rows, base: FloatArray, every: FloatArray, channels: tuple[str, ...]) -> FloatArray:
    """Return the levels of `every` for the drift of some channels, and of `base` for the rest.

    The closures' own errors are those of both triads, and so of any channel.
    """
    others = [c for c in CHANNELS if c not in channels]
    own = np.array([c.name.split(" ")[0] not in others for c in rows.components])
    return np.where(own, np.minimum(base, every), base)
