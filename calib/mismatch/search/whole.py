"""A delay against a low-pass, each as the whole change that it makes.

A gyroscope that is late and one behind a low-pass of that group delay are the same to the first
order; what tells them apart is of the third. So a delay must not be judged by how it begins: at
20 ms it is off by more than the two differ. Where it is not straight, both are judged as the
difference of the turns as they were recorded and as they were before (`rows.restored`), each with
its size refined and under noise of its own. Beside a truth that is where the model with the delay
leaves the rows, and the low-pass of the true signals.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from calib.effects import get_effect
from calib.effects.bandwidth import cutoff_of, group_delay
from calib.effects.base import TransformEffect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import candidate_columns
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.contrast import contrast_likelihood
from calib.mismatch.noise.noise import Levels, Whitener, find_levels, make_whitener
from calib.mismatch.rows.restored import STILL, whole_change
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import UNLIKE, Accepted, contrast_noise, fitted
from calib.mismatch.search.estimate import pseudo_inverse
from calib.mismatch.search.joint import scaled
from calib.mismatch.search.refine import likelihood_gain
from calib.mismatch.search.refit import BENT, Problem, Refit, put_back, refit, take_up
from calib.types import FloatArray

DELAY, LOW_PASS, CLOCK = "time_offset", "bandwidth", "time_offset.delay"

CLOCK_STEPS, CLOCK_SETTLED = 2, 1e-5
"""Steps of the clocks' offset beside a change, each to where columns lead, and one (s) that ends
them: it is where one of the triads had it, or the other, or both, and one of them may be late."""

DELAYS = np.geomspace(0.005, 0.32, 7)
"""s, either way. Steps lead from half a delay to all of it: turns take a second and more."""

STEPS, SETTLED = 8, 1e-3
"""Steps to the best size, at most, and the square of one, in standard errors, that ends them."""

FITS, SAME = 6, 0.02
"""How often they are fitted, at most, each beside the baseline that the last one left; and by how
much a cut-off may still move, relative to it: the rest is refined with everything else."""

CLEAR, TILT = 36.0, 0.25
"""Power by which a low-pass of a noisy truth differs from a delay at least, and the gain beyond it,
in parts of that power, where it is one: half of it is expected, and minus half of a delay."""

SETTLES = 2
"""How often noise is estimated beside what is left, and what is fitted beside that noise."""

HALVED = 5
"""How often a step is halved, at most, until it leads up."""

NEAR = 1e-3
"""How far from a size, relative to it, another shows where a change goes from there."""


@dataclass(frozen=True, eq=False)
class Family:
    """Changes of one size: a delay, or the low-passes of one order on one triad.

    ``candidate`` is one of them in the stack, ``size`` the name of what is varied, within `within`.
    Samples are ``step`` apart, s.
    """

    candidate: Candidate
    size: str
    within: tuple[float, float]
    step: float

    @property
    def is_delay(self) -> bool:
        """Whether it is the delay, of which the size is in proportion."""
        return self.candidate.name == DELAY

    def parameters(self, size: float) -> Mapping[str, float]:
        """Return the effect's parameters at a size."""
        present = dict.fromkeys(self.candidate.parameters, 1.0)
        return {**present, **self.candidate.shape, self.size: size}

    def late(self, size: float) -> float:
        """Return by how much the gyroscope comes late beside the accelerometer, s."""
        if self.is_delay:
            return size
        delay = group_delay(size, _order(self.candidate), self.step)
        return delay if self.size.startswith("gyro") else -delay

    def size_of(self, late: float) -> float:
        """Return the size at which the triad comes late by so much, s."""
        if self.is_delay:
            return late
        return cutoff_of(abs(late), _order(self.candidate), self.step)


@dataclass(frozen=True, eq=False)
class Whole:
    """The best of one family: its size, and what it did to the rows."""

    family: Family
    size: float
    column: FloatArray
    clock: float = 0.0
    """By how much the clocks' offset is moved with it, s."""

    @property
    def name(self) -> str:
        """The effect."""
        return self.family.candidate.name

    @property
    def late(self) -> float:
        """By how much the gyroscope comes late beside the accelerometer, s."""
        return self.family.late(self.size)


class Judge:
    """Log-likelihoods of whole changes beside what was accepted, under the noise of some levels.

    The ``problem`` stands where it has taken up what was accepted, and nothing else. The truth
    beside it is ``noisy`` if low-passes of it were not tried.
    """

    def __init__(
        self,
        problem: Problem,
        rows: Rows,
        stack: Stack,
        accepted: list[Accepted],
        levels: FloatArray,
    ) -> None:
        self.problem, self.accepted = problem, accepted
        tried = any(c.name == LOW_PASS for c in stack.physics.values())
        self.noisy = problem.reference and not tried
        self.rows, self.mean = rows, fitted(rows, accepted)
        self.step = rows.state.interval
        self._settle(levels, contrast_noise(rows, accepted))

    def settle(self, whole: Whole, *, unlike: float = UNLIKE) -> float:
        """Judge under the noise that an explanation leaves from now on; return the likelihood.

        Of what it leaves, as a logarithm. What one of another make would leave, the part ``unlike``
        of the change, counts as noise.
        """
        left = self.rows.with_residual(self.rows.residual - whole.column)
        # What is fitted is no noise either, and beside less of it is known better.
        for _ in range(SETTLES):
            levels = self.without(whole)
            off = left.residual - self.mean @ self._fitted(left.residual)
            fitted_too = left.with_residual(off + unlike * whole.column)
            self._settle(levels.values, contrast_noise(fitted_too, self.accepted))
        return levels.log_likelihood + contrast_likelihood(left.with_residual(off), self.contrast)

    def _fitted(self, residual: FloatArray) -> FloatArray:
        """Return the coefficients of what is fitted, beside the noise as it is."""
        unit, size = scaled(self.mean)
        white = self.whitener.whiten(np.column_stack((unit, residual)))
        return np.asarray(pseudo_inverse(white[:, :-1]) @ white[:, -1] / size)

    def _settle(self, levels: FloatArray, contrast: FloatArray) -> None:
        self.levels, self.contrast = levels, contrast
        self.whitener: Whitener = make_whitener(self.rows, levels, contrast, self.mean)
        self.y = self.whitener.project(self.rows.residual)

    def gain(self, column: FloatArray) -> float:
        """Return the log-likelihood that a change gains."""
        white = self.whitener.project(column)
        return likelihood_gain(white[:, None], self.y, present=True)

    def power(self, column: FloatArray) -> float:
        """Return the square of a column in units of the noise."""
        return float(np.square(self.whitener.project(column)).sum())

    def without(self, whole: Whole) -> Levels:
        """Return the levels of the noise that an explanation leaves, and their log-likelihood."""
        rows = self.rows.with_residual(self.rows.residual - whole.column)
        return find_levels(rows, self.mean, self.levels)

    def most_likely(self, found: Sequence[Whole]) -> Whole:
        """Return the explanation that is most probable, each under noise of its own.

        Beside a noisy truth the noise of the best holds for all: what that truth has in common with
        itself a low-pass leaves, and lower levels with it.
        """
        if not self.problem.reference:
            return max(found, key=lambda whole: self.without(whole).log_likelihood)
        if not self.noisy:
            # Each by what it leaves: the larger a change, the more would count as noise besides.
            return max(found, key=lambda whole: self.settle(whole, unlike=0.0))
        first = max(found, key=self._value)
        self.settle(first)
        delay, *low_passes = found
        clear = [own for own in low_passes if self.is_clear(own, delay)]
        return max((delay, *clear), key=self._value)

    def is_clear(self, low_pass: Whole, delay: Whole) -> bool:
        """Whether the rows are nearer to a low-pass than to a delay by more than noise tilts them.

        Of two changes that differ by the power P the likelihoods differ by P/2, either way. Noise
        of the truth is in the low-pass as well, where it takes away what the differences lack.
        """
        power = self.power(low_pass.column - delay.column)
        gain = self.gain(low_pass.column) - self.gain(delay.column)
        return power > CLEAR and gain > TILT * power

    def _value(self, whole: Whole) -> float:
        """Return the log-likelihood that an explanation gains, orders sharing what one has."""
        return self.gain(whole.column) - (0.0 if whole.family.is_delay else float(np.log(3.0)))

    def best(self, family: Family, starts: Iterable[float]) -> Whole:
        """Return the member of a family that gains most, near the best of some sizes."""
        low, high = family.within
        tried = [self._clocked(family, float(np.clip(size, low, high))) for size in starts if size]
        found, white = max(tried, key=lambda each: likelihood_gain(each[1], self.y, present=True))
        for _ in range(STEPS):
            # What is left is fitted by how the change goes on from here (Gauss-Newton).
            near = found.size * (1.0 + NEAR if found.size * (1.0 + NEAR) < high else 1.0 - NEAR)
            moves = found.clock / found.late
            slope = (self._tried(family, near, moves)[1] - white)[:, 0] / (near - found.size)
            power = float(slope @ slope)
            step = float(slope @ (self.y - white[:, 0])) / max(power, 1e-300)
            least = likelihood_gain(white, self.y, present=True)
            for _ in range(HALVED):
                size = float(np.clip(found.size + step, low, high))
                if (size - found.size) ** 2 * power < SETTLED or not size:
                    return found
                there = self._clocked(family, size, moves)
                if likelihood_gain(there[1], self.y, present=True) > least:
                    break
                # It led too far: a cut-off is bent.
                step *= 0.5
            else:
                return found
            found, white = there
        return found

    def _clocked(self, family: Family, size: float, moves: float = 0.0) -> tuple[Whole, FloatArray]:
        """Return the same with the clocks' offset where the best of its steps leads."""
        best = self._tried(family, size, moves)
        if CLOCK not in self.rows.aligned:
            return best
        for _ in range(CLOCK_STEPS):
            found = best[0]
            moves = (found.clock + self._clock_beside(found.column)) / found.late
            if abs(moves * found.late - found.clock) < CLOCK_SETTLED:
                break
            there = self._tried(family, size, moves)
            if self.gain(there[0].column) <= self.gain(found.column):
                break
            best = there
        return best

    def _clock_beside(self, column: FloatArray) -> float:
        """Return by how much the clocks' offset moves, s, as columns have it, beside a change."""
        which = self.rows.baseline.shape[1] + self.rows.aligned.index(CLOCK)
        return float(self._fitted(self.rows.residual - column)[which])

    def _tried(self, family: Family, size: float, moves: float) -> tuple[Whole, FloatArray]:
        """Return a member of a family, and its whitened column (m, 1).

        The clocks' offset is moved by ``moves`` times what the gyroscope comes late.
        """
        clock = moves * family.late(size)
        column = (
            self._beside_truth(family, size, clock)
            if self.problem.reference
            else self._of_turns(family, size)
        )
        return Whole(family, size, column, clock), self.whitener.project(column)[:, None]

    def _of_turns(self, family: Family, size: float) -> FloatArray:
        """Return what a member of a family did to the rows of a recording by itself, (m,)."""
        effect = get_effect(family.candidate.name)
        assert isinstance(effect, TransformEffect)
        change = whole_change(effect, self.rows, family.parameters(size))
        return np.zeros(len(self.y)) if change is None else change

    def _beside_truth(self, family: Family, size: float, clock: float) -> FloatArray:
        """Return what it did to the differences between a recording and its truth, (m,).

        The clocks' offset is moved by `clock`, s.
        """
        candidate, rows = family.candidate, self.rows
        taken = self.accepted
        if family.is_delay:
            late = Accepted(candidate, np.zeros((0, 1)), np.ones(1), np.array([size]), True, 1.0)
            taken = [*taken, late]
        if family.is_delay or clock:
            place = self.problem.place()
            take_up(self.problem, rows, taken, _of_clock(rows, clock))
            rows = self.problem.as_linearised(rows)
            self.problem.go_back(place)
        change = self.rows.residual - rows.residual
        if family.is_delay:
            return change
        shape = {**candidate.shape, family.size: size}
        columns = candidate_columns(rows, candidate, shape, reference=True)
        return change if columns is None else change + columns[:, 0]


def _of_clock(rows: Rows, offset: float) -> FloatArray:
    """Return steps of the nuisances, all zero but that of the clocks' offset, s."""
    return np.array([offset * (name == CLOCK) for name in rows.aligned])


def _order(low_pass: Candidate) -> int:
    return int(low_pass.shape["order"])


def whole_fit(
    problem: Problem,
    rows: Rows,
    stack: Stack,
    accepted: list[Accepted],
    new: Accepted,
    levels: FloatArray,
) -> Refit | None:
    """Fit the better of a delay and a low-pass, as whole changes, in the place of either.

    None of anything else, and of a delay that is straight: its column tells as much. The twin that
    did not know of either is off by some of it. So they are judged again beside what was fitted
    together with the first, and so on until that is the best. Where a triad is late by far that
    comes first, whatever columns say: they are all off by that much.

    Parameters
    ----------
    problem, rows, stack, accepted : Problem, Rows, Stack, list of Accepted
        Without the new one.
    new : Accepted
    levels : (c,) array
        Of the noise beside it.
    """
    far = bool(problem.late) and all(a.candidate.name not in (DELAY, LOW_PASS) for a in accepted)
    if not (far or _alone(new, accepted)):
        return None
    judge = Judge(problem, rows, stack, accepted, levels)
    found = _explanations(judge, stack, new.candidate)
    if not found:
        return None
    best = judge.most_likely(found)
    for _ in range(FITS):
        rows, own = _accepted(problem, rows, stack, accepted, new, best)
        fit = refit(problem, rows, [*accepted, own], levels, refine=False)
        rows, accepted, levels = fit.rows, fit.accepted[:-1], fit.levels
        judge = Judge(problem, put_back(problem, rows, accepted), stack, accepted, levels)
        found = _anew(judge, found)
        put_back(problem, rows, fit.accepted)
        again = judge.most_likely(found)
        alike = again.family is best.family
        if alike and (best.family.is_delay or abs(again.size / best.size - 1.0) < SAME):
            break
        best, rows = again, judge.rows
    return fit._replace(straight=False)


def _accepted(
    problem: Problem,
    rows: Rows,
    stack: Stack,
    accepted: list[Accepted],
    new: Accepted,
    best: Whole,
) -> tuple[Rows, Accepted]:
    """Return an explanation in the place of the new finding; a delay is taken out of the rows."""
    candidate = best.family.candidate
    if best.family.is_delay:
        typical, size = np.array([_typical(candidate)]), np.array([best.size])
        new = replace(new, candidate=candidate, typical=typical, values=size, in_model=True)
        rows = _taken_up(problem, rows, [*accepted, new], best.clock)
        columns = candidate_columns(rows, candidate, {}, reference=problem.reference)
        return rows, replace(new, columns=stack.of(candidate) if columns is None else columns)
    candidate = replace(candidate, shape={**candidate.shape, best.family.size: best.size})
    column = best.column[:, None]
    if best.clock:
        rows = _taken_up(problem, rows, accepted, best.clock)
        there = candidate_columns(rows, candidate, candidate.shape, reference=problem.reference)
        column = column if there is None else there
    return rows, replace(
        new, candidate=candidate, columns=column, typical=np.ones(1), values=np.zeros(1)
    )


def _taken_up(problem: Problem, rows: Rows, accepted: list[Accepted], clock: float) -> Rows:
    """Return rows of a model that has these findings, the clocks' offset moved by `clock`, s."""
    if not clock:
        return put_back(problem, rows, accepted)
    take_up(problem, rows, accepted, _of_clock(rows, clock))
    return problem.rows()


def whole_odds(
    problem: Problem,
    rows: Rows,
    stack: Stack,
    accepted: list[Accepted],
    which: int,
    levels: FloatArray,
    *,
    mimicked: float,
    least: float,
) -> Accepted:
    """Return a finding, if it is a delay or a low-pass, with the odds of the other in its place.

    One that is straight has them from its column. The other has a probability of ``least`` at least
    if the power of what it does not mimic is below ``mimicked``. Beside a truth with noise of its
    own a low-pass is no more probable than a delay, unless it is clear.
    """
    own = accepted[which]
    others = [a for i, a in enumerate(accepted) if i != which]
    if not _alone(own, others):
        return own
    before = put_back(problem, rows, others) if own.in_model else rows
    judge = Judge(problem, before, stack, others, levels)
    found = _explanations(judge, stack, own.candidate, least=0.0 if judge.noisy else BENT)
    if own.in_model:
        put_back(problem, rows, accepted)
    best: dict[str, Whole] = {}
    for whole in sorted(found, key=lambda whole: judge.gain(whole.column)):
        best[whole.name] = whole
    if len(best) < 2:
        return own
    mine = best.pop(own.candidate.name)
    (other,) = best.values()
    share = _share(judge, mine.column, other.column, mimicked=mimicked, least=least)
    if judge.noisy and mine.family.is_delay and not judge.is_clear(other, mine):
        share = min(share, 0.5)
    return _shared(own, {mine.name: 1.0 - share, other.name: share})


def _share(
    judge: Judge, mine: FloatArray, other: FloatArray, *, mimicked: float, least: float
) -> float:
    """Return the probability of another change against one's own."""
    share = float(expit(judge.gain(other) - judge.gain(mine)))
    return max(share, least) if judge.power(mine - other) < mimicked else share


def _shared(own: Accepted, odds: Mapping[str, float]) -> Accepted:
    """Return a finding whose probability is shared between two names."""
    both = sum(own.posterior.get(name, 0.0) for name in odds) or 1.0
    return replace(own, posterior={**own.posterior, **{k: both * v for k, v in odds.items()}})


def _alone(late: Accepted, others: list[Accepted]) -> bool:
    """Whether it has one triad come late, and no other does; a low-pass of both triads does not."""
    return (
        late.candidate.name in (DELAY, LOW_PASS)
        and late.candidate.parameters != ("both",)
        and all(a.candidate.name not in (DELAY, LOW_PASS) for a in others)
    )


def _typical(delayed: Candidate) -> float:
    (typical,) = (p.typical for p in get_effect(DELAY).parameters if p.name in delayed.parameters)
    return typical


def _explanations(
    judge: Judge, stack: Stack, chosen: Candidate, *, least: float = BENT
) -> list[Whole]:
    """Return the best delay, and low-passes of each order.

    Nothing where a delay is straight: off a line by less than ``least``, in units of the noise.
    """
    delays = (c for c in stack.physics.values() if c.parameters == ("gyro_delay",))
    delayed = next(delays, None)
    if delayed is None:
        return []
    line = stack.of(delayed)[:, 0] / _typical(delayed)
    white = judge.whitener.project(line)
    straight = float(white @ judge.y) / max(float(white @ white), 1e-300)
    family = Family(delayed, delayed.parameters[0], (-STILL, STILL), judge.step)
    # Beside a truth it is roughly known, or near, and low-passes tell where it may be.
    far = [judge.problem.late] if judge.problem.reference else [*-DELAYS, *DELAYS]
    delay = judge.best(family, [*far, straight])
    if judge.power(delay.column - delay.size * line) < least:
        return []
    triads = {"gyro" if delay.size > 0 else "accel"}
    if chosen.name == LOW_PASS:
        triads |= set(chosen.parameters)
    found = [delay]
    for family in _low_passes(judge, stack, delay, triads):
        starts = [family.size_of(delay.size), family.candidate.shape[family.size]]
        found.append(judge.best(family, starts))
    # Levels that had to make up for it leave sizes free that those beside the best do not.
    first = max(found, key=lambda whole: judge.gain(whole.column))
    judge.settle(first)
    return _anew(judge, found)


def _low_passes(judge: Judge, stack: Stack, delay: Whole, triads: set[str]) -> Iterator[Family]:
    """Yield the low-passes of each order on some triads that are to be tried beside a delay."""
    within = {i.name: (i.low or 0.0, i.high or np.inf) for i in get_effect(LOW_PASS).shape}
    known = {
        (c.parameters[0], c.shape["order"]): c
        for c in stack.physics.values()
        if c.name == LOW_PASS and len(c.parameters) == 1 and c.parameters[0] in triads
    }
    orders = next(item.codes for item in get_effect(LOW_PASS).shape if item.name == "order")
    for order in orders if judge.noisy else ():
        for triad in sorted(triads):
            size = cutoff_of(abs(delay.size), order, judge.step)
            shape = {f"{triad}_cutoff": size, "order": float(order)}
            known[triad, float(order)] = replace(
                delay.family.candidate,
                name=LOW_PASS,
                parameters=(triad,),
                shape=shape,
                present=True,
            )
    for (triad, _), candidate in known.items():
        yield Family(candidate, f"{triad}_cutoff", within[f"{triad}_cutoff"], judge.step)


def _anew(judge: Judge, found: list[Whole]) -> list[Whole]:
    """Return the best delay, and the best low-passes, near what they were and near each other."""
    starts = [found[0].size]
    if judge.problem.reference:
        # What trembles has hills of its own: the delay may be beyond the one that it seemed to be.
        starts += [whole.late for whole in found[1:]]
    delay = judge.best(found[0].family, starts)
    out = [delay]
    for whole in found[1:]:
        out.append(judge.best(whole.family, [whole.size, whole.family.size_of(delay.size)]))
    return out
