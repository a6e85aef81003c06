"""The joint fit of all that was found: the model moved there, and linearised anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from calib.effects import get_effect
from calib.effects.base import PRESENCE, Term, TransformEffect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import candidate_columns, is_step, neighbours, settles
from calib.mismatch.hypotheses.slipped import TURN, angle_of, slip_columns, turned_on
from calib.mismatch.noise.noise import estimate_levels, find_levels, make_whitener
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, contrast_noise, fitted
from calib.mismatch.search.joint import solve
from calib.mismatch.search.refine import likelihood_gain, refine_last, refined
from calib.types import FloatArray

REFINED = 3
"""How often a shape is refined, at most, the noise being estimated anew each time."""

STEPS = 4
"""Steps of a fit, at most."""

BENT = 1.0
"""Square of the standard errors by which rows may be off what a step promised: less than what one
parameter more would fit. A delay times half a metre of arm is beyond in the first step, and so is a
misalignment of a tenth."""

PLACED = 0.5
"""Log-likelihood that another moment must gain: less is no parameter's worth."""

SAME = 1e-3
"""Change of columns, relative to them, that is none: of an effect of 100 standard errors it leaves
the tenth part of one."""


class Problem(Protocol):
    """Where rows come from: a recording and its twin, a simulation, or a reference."""

    reference: bool
    moves_signals: bool
    late: float

    def rows(self) -> Rows:
        """Return recording minus model, linearised where the model stands."""
        ...

    def as_linearised(self, rows: Rows) -> Rows:
        """Return rows with the residual, and the motion, of where the model stands now."""
        ...

    def move(
        self, baseline: Mapping[str, float], nuisance: FloatArray, terms: tuple[Term, ...]
    ) -> None:
        """Move the model: baseline and nuisances by steps, further terms to these."""
        ...

    def place(self) -> object:
        """Return where the model stands, for `go_back`."""
        ...

    def go_back(self, place: object) -> None:
        """Let the model stand where it stood."""
        ...


class Refit(NamedTuple):
    """What a joint fit ends with.

    ``straight`` if rows went where the first step promised: the columns of candidates are then
    what they were.
    """

    rows: Rows
    accepted: list[Accepted]
    levels: FloatArray
    straight: bool


def refit(
    problem: Problem,
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    *,
    refine: bool = True,
) -> Refit:
    """Fit everything jointly, move the model there, and linearise anew.

    ``refine`` is whether shapes may move: that of the last finding, if it is one of the grid's and
    yet to be refined, and of all in which time they settle.
    """
    contrast = contrast_noise(rows, accepted)
    levels = find_levels(rows, fitted(rows, accepted), levels).values
    rough = refine and bool(accepted) and not accepted[-1].in_model
    for _ in range(REFINED if rough else 0):
        before = accepted[-1].candidate
        accepted[-1] = refine_last(rows, accepted, levels, contrast, reference=problem.reference)
        own = accepted[-1].candidate
        if own is before or not (before.physical or angle_of(own) is not None):
            break
        # What a shape that was not yet right had left is noise no more.
        levels = estimate_levels(rows, fitted(rows, accepted), levels).values
    rows, accepted, steps, off = _stepped(problem, rows, accepted, levels, contrast)
    straight = steps == 1 and off < BENT
    if straight and rough and _is_felt(accepted[-1]):
        # Now the sensor's errors act on that as well: of a table's gravity none of them is known,
        # but of what an arm adds to it.
        rows, accepted, _, off = _stepped(problem, rows, accepted, levels, contrast)
        straight, steps = False, 2
    for _ in range(REFINED):
        if steps == 1 or not off < BENT:
            break
        # What was bent weighed as noise: beside less, steps go on to where they lead.
        levels = find_levels(rows, fitted(rows, accepted), levels).values
        contrast = contrast_noise(rows, accepted)
        rows, accepted, steps, off = _stepped(problem, rows, accepted, levels, contrast)
    for _ in range(REFINED if rough else 0):
        placed, levels = _placed_anew(problem, rows, accepted, levels, contrast)
        if placed is None:
            break
        accepted = [*accepted[:-1], placed]
        rows = put_back(problem, rows, accepted)
        accepted = [_renew(a, rows, reference=problem.reference) for a in accepted]
        rows, accepted, steps, off = _stepped(problem, rows, accepted, levels, contrast)
        straight = straight and steps == 1 and off < BENT
    moved = _shapes_anew(problem, rows, accepted, levels, contrast, steps=rough) if refine else None
    if moved is not None:
        rows = put_back(problem, rows, moved)
        accepted = [_renew(a, rows, reference=problem.reference) for a in moved]
        levels = estimate_levels(rows, fitted(rows, accepted), levels).values
        rows, accepted, steps, off = _stepped(problem, rows, accepted, levels, contrast)
        straight = straight and steps == 1 and off < BENT
    return Refit(rows, accepted, levels, straight)


def _is_felt(a: Accepted) -> bool:
    """Whether the model has taken up a setup, which changes what the sensor feels."""
    return a.in_model and get_effect(a.candidate.name).kind == "setup"


def _shapes_anew(
    problem: Problem,
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    contrast: FloatArray,
    *,
    steps: bool,
) -> list[Accepted] | None:
    """Return the findings with their shapes as they are beside all that was found since.

    What a turn lacks the moment of a step in it makes up for: that of another cause, if it is the
    first that is found. And on one axis, beside noise that holds what the others do, it hardly
    shows in which time something settles. None if nothing moves; of ``steps`` unless they may.
    """
    moved = list(accepted)
    for i, a in enumerate(accepted):
        if not (settles(a.candidate) or (steps and is_step(a.candidate))):
            continue
        whitener = make_whitener(
            rows, levels, contrast, fitted(rows, accepted[:i] + accepted[i + 1 :])
        )
        left = rows.residual + a.columns @ (a.values / a.typical) * a.in_model
        y = whitener.project(left)
        candidate, columns = refined(
            rows, a.candidate, a.columns, whitener, y, reference=problem.reference
        )
        gain = likelihood_gain(whitener.project(columns), y)
        if gain > likelihood_gain(whitener.project(a.columns), y) + PLACED:
            moved[i] = replace(a, candidate=candidate, columns=columns)
    return None if all(a is b for a, b in zip(moved, accepted, strict=True)) else moved


def _placed_anew(
    problem: Problem,
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    contrast: FloatArray,
) -> tuple[Accepted | None, FloatArray]:
    """Return the last finding at a better moment, if there is one, and the levels beside it.

    What is late by a sample is not so in proportion, if a hand trembles: what the line leaves in
    all later turns hides in which sample it began, until the model has taken it up as it is. Nor
    does the line tell where a turn sets in whether that was late. In a rest all moments are alike:
    one beside it is as probable as it is longer than a sample.
    """
    last = accepted[-1]
    if not last.in_model or "moment" not in last.candidate.shape:
        return None, levels
    effect = get_effect(last.candidate.name)
    if not isinstance(effect, TransformEffect):
        return None, levels
    mean = fitted(rows, accepted)
    levels = estimate_levels(rows, mean, levels).values
    whitener = make_whitener(rows, levels, contrast, mean)
    y, size = whitener.project(rows.residual), last.values / last.typical

    def at(shape: dict[str, float]) -> Accepted:
        return replace(last, candidate=replace(last.candidate, shape=shape))

    best, value = None, PLACED
    for shape in neighbours(effect, rows, last.candidate.shape):
        there = candidate_columns(rows, last.candidate, shape, reference=problem.reference)
        if there is None:
            continue
        moved = whitener.project((there - last.columns) @ size)
        gain = likelihood_gain(moved[:, None], y, present=True)
        if gain > value:
            best, value = at(shape), gain
    own = (best or last).candidate.shape
    k = rows.segment_at(own["moment"])
    sample = float(np.median(np.diff(rows.state.time)))
    beside = rows.interval[max(k - 1, 0) : k + 2]
    if np.abs(beside.mean(axis=1) - own["moment"]).min() < 0.5 * sample:
        beside = beside[:0]  # it is in the middle of one
    for start, stop in beside.tolist():
        tried = at({**own, "moment": 0.5 * (start + stop)})
        left = whitener.project(put_back(problem, rows, [*accepted[:-1], tried]).residual)
        gain = 0.5 * float(y @ y - left @ left) + float(np.log((stop - start) / sample))
        if gain > value:
            best, value = tried, gain
    if best is None:
        put_back(problem, rows, accepted)
    return best, levels


def _stepped(
    problem: Problem,
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    contrast: FloatArray,
) -> tuple[Rows, list[Accepted], int, float]:
    """Step until rows go where steps promise; return how many it took and how far the last was off.

    A step may land farther off than all there was to explain: what turns both sensors by a tenth is
    bent by more than a gyroscope's noise. The next one mends that, or nothing does: what no sensor
    puts out leads nowhere, and there is no going on from there.
    """
    steps, off = 0, np.inf
    kept, place, beyond = (rows, accepted), problem.place(), 0
    while off >= BENT and steps < STEPS:
        variance = np.concatenate((rows.variance(levels), contrast))
        with np.errstate(over="ignore", invalid="ignore"):
            there = _step(problem, rows, accepted, levels, contrast)
            bent = there.rows.residual - (rows.residual - there.removed) - there.changed
            off = float((np.square(bent) / variance).sum())
        rows, accepted = there.rows, there.accepted
        steps, beyond = steps + 1, beyond + 1
        if off < float((np.square(kept[0].residual) / variance).sum()):
            kept, place, beyond = (rows, accepted), problem.place(), 0
        elif beyond > 1 or not np.isfinite(off):
            break
    problem.go_back(place)
    return *kept, steps - beyond, off


def unmoved(seen: FloatArray, rows: Rows) -> bool:
    """Whether what is always fitted, (m, p), is what was `seen` before a fit moved the model.

    Beside a reference all columns change with the alignment, those of the catalogue as these.
    """
    if not rows.aligned:
        return True
    change = np.square(fitted(rows, []) - seen).sum(axis=0)
    return bool((change <= SAME**2 * np.square(seen).sum(axis=0)).all())


class _Stepped(NamedTuple):
    """Where a step leads, and what it should have taken from the rows.

    ``changed`` is by how much what the model has not taken up became another there.
    """

    rows: Rows
    accepted: list[Accepted]
    removed: FloatArray
    changed: FloatArray


def _step(
    problem: Problem,
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    contrast: FloatArray,
) -> _Stepped:
    step = solve(rows, accepted, levels, contrast)
    p, q = rows.baseline.shape[1], rows.nuisance.shape[1]
    removed = rows.baseline @ step[:p] + rows.nuisance @ step[p : p + q]
    terms, at = [], p + q
    moved, beside = [], []
    for a in accepted:
        k = a.columns.shape[1]
        own = step[at : at + k]
        change = own * a.typical
        at += k
        if _movable(a.candidate, signals=problem.moves_signals):
            removed = removed + a.columns @ own
            a = replace(a, values=a.values + change, in_model=True)
            terms.append(_term(a))
            own = np.zeros(k)
        moved.append(a)
        beside.append(own)
    baseline, nuisance = dict(zip(rows.names, step[:p], strict=True)), step[p : p + q]
    problem.move(baseline, nuisance, tuple(terms))
    rows = problem.rows()
    renewed = [
        _renew(_slipped(rows, a, own), rows, reference=problem.reference)
        for a, own in zip(moved, beside, strict=True)
    ]
    changed = np.zeros(len(removed))
    for a, new, own in zip(moved, renewed, beside, strict=True):
        changed += (new.columns - a.columns) @ own
    return _Stepped(rows, renewed, removed, changed)


def put_back(problem: Problem, rows: Rows, accepted: list[Accepted]) -> Rows:
    """Return the rows of a model that has taken up what these findings say it has, no others."""
    take_up(problem, rows, accepted, np.zeros(rows.nuisance.shape[1]))
    return problem.rows()


def take_up(problem: Problem, rows: Rows, accepted: list[Accepted], nuisance: FloatArray) -> None:
    """Let the model take up what findings say it has, no others; move the nuisances by steps."""
    terms = tuple(_term(a) for a in accepted if a.in_model)
    problem.move(dict.fromkeys(rows.names, 0.0), nuisance, terms)


def _term(a: Accepted) -> Term:
    values = dict(zip(a.candidate.parameters, a.values, strict=True))
    return Term(a.candidate.name, {**values, **a.candidate.shape})


def _movable(candidate: Candidate, *, signals: bool) -> bool:
    """Return whether a model can take up a finding.

    What is added always, and what acts on the signals in proportion; but where the model does not
    predict signals no event, which it takes out of the one turn that its moment is in.
    """
    if not candidate.physical:
        return False
    effect = get_effect(candidate.name)
    if not isinstance(effect, TransformEffect):
        return True
    lasting = signals or effect.kind != "event"
    return lasting and all(p.unit != PRESENCE for p in effect.parameters)


def _slipped(rows: Rows, a: Accepted, coefficients: FloatArray) -> Accepted:
    """Return a slip about the rotation that was found now; anything else as it is."""
    if angle_of(a.candidate) is None:
        return a
    return replace(a, candidate=turned_on(rows, a.candidate, coefficients[: len(TURN)]))


def _renew(a: Accepted, rows: Rows, *, reference: bool) -> Accepted:
    if angle_of(a.candidate) is not None:
        return replace(a, columns=slip_columns(rows, a.candidate))
    if not a.candidate.physical:
        return a
    columns = candidate_columns(rows, a.candidate, a.candidate.shape, reference=reference)
    return a if columns is None else replace(a, columns=columns)
