"""Diagnose a recording against its own twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from calib.effects import effects
from calib.effects.base import Effect, State, TransformEffect
from calib.faults import FALSE_ALARM
from calib.mismatch.findings.aliases import find_aliases
from calib.mismatch.findings.diagnosis import (
    Diagnosis,
    Finding,
    Interval,
    Unexplained,
    Verdict,
    claimed,
    summarise,
    without_fit,
)
from calib.mismatch.findings.misclosed import misclosed
from calib.mismatch.hypotheses.candidates import DELAY
from calib.mismatch.hypotheses.places import gathered, joined
from calib.mismatch.missing import (
    LEANING,
    LEAST_DIRECTIONS,
    NO_REST,
    across_gravity,
    hidden_effects,
    lacking,
    with_turns,
    without_time,
)
from calib.mismatch.noise.leaning import lean_share
from calib.mismatch.realigned import coarse_delay, mostly_prompt, with_all
from calib.mismatch.rows.bumped import parted
from calib.mismatch.rows.choice import choose_poses, distinct_directions
from calib.mismatch.rows.grid import (
    SHORTEST_CELL,
    Grid,
    connected,
    make_grid,
    one_rest,
    steady,
    untouched,
)
from calib.mismatch.rows.lapped import lapped
from calib.mismatch.rows.nudged import still_parts
from calib.mismatch.rows.rows import Rows
from calib.mismatch.rows.uncarried import uncarried
from calib.mismatch.rows.underway import under_way
from calib.mismatch.samples.coarse import SHOWS, coarse_channels, unhidden_triads
from calib.mismatch.samples.losses import INCOMPLETE, leave_out_unwhole
from calib.mismatch.samples.reading import after_gaps, lost_samples
from calib.mismatch.samples.resting import look_at_rests, told_once, unsaid
from calib.mismatch.samples.thin import Thinned, thin
from calib.mismatch.search.aliased import FASTER, tells_nothing
from calib.mismatch.search.determined import open_baseline, to_determine
from calib.mismatch.search.estimate import Estimate
from calib.mismatch.search.explain import explain, verdict
from calib.mismatch.search.jolted import jolted
from calib.mismatch.search.proof import changes
from calib.mismatch.search.search import Outcome, search
from calib.mismatch.search.unclosed import close_badly_in_a_row, odd_turns
from calib.mismatch.timeless import CLOCKED, UNKNOWN_DRIFT, by_sample, is_rate, without_rates
from calib.mismatch.twin.residuals import is_aliased
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.poses import Poses
from calib.recording import CHANNELS, TRIADS, Recording
from calib.threads import one_thread
from calib.turns import find_holes, overlapping
from calib.types import BoolArray, FloatArray

SPOILT = 0.1
"""Share of a rest's samples that no model can explain above which its means are not looked at."""

MOST_RESTLESS = 0.5
"""Share of the recording in which one channel is disturbed above which nothing else is said."""

LEAST_TURNS = 3
"""Turns below which nothing that shows in motion alone is named."""


def diagnose_recording(
    recording: Recording,
    *,
    gravity: float,
    model: SensorModel | None = None,
) -> Diagnosis:
    """Find what a recording has that its twin lacks.

    Parameters
    ----------
    recording : Recording
    gravity : float, m/s²
    model : SensorModel, optional
        A calibration: the twin then has its misalignment and further terms too. Otherwise the
        twin has the paper's (Ranjbaran, Roudbari, Ebadollahi 2018). Either way the baseline is
        fitted to the recording.
    """
    return diagnose_thinned(thin(lambda: (recording,)), gravity=gravity, model=model)


@one_thread()
def diagnose_thinned(
    thinned: Thinned, *, gravity: float, model: SensorModel | None = None
) -> Diagnosis:
    """Do what `diagnose_recording` does, to a recording that `samples.thin` has read."""
    found = _diagnose(thinned, gravity=gravity, model=model)
    recording, delay = thinned.recording, coarse_delay(thinned.seen.findings)
    if delay is None or len(recording) < thinned.samples:
        return found
    prompt, undone = mostly_prompt(recording, delay)
    whole = with_all(_diagnose(thin(lambda: (prompt,)), gravity=gravity, model=model), undone)
    if whole is None:
        return found
    length = {name: found.summary[name] for name in ("duration", "samples")}
    return replace(whole, summary={**whole.summary, **length})


def _diagnose(thinned: Thinned, *, gravity: float, model: SensorModel | None) -> Diagnosis:
    recording, seen = thinned.recording, thinned.seen
    disturbed = seen.restless > MOST_RESTLESS * thinned.samples
    if not len(thinned.poses):
        return _unfit(thinned, (), seen.need if disturbed else NO_REST, "undetermined")
    missing = lacking(recording, thinned.poses)
    if seen.fatal:
        return _unfit(thinned, missing, seen.need, "explained")
    poses, bumps = parted(recording, uncarried(recording, thinned.poses))
    poses = still_parts(recording, poses)
    left_alone = untouched(recording, poses)
    said, noisy = told_once(seen.unexplained, look_at_rests(recording, left_alone))
    if disturbed:
        thinned = replace(thinned, seen=seen._replace(unexplained=said))
        return _unfit(thinned, missing, seen.need, "unexplained")
    poses = _usable(recording, poses, seen.spoilt)
    if not len(poses):
        return _unfit(thinned, missing, NO_REST, "undetermined")
    grid, spoilt, gone = _make_grid(thinned, poses)
    missing += gone
    timeless = recording.clock == "invalid"
    make = partial(_make_twin, grid, model, gravity=gravity, timeless=timeless)
    problem, few_turns, full = make(spoilt)
    if is_aliased(grid) and not timeless and tells_nothing(problem.rows()):
        missing += (FASTER.format(rate=1.0 / recording.interval),)
        spoilt = spoilt | ~grid.is_rest
        problem, few_turns, full = make(spoilt)
    coarse = coarse_channels(recording, grid.interval[grid.is_rest], seen.findings)
    unhidden = unhidden_triads(coarse, few_turns=few_turns)
    problem.rounded(coarse, restless="gyro" in unhidden)
    missing += tuple(
        f"finer counts of the {TRIADS[t]}: rounding them is no longer hidden by its noise, and "
        f"only {SHOWS[t]} tell of it"
        for t in unhidden
    )
    losses, broken = ([], []) if timeless or unhidden else leave_out_unwhole(problem)
    skip = _hopeless(full=full, timeless=timeless, few_turns=few_turns)
    outcome, fit, odd = _searched(problem, skip=skip, turns=not (timeless or unhidden))
    if outcome.undetermined:
        missing += (to_determine(outcome.undetermined),)
    able = len(poses) > 3
    directions = distinct_directions(poses.accel)
    left_open = open_baseline(problem.twin.names, fit)
    if directions < LEAST_DIRECTIONS:
        # On the faces of a cube the turns between them tell of the accelerometer's axes.
        able = len(poses) >= LEAST_DIRECTIONS and not left_open
        missing = with_turns(missing, directions, rests=len(poses), left_open=left_open)
    elif left_open:
        # Many poses that lie in one plane tell of no more than two axes.
        able &= not any(name.startswith("accel") for name in left_open)
        missing += (to_determine(left_open),)
    findings, unexplained, final, open_, (known, covariance) = _explained(problem, outcome, fit)
    if timeless:
        known, covariance = without_rates(known, covariance)
        final = replace(final, terms=tuple(t for t in final.terms if not is_rate(t.effect)))
        findings = [by_sample(f, thinned.samples) if is_rate(f.effect) else f for f in findings]
    lost = [lost_samples(recording, loss, grid.interval[loss.segment]) for loss in losses]
    findings = [*seen.findings, *lost, *findings]
    noisy = unsaid(noisy, findings, said, problem.given)
    noisy = (*noisy, *misclosed(outcome.rows, outcome.levels))
    # What such counts leave follows where between two of them a signal is, and so whatever it does.
    left = gathered(joined([*unexplained, *noisy]))
    left = [u for u in left if not any(c.split(".")[0] in unhidden for c in u.channels)]
    if broken:
        where = tuple((float(a), float(b)) for a, b in grid.interval[sorted(broken)])
        left.insert(0, Unexplained(CHANNELS, where, INCOMPLETE, FALSE_ALARM))
    unexplained = [*said, *odd, *left]
    if across_gravity(findings, poses):
        missing += (LEANING,)
    change, likelihood = changes(outcome)
    aliases = find_aliases(final, model or SensorModel(), known, covariance, gravity=gravity)
    return Diagnosis(
        verdict=verdict(tuple(findings), tuple(unexplained), able=able),
        findings=tuple(findings),
        unexplained=tuple(unexplained),
        missing=missing,
        hidden={**hidden_effects(outcome), **{a.effect: a.needs for a in aliases}},
        changes=change,
        log_likelihood=likelihood,
        model=claimed(final, problem.given, findings),
        names=known,
        covariance=covariance,
        summary=_summary(thinned, poses, bumps),
        aliases=aliases,
        undetermined=open_,
    )


def _usable(recording: Recording, poses: Poses, spoilt: BoolArray) -> Poses:
    """Return the poses that a twin is made of."""
    poses = _whole(connected(untouched(recording, steady(recording, poses))), spoilt)
    if not len(poses):
        return poses
    poses = poses.select(
        choose_poses(poses.accel, poses.start, poses.stop, interval=recording.interval)
    )
    if recording.clock == "invalid" and distinct_directions(poses.accel) == 1:
        # Without a clock no motion can be integrated, and here there was none.
        poses = one_rest(poses)
    return poses


def _make_grid(thinned: Thinned, poses: Poses) -> tuple[Grid, BoolArray, tuple[str, ...]]:
    """Return the cells, which segments are turns that do not count, and what that leaves open."""
    recording, spoilt = thinned.recording, thinned.seen.spoilt
    shortest = 0.0 if recording.clock == "invalid" else SHORTEST_CELL
    turns = under_way(recording, poses)
    grid = make_grid(recording, poses, turns=turns, shortest_cell=shortest, began=thinned.start)
    grid = lapped(grid, recording)
    bad = _spoilt_turns(grid, recording, spoilt)
    count, number = int(bad.sum()), int((~grid.is_rest).sum())
    if count > number / 2:
        lack = (
            f"turns with all of their samples: in {count} of {number} some are lost, clipped, "
            "stuck or come again, and what shows in these turns cannot be told"
        )
        return grid, bad, (lack,)
    torn = _spoilt_turns(grid, recording, after_gaps(recording))
    return grid, bad, ((without_time(grid.interval[torn], number),) if torn.any() else ())


def _make_twin(
    grid: Grid, model: SensorModel | None, spoilt: BoolArray, *, gravity: float, timeless: bool
) -> tuple[SelfProblem, bool, bool]:
    """Return the twin without spoilt turns, whether few are left, and if its gyroscope is full.

    What a calibration has, and what so few turns leave open, is fitted with the baseline.
    """
    few_turns = int((~grid.is_rest & ~spoilt).sum()) < LEAST_TURNS
    full = few_turns or (model is not None and bool(model.gyro.misalignment.any()))
    problem = SelfProblem(
        grid, model, gravity=gravity, full_gyro=full, spread=UNKNOWN_DRIFT if timeless else None
    )
    # And out of the twin: a rest that only a clipped turn joins to the others would lean with it.
    problem.leave_out(np.flatnonzero(spoilt).tolist())
    return problem, few_turns, full


def _searched(
    problem: SelfProblem, *, skip: tuple[str, ...], turns: bool
) -> tuple[Outcome, Estimate, list[Unexplained]]:
    """Return what a search finds, its fit, and the single turns that do not close beside it.

    These are left out, and it searches once more: as noise of all turns they hide what else there
    is. If not ``turns``, none is looked for, and no channel that is late for a while.
    """
    place, rows = problem.place(), problem.rows()
    if not turns or close_badly_in_a_row(rows):
        skip = (*skip, DELAY)
    outcome, fit = _found(problem, rows, skip=skip)
    odd = odd_turns(outcome) if turns else []
    if odd:
        problem.go_back(place)
        problem.jolted, problem.leaning = None, 1.0
        problem.leave_out([turn.segment for turn in odd])
        outcome, fit = _found(problem, problem.rows(), skip=skip)
        odd += odd_turns(outcome)
    said = dict.fromkeys(turn.said for turn in odd)
    return outcome, fit, sorted(said, key=lambda u: u.intervals)


def _found(problem: SelfProblem, rows: Rows, *, skip: tuple[str, ...]) -> tuple[Outcome, Estimate]:
    """Return what a search finds, and its fit, where the problem has these rows to begin with."""
    problem.jolted = jolted(rows, skip=skip)
    problem.leaning = lean_share(rows if problem.jolted is None else problem.rows())
    outcome = search(problem, skip=skip)
    return outcome, outcome.fit(reference=False)


def _hopeless(*, full: bool, timeless: bool, few_turns: bool) -> tuple[str, ...]:
    """Return the names that are not looked for, as the recording could not support them."""
    skip: tuple[str, ...] = ("gyro_misalignment",) if full else ()
    if timeless:
        skip += ("time", *(k for k in effects() if k.endswith(CLOCKED)))
    if few_turns:
        skip += tuple(k for k, e in effects().items() if _in_motion(e))
    return skip


def _explained(
    problem: SelfProblem, outcome: Outcome, fit: Estimate
) -> tuple[
    list[Finding],
    list[Unexplained],
    SensorModel,
    tuple[str, ...],
    tuple[tuple[str, ...], FloatArray],
]:
    """Return findings, what is unexplained, the model, what it leaves open, and its covariance."""
    names = problem.twin.names
    found = {a.candidate.name for a in outcome.accepted}
    shown = problem.shown(np.sqrt(np.diag(fit.covariance)))
    further = {name: k for name, k in shown.items() if name.split(".")[0] not in found}
    findings, unexplained, known = explain(outcome, fit, names=names, further=further)
    # Where shapes moved a little since the twin did, so did the baseline.
    still = np.zeros((problem.grid.n_poses, 2))
    model = problem.twin.moved(dict(zip(names, fit.step, strict=False)), still).model
    model = model.with_terms_moved({name: float(fit.step[k]) for name, k in further.items()})
    open_ = tuple(name for name in (*names, *further) if name not in known[0])
    return findings, unexplained, model, open_, known


def _in_motion(effect: Effect) -> bool:
    """Whether an effect shows in motion alone, as delays, filters and functions of the rate do."""
    if isinstance(effect, TransformEffect):
        return True
    if effect.shape:
        return False
    here, force = np.arange(8.0), np.outer(np.arange(1.0, 9.0), np.ones(3))
    still = effect.columns(State(here, force, 0.0 * force, temperature=here), {})
    return bool(still) and not any(v.any() for own in still.values() for v in own.values())


def _whole(poses: Poses, spoilt: BoolArray) -> Poses:
    """Return the poses without those whose means are spoilt: a channel was stuck in them."""
    count = np.concatenate(([0], np.cumsum(spoilt)))
    share = (count[poses.stop] - count[poses.start]) / (poses.stop - poses.start)
    whole = share <= SPOILT
    return poses.select(whole) if whole.any() else poses


def _spoilt_turns(grid: Grid, recording: Recording, spoilt: BoolArray) -> BoolArray:
    """Return the segments that are turns with a sample that no model can explain, or a hole."""
    count = np.concatenate(([0], np.cumsum(spoilt)))
    a = np.searchsorted(recording.time, grid.interval[:, 0])
    b = np.searchsorted(recording.time, grid.interval[:, 1], side="right")
    torn = overlapping(grid.interval, find_holes(recording))
    return ~grid.is_rest & ((count[b] > count[a]) | torn)


def _unfit(thinned: Thinned, missing: tuple[str, ...], need: str, otherwise: Verdict) -> Diagnosis:
    """Return the diagnosis of a recording of which no twin can be made, for what it needs first."""
    seen = thinned.seen
    return without_fit(
        verdict(seen.findings, seen.unexplained, able=False) if seen.unexplained else otherwise,
        (*missing, need),
        _summary(thinned, thinned.poses, ()),
        findings=seen.findings,
        unexplained=seen.unexplained,
    )


def _summary(thinned: Thinned, poses: Poses, bumps: Sequence[Interval]) -> dict[str, object]:
    # What a bump parts, or a slow turn, is one pose, and no turn.
    used = max(min(len(poses) - len(bumps), thinned.found), 0)
    return {
        **summarise(thinned.recording),
        "duration": thinned.duration,
        "samples": thinned.samples,
        "poses": thinned.found,
        "poses_used": used,
        "turns": max(used - 1, 0),
        **({"bumped": bumps} if bumps else {}),
    }
