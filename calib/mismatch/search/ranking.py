"""All candidates ranked, each under the noise that it implies: drift competes on equal terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from calib.mismatch.hypotheses.answers import evidence_near, grouped, leading, nearby
from calib.mismatch.hypotheses.candidates import DELAY, Candidate
from calib.mismatch.hypotheses.families import add_catalogue, is_step
from calib.mismatch.hypotheses.rivals import add_rivals
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.noise import Levels, Whitener, make_whitener
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, again
from calib.mismatch.search.scores import Hidden, Scores
from calib.types import FloatArray

CLAIM = 3.0
"""E-value at which something is claimed to be left. Markov's inequality bounds the share of clean
recordings that reach it by a third, but only evidence that is all or nothing attains that: of
normal errors under as many looks as here, ``benchmarks/evidence.py`` counts 1 in 410."""

RARE = 0.025
"""Share of recordings of nothing but noise that reach an e-value of e, times e: 5 of 800 reach the
claim, and 7 of 710 reached 2.5, of one part and of many (``concealed.py --parts clean``), whose
noise had to be learnt from them. Of noise that is known it is less than half of that
(``evidence.py``). Markov's inequality has 1."""

ASIDE = 7.0
"""Log evidence below that of a claim from which a moment between those that were tried does not
raise a step to the running."""

PAIRS = 3
"""How many effects of one channel are tried as the first of a pair."""

PLAIN, AHEAD = 20.0, 20.0
"""Log evidence from which something is plainly left, and how far behind the best an answer then is
out of the running. Levels that are not raised by what was left out would put the best further
ahead, and are found for those in the running alone."""


@dataclass(frozen=True, eq=False)
class Ranking:
    """Log evidence (prior weight times Bayes factor) of every candidate, and of each group."""

    stack: Stack
    evidence: FloatArray
    best: dict[str, Candidate]
    groups: dict[str, float]
    levels: FloatArray
    whitener: Whitener
    """Under these levels, with what is fitted projected out."""
    pair: tuple[float, Candidate] | None = None
    beside: Mapping[str, FloatArray] = field(default_factory=dict)
    """Levels with the best of a group in the mean, of those groups for which they were found."""
    every: FloatArray | None = None
    """The same with all physics in the mean, where they were wanted."""

    def levels_with(self, candidate: Candidate) -> FloatArray:
        """Return levels to start from where a candidate is fitted too."""
        return self.beside.get(candidate.group, self.levels)

    @property
    def total(self) -> float:
        """Log e-value that anything is left."""
        return float(logsumexp(list(self.groups.values()))) if self.groups else -np.inf

    @property
    def claims(self) -> bool:
        """Whether that is enough to say that anything is left."""
        return bool(self.total >= np.log(CLAIM))


def chance(e_value: float) -> float:
    """Return the p-value of evidence, all looks counted: how rarely noise alone reaches it."""
    return min(1.0, RARE / e_value)


def make_stack(rows: Rows, *, skip: tuple[str, ...], reference: bool) -> Stack:
    """Return every candidate: the catalogue and its rivals."""
    stack = Stack(len(rows.residual))
    # Where a truth is noisy its slope is so most of all.
    add_rivals(stack, rows, skip=(*skip, DELAY) if rows.clustered else skip)
    add_catalogue(stack, rows, skip=skip, reference=reference)
    return stack


def rank(
    rows: Rows,
    stack: Stack,
    accepted: list[Accepted],
    start: FloatArray,
    *,
    base: Levels | None = None,
    every: FloatArray | None = None,
) -> Ranking:
    """Score every candidate under the noise that it implies.

    What was left out raises the drift of its channels. So each candidate is also scored with the
    drift of its own channels as it is with all physics in the mean (a rival: with the strongest
    rivals); with as much as that of the others lets one expect, where nothing is plain; and the
    leaders with drift estimated anew for each of them. Lower drift costs the likelihood of the
    null, and that cost is in the evidence: drift and effect compete on equal terms. So does what
    the null needs to take an effect for noise: levels that are just so.

    ``base`` are the levels with what was accepted in the mean, from `start`, if they are known, and
    ``every`` those with all physics in it, of an earlier ranking.
    """
    scores = Scores.of(rows, stack, accepted, start, base)
    base = scores.base
    evidence, counted = scores.first()
    best, groups = grouped(stack, evidence)
    running = _running(best, groups)
    running += _at_moments(scores, best, groups, running)
    wide: Levels | None = None
    hidden: list[Hidden] = []
    plain = max(groups.values()) > PLAIN
    if len(running) > 1:
        names, code = stack.groups()
        which = np.array([g in running for g in names])[code]
        if not counted.all():
            # The strongest rivals are taken of every channel.
            rest = scores.at(base.values, scores.contrast, base.log_likelihood, ~counted)
            evidence = np.maximum(evidence, rest)
        evidence, wide, hidden = scores.with_drift_of_all(evidence, which, every, plain=plain)
        best, groups = grouped(stack, evidence)
    known, may_hide = (evidence, best), len(running) > 1 and not plain
    if may_hide:
        evidence = scores.with_usual_drift(evidence, which)
        best, groups = grouped(stack, evidence)
    beside = {}
    for name in leading(best, {g: groups[g] for g in running}):
        tried = {c: [base.values] for c in with_fullest(stack, known[0], known[1][name])}
        last = [*tried][-1]
        usual = scores.usual(best[name].channels) if may_hide else None
        if usual is not None:
            for last in with_fullest(stack, evidence, best[name]):
                tried.setdefault(last, []).append(usual)
        if not last.shape and again(last, accepted):
            continue  # all of it is fitted: no drift makes it show
        most = -np.inf
        for leader, near in tried.items():
            for scored, levels in scores.with_own_drift(leader, wide or base, near):
                evidence = np.maximum(evidence, scored)
                if scored.max() > most:
                    most, beside[name] = float(scored.max()), levels
    best, groups = grouped(stack, evidence)
    whitener = scores.whitener(base.values, scores.contrast)
    ranking = Ranking(
        stack,
        evidence,
        best,
        groups,
        base.values,
        whitener,
        beside=beside,
        every=every if wide is None else wide.values,
    )
    if accepted or ranking.claims:
        return ranking
    return replace(ranking, pair=_pair(scores, hidden))


def with_fullest(stack: Stack, evidence: FloatArray, leader: Candidate) -> list[Candidate]:
    """Return the leader of a group, and the best that has all of its effect's parameters.

    Levels that are those of no candidate, or of one axis alone, take what other axes show for
    drift, and then they do not count.
    """
    own = {i: len(c.index) for i, c in stack.physics.items() if c.name == leader.name}
    most = max(own.values(), default=0)
    if not leader.physical or len(leader.index) == most:
        return [leader]
    return [leader, stack[max((i for i in own if own[i] == most), key=evidence.item)]]


def _running(best: Mapping[str, Candidate], groups: Mapping[str, float]) -> list[str]:
    """Return the groups that may be the answer: all, but where something is plainly left.

    And physics that began at a moment and is plain by itself: at an end of a rest, half of it away
    from where it is tried, it says but a part of what it will.
    """
    top = max(groups.values())
    return [
        g
        for g, v in groups.items()
        if top <= PLAIN
        or v >= top - AHEAD
        or (v >= PLAIN and best[g].physical and "moment" in best[g].shape)
    ]


def _at_moments(
    scores: Scores, best: Mapping[str, Candidate], groups: Mapping[str, float], running: list[str]
) -> list[str]:
    """Return further groups that are in the running at a moment between those that were tried.

    A bias that steps within a window, or a turn, is off by much of it on either side: where the
    step is what raises the levels of the drift, that is most of what it says.
    """
    top = max(groups.values())
    out: list[str] = []
    tried = [
        g
        for g, v in groups.items()
        if g not in running and v > np.log(CLAIM) - ASIDE and is_step(best[g])
    ]
    if not tried:
        return out
    whitener = scores.whitener(scores.base.values, scores.contrast)
    y = whitener.project(scores.rows.residual)
    for g in tried:
        leader = best[g]
        near = nearby(scores.rows, leader)
        if not len(near):
            continue
        value = evidence_near(scores.rows, near, whitener, y, strong=0.0)
        if value + np.log(leader.weight) >= min(PLAIN, top - AHEAD):
            out.append(g)
    return out


def _pair(scores: Scores, hidden: list[Hidden]) -> tuple[float, Candidate] | None:
    """Return two effects on the same channels that hide each other: evidence, and the first.

    Either alone leaves the other, which then counts as drift, and neither reaches the claim.
    """
    rows, stack = scores.rows, scores.stack
    best: tuple[float, Candidate | None] = (float(np.log(CLAIM)), None)
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
