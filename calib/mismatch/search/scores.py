"""The evidence for candidates under noise of several levels.

That of all that is fitted, that of each channel where physics or rivals take up its drift, and that
of a candidate of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from calib.mismatch.hypotheses.answers import (
    STRONG,
    evidence_near,
    nearby,
    physics,
    strongest_rivals,
)
from calib.mismatch.hypotheses.bound import TOGETHER, factors_that_count
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.factors import log_bayes_factor
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.shared import likely_course
from calib.mismatch.noise.contrast import contrast_likelihood
from calib.mismatch.noise.noise import (
    Levels,
    Whitener,
    estimate_levels,
    find_levels,
    level_basis,
    level_likelihood,
    make_whitener,
    range_basis,
    whole_likelihood,
)
from calib.mismatch.noise.usual import usual_levels
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, contrast_noise, fitted
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Hidden:
    """Evidence for the candidates `which` under levels that the null likes less, by ``null``."""

    evidence: FloatArray
    null: float
    which: BoolArray
    levels: FloatArray


@dataclass(frozen=True, eq=False)
class Scores:
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
    def of(
        cls,
        rows: Rows,
        stack: Stack,
        accepted: list[Accepted],
        start: FloatArray,
        base: Levels | None = None,
    ) -> Scores:
        mean = fitted(rows, accepted)
        basis = level_basis(rows, mean)
        if base is None:
            # Beside what was accepted they start from what was found with it.
            find = estimate_levels if accepted else find_levels
            base = find(rows, mean[:, :0], start, beside=basis)
        return cls(
            rows=rows,
            stack=stack,
            accepted=accepted,
            mean=mean,
            contrast=contrast_noise(rows, accepted),
            base=base,
            basis=basis,
            weight=stack.weight,
        )

    def first(self) -> tuple[FloatArray, BoolArray]:
        """Return the evidence at the first levels of what counts, and which candidates that are."""
        whitener = self.whitener(self.base.values, self.contrast)
        y = whitener.project(self.rows.residual)
        factors, which = factors_that_count(self.stack, self.rows, whitener, y)
        return factors + self.weight, which

    def at(
        self, levels: FloatArray, contrast: FloatArray, null: float, which: BoolArray
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
        """Return the log-likelihood of some levels.

        Beside a truth means tell the levels, but what is fitted is told by contrasts as well.
        Levels as low as means allow that are fitted by themselves may leave either far off, and
        any effect would gain by that: so they cost what they do by all rows, if that is more.
        """
        own = level_likelihood(self.rows, self.basis, levels)
        if not self.rows.aligned:
            return own
        cost = whole_likelihood(self.rows, self._whole[0], levels, self.contrast) - self._whole[1]
        return min(own, self.base.log_likelihood + cost)

    @cached_property
    def _whole(self) -> tuple[FloatArray, float]:
        """The basis of what is fitted on all rows, and their log-likelihood at the first levels."""
        basis = range_basis(self.mean)
        return basis, whole_likelihood(self.rows, basis, self.base.values, self.contrast)

    def with_drift_of_all(
        self,
        evidence: FloatArray,
        running: BoolArray,
        known: FloatArray | None,
        *,
        plain: bool,
    ) -> tuple[FloatArray, Levels, list[Hidden]]:
        """Return the evidence where physics, or rivals, take up the drift of their channels.

        Of those candidates that are marked as running. What is ``plain`` is judged with the drift
        that either leaves: there levels change it by more than one answer is ahead of another.

        Beside it the levels with all physics in the mean, and the evidence for physics there. Their
        search starts from those of an earlier ranking, if they are `known`: physics that was
        accepted since was in the mean already.
        """
        rows, stack, base = self.rows, self.stack, self.base
        wide, basis = physics(stack), self.basis
        if known is None:
            every = find_levels(rows, wide, base.values, beside=basis)
        else:
            every = estimate_levels(rows, wide, known, beside=basis)
        rivals = strongest_rivals(stack, evidence - self.weight)
        alone = [stack.of(c) for c in rivals.values() if len(c.channels) == 1]
        none = self.mean[:, :0]
        free = estimate_levels(rows, np.hstack((none, *alone)), every.values, beside=basis)
        hidden: list[Hidden] = []
        # Of channels whose drift nothing takes up the levels are the same: they are scored at once.
        alike: dict[bytes, tuple[FloatArray, list[BoolArray]]] = {}
        for channels in TOGETHER:
            which = stack.of_channels(channels, physical=True) & running
            if which.any():
                levels = _swap(rows, base.values, every.values, channels)
                alike.setdefault(levels.tobytes(), (levels, []))[1].append(which)
        for levels, each in alike.values():
            null = self._null(levels)
            scored = self.at(levels, self.contrast, null, np.logical_or.reduce(each))
            cost = null - base.log_likelihood
            hidden += [Hidden(scored, cost, which, levels) for which in each]
            evidence = np.maximum(evidence, scored)
        for channels in TOGETHER:
            levels = _swap(rows, base.values, free.values, channels)
            which = stack.of_channels(channels, physical=True) & running
            if plain and which.any():
                scored = self.at(levels, self.contrast, self._null(levels), which)
                evidence = np.maximum(evidence, scored)
            which = stack.of_channels(channels, physical=False) & running
            if which.any():
                strong = rivals[channels]
                outside, cost = self._suited(levels, strong, stack.of(strong))
                scored = self.at(levels, outside, self._null(levels) + cost, which)
                evidence = np.maximum(evidence, scored)
        return evidence, every, hidden

    def usual(self, channels: tuple[str, ...]) -> FloatArray | None:
        """Return the `usual_levels` of some channels."""
        return usual_levels(self.rows, self.base.values, channels)

    def with_usual_drift(self, evidence: FloatArray, running: BoolArray) -> FloatArray:
        """Return the evidence of those that are running with the `usual` drift, where it is more.

        A disturbance may be what raises that of its channels.
        """
        for channels in TOGETHER:
            which = running & (
                self.stack.of_channels(channels, physical=True)
                | self.stack.of_channels(channels, physical=False)
            )
            levels = self.usual(channels) if which.any() else None
            if levels is not None:
                scored = self.at(levels, self.contrast, self._null(levels), which)
                evidence = np.maximum(evidence, scored)
        return evidence

    def with_own_drift(
        self, leader: Candidate, every: Levels, near: Sequence[FloatArray]
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield the evidence for a candidate's group with levels of its own, and these levels.

        Near its place, too: they are those of where it shows best under each of the levels ``near``
        (with what is known, or with the `usual` drift). What shows best under several is yielded
        once.
        """
        rows, moved = self.rows, nearby(self.rows, leader)
        if not len(moved):
            yield self._beside(leader, every, moved, leader, self.stack.of(leader), [])
            return
        known = set[tuple[bytes, ...]]()
        for levels in near:
            whitener = self.whitener(levels, self.contrast)
            y = whitener.project(rows.residual)
            factors = moved.log_bayes_factors(whitener, y)
            order = np.argsort(-factors)
            here = moved[int(order[0])]
            own, between = moved.of(here), list[FloatArray]()
            if here.may_be_shared:
                own = likely_course(own, whitener.project(own), y)
            if here.physical and factors[order[0]] > STRONG:
                # What a shape that is a little off leaves of a strong effect is no drift.
                between = [moved.of(moved[i]) for i in order[1:3].tolist()]
            key = tuple(columns.tobytes() for columns in (own, *between))
            if key not in known:
                known.add(key)
                yield self._beside(leader, every, moved, here, own, between)

    def _beside(
        self,
        leader: Candidate,
        every: Levels,
        moved: Stack,
        here: Candidate,
        own: FloatArray,
        between: list[FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Return what `with_own_drift` yields: with the columns of one place in the mean.

        ``moved`` has all places of the leader, ``here`` is the one, ``own`` its columns, and
        ``between`` are those of its neighbours.
        """
        rows, stack, base = self.rows, self.stack, self.base
        start = _swap(rows, base.values, every.values, leader.channels)
        found = estimate_levels(rows, np.hstack((own, *between)), start, beside=self.basis)
        outside, cost = self._suited(found.values, here, own)
        null = self._null(found.values) + cost
        null += found.log_share - base.log_share
        names, code = stack.groups()
        evidence = self.at(found.values, outside, null, code == names.index(leader.group))
        if len(moved):
            whitener = self.whitener(found.values, outside)
            average = evidence_near(rows, moved, whitener, whitener.project(rows.residual))
            average += null - base.log_likelihood
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


def _swap(rows: Rows, base: FloatArray, every: FloatArray, channels: tuple[str, ...]) -> FloatArray:
    """Return the levels of `every` for the drift of some channels, and of `base` for the rest.

    The closures' own errors are those of both triads, and so of any channel.
    """
    others = [c for c in CHANNELS if c not in channels]
    own = np.array([c.name.split(" ")[0] not in others for c in rows.components])
    return np.where(own, np.minimum(base, every), base)
