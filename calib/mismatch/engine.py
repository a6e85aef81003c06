"""Diagnose a recording against its own twin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.calibration import Quantity
from calib.effects import effects
from calib.effects.base import Effect, State, TransformEffect
from calib.faults import FALSE_ALARM
from calib.mismatch.findings.aliases import find_aliases
from calib.mismatch.findings.diagnosis import (
    Diagnosis,
    Finding,
    Unexplained,
    Verdict,
    claimed,
    summarise,
    without_fit,
)
from calib.mismatch.findings.misclosed import misclosed
from calib.mismatch.hypotheses.places import gathered, joined
from calib.mismatch.noise.rounded import Rounding, look_at_counts
from calib.mismatch.realigned import coarse_delay, mostly_prompt, with_all
from calib.mismatch.rows.choice import choose_poses, distinct_directions
from calib.mismatch.rows.grid import (
    SHORTEST_CELL,
    UNCLOCKED,
    Grid,
    connected,
    make_grid,
    one_rest,
    steady,
    untouched,
)
from calib.mismatch.rows.uncarried import uncarried
from calib.mismatch.rows.underway import under_way
from calib.mismatch.samples.losses import INCOMPLETE, leave_out_unwhole
from calib.mismatch.samples.reading import after_gaps, lost_samples
from calib.mismatch.samples.resting import look_at_rests, unsaid
from calib.mismatch.samples.thin import Thinned, thin
from calib.mismatch.search.determined import open_baseline, to_determine
from calib.mismatch.search.explain import explain, verdict
from calib.mismatch.search.jolted import jolted
from calib.mismatch.search.proof import changes
from calib.mismatch.search.search import Outcome, search
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.poses import Poses
from calib.recording import CHANNELS, TRIADS, Recording
from calib.threads import one_thread
from calib.turns import find_holes, overlapping
from calib.types import BoolArray, FloatArray

UNKNOWN_DRIFT = 4.0
"""Spread of the prior of drift where seconds are not known."""

_CLOCKED = ("_warm_up", "_bias_step", "_settling")

SPOILT = 0.1
"""Share of a rest's samples that no model can explain above which its means are not looked at."""

RESTLESS = (
    "a moment of rest: without gravity to compare with, only a simulation or a reference can tell "
    "what is wrong (--against, --reference)"
)

SHOWS = {"accel": "means of its rests", "gyro": "its turns"}
"""What shows a triad whose counts are coarse."""

FEW_MOMENTS = 5
"""Moments that are named one by one, at most."""

LEAST_TURNS = 3
"""Turns below which nothing that shows in motion alone is named."""

LEAST_DIRECTIONS, POSES = 9, "enough poses"
"""Distinct directions of gravity below which the rests leave the accelerometer's nine parameters
open, and what is missing then."""


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
    recording, poses, seen = thinned.recording, thinned.poses, thinned.seen
    if not len(poses):
        return _unfit(thinned, (), RESTLESS, "undetermined")
    missing = _missing(recording, poses)
    if seen.fatal:
        return _unfit(thinned, missing, seen.need, "explained")
    poses = uncarried(recording, poses)
    noisy = look_at_rests(recording, poses)
    poses = _whole(connected(untouched(recording, steady(recording, poses))), seen.spoilt)
    if not len(poses):
        return _unfit(thinned, missing, RESTLESS, "undetermined")
    poses = poses.select(
        choose_poses(poses.accel, poses.start, poses.stop, interval=recording.interval)
    )
    if recording.clock == "invalid" and distinct_directions(poses.accel) == 1:
        # Without a clock no motion can be integrated, and here there was none.
        poses = one_rest(poses)
    shortest = 0.0 if recording.clock == "invalid" else SHORTEST_CELL
    turns = under_way(recording, poses)
    grid = make_grid(recording, poses, turns=turns, shortest_cell=shortest, began=thinned.start)
    spoilt = _spoilt_turns(grid, recording, seen.spoilt)
    number, bad = int((~grid.is_rest).sum()), int(spoilt.sum())
    few_turns = number - bad < LEAST_TURNS
    if bad > number / 2:
        missing += (
            f"turns with all of their samples: in {bad} of {number} some are lost, clipped, stuck "
            "or come again, and what shows in these turns cannot be told",
        )
    elif (torn := _spoilt_turns(grid, recording, after_gaps(recording))).any():
        missing += (_without_time(grid.interval[torn], number),)
    # What a calibration has, and what so few turns leave open, is fitted with the baseline.
    full = few_turns or (model is not None and bool(model.gyro.misalignment.any()))
    timeless = recording.clock == "invalid"
    problem = SelfProblem(
        grid, model, gravity=gravity, full_gyro=full, spread=UNKNOWN_DRIFT if timeless else None
    )
    # And out of the twin: a rest that only a clipped turn joins to the others would lean with it.
    problem.leave_out(np.flatnonzero(spoilt).tolist())
    coarse = _coarse(recording, grid.interval[grid.is_rest], seen.findings)
    unhidden = _unhidden(coarse, few_turns=few_turns)
    problem.rounded(coarse, restless="gyro" in unhidden)
    missing += tuple(
        f"finer counts of the {TRIADS[t]}: rounding them is no longer hidden by its noise, and "
        f"only {SHOWS[t]} tell of it"
        for t in unhidden
    )
    losses, broken = ([], []) if timeless or unhidden else leave_out_unwhole(problem)
    skip: tuple[str, ...] = ("gyro_misalignment",) if full else ()
    if timeless:
        skip += ("time", *(k for k in effects() if k.endswith(_CLOCKED)))
    if few_turns:
        skip += tuple(k for k, e in effects().items() if _in_motion(e))
    problem.jolted = jolted(problem.rows(), skip=skip)
    outcome = search(problem, skip=skip)
    names = problem.twin.names
    directions = distinct_directions(poses.accel)
    if outcome.undetermined:
        missing += (to_determine(outcome.undetermined),)
    fit = outcome.fit(reference=False)
    able = len(poses) > 3
    if directions < LEAST_DIRECTIONS:
        # On the faces of a cube the turns between them tell of the accelerometer's axes.
        able = len(poses) >= LEAST_DIRECTIONS and not open_baseline(names, fit)
        if able:
            missing = tuple(item for item in missing if not item.startswith(POSES))
    found = {a.candidate.name for a in outcome.accepted}
    shown = problem.shown(np.sqrt(np.diag(fit.covariance)))
    further = {name: k for name, k in shown.items() if name.split(".")[0] not in found}
    findings, unexplained, (known, covariance) = explain(outcome, fit, names=names, further=further)
    open_ = tuple(name for name in (*names, *further) if name not in known)
    # Where shapes moved a little since the twin did, so did the baseline.
    still = np.zeros((grid.n_poses, 2))
    final = problem.twin.moved(dict(zip(names, fit.step, strict=False)), still).model
    final = final.with_terms_moved({name: float(fit.step[k]) for name, k in further.items()})
    if timeless:
        known, covariance = _without_rates(known, covariance)
        final = replace(final, terms=tuple(t for t in final.terms if not _is_rate(t.effect)))
        findings = [_by_sample(f, thinned.samples) if _is_rate(f.effect) else f for f in findings]
    lost = [lost_samples(recording, loss, grid.interval[loss.segment]) for loss in losses]
    findings = [*seen.findings, *lost, *findings]
    noisy = unsaid(noisy, findings, seen.unexplained, problem.given)
    if directions == 1 and _across_gravity(findings, poses):
        missing += (
            "another pose: in one, what the sensor lies on may lean where its accelerometer seems "
            "to drift",
        )
    noisy = (*noisy, *misclosed(outcome.rows, outcome.levels))
    unexplained = [*seen.unexplained, *gathered(joined([*unexplained, *noisy]))]
    if broken:
        where = tuple((float(a), float(b)) for a, b in grid.interval[sorted(broken)])
        unexplained.insert(0, Unexplained(CHANNELS, where, INCOMPLETE, FALSE_ALARM))
    # What such counts leave follows where between two of them a signal is, and so whatever it does.
    unexplained = [u for u in unexplained if u in seen.unexplained or not _on(u.channels, unhidden)]
    change, likelihood = changes(outcome)
    aliases = find_aliases(final, model or SensorModel(), known, covariance, gravity=gravity)
    return Diagnosis(
        verdict=verdict(
            tuple(findings),
            tuple(unexplained),
            able=able,
        ),
        findings=tuple(findings),
        unexplained=tuple(unexplained),
        missing=missing,
        hidden={**_hidden(outcome), **{a.effect: a.needs for a in aliases}},
        changes=change,
        log_likelihood=likelihood,
        model=claimed(final, problem.given, findings),
        names=known,
        covariance=covariance,
        summary=_summary(thinned, poses),
        aliases=aliases,
        undetermined=open_,
    )


def _coarse(
    recording: Recording, rests: FloatArray, findings: Sequence[Finding]
) -> dict[int, Rounding]:
    """Return the channels whose counts were found to be coarse, with what that does to rests.

    These are (r, 2) intervals.
    """
    out = {}
    start = np.searchsorted(recording.time, rests[:, 0])
    stop = np.searchsorted(recording.time, rests[:, 1], side="right")
    for f in findings:
        if f.effect == "quantization":
            (lsb,) = (q.value for name, q in f.parameters.items() if name.endswith("_lsb"))
            for channel in f.channels:
                values = recording.channel(channel)
                parts = [values[a:b] for a, b in zip(start, stop, strict=True)]
                out[CHANNELS.index(channel)] = look_at_counts(parts, lsb)
    return out


def _unhidden(coarse: Mapping[int, Rounding], *, few_turns: bool) -> tuple[str, ...]:
    """Return the triads whose means at rest tell where between two counts they are.

    Of a gyroscope that does not turn they are all there is, and if its bias moves by many counts
    they tell of that.
    """
    out = []
    for triad in TRIADS:
        own = [r for c, r in coarse.items() if CHANNELS[c].startswith(triad) and not r.hidden]
        if triad == "gyro" and few_turns:
            own = [r for r in own if not r.swept]
        if own:
            out.append(triad)
    return tuple(out)


def _across_gravity(findings: Sequence[Finding], poses: Poses) -> bool:
    """Whether an accelerometer was found to change on axes that gravity is not along."""
    along = CHANNELS[int(np.argmax(np.abs(poses.accel.mean(axis=0))))]
    channels = {c for f in findings if f.held_out is not None for c in f.channels}
    return any(c.startswith("accel") and c != along for c in channels)


def _in_motion(effect: Effect) -> bool:
    """Whether an effect shows in motion alone, as delays, filters and functions of the rate do."""
    if isinstance(effect, TransformEffect):
        return True
    if effect.shape:
        return False
    here, force = np.arange(8.0), np.outer(np.arange(1.0, 9.0), np.ones(3))
    still = effect.columns(State(here, force, 0.0 * force, temperature=here), {})
    return bool(still) and not any(v.any() for own in still.values() for v in own.values())


def _on(channels: Sequence[str], triads: tuple[str, ...]) -> bool:
    return any(c.split(".")[0] in triads for c in channels)


def _is_rate(slug: str) -> bool:
    return slug.endswith("_temperature_rate")


def _by_sample(item: Finding, samples: int) -> Finding:
    """Return a finding that follows a rate in K per sample: of this recording, not of the sensor.

    Nobody knows how long a sample took, so that the term fits no other stream.
    """
    interval = UNCLOCKED / (samples - 1)
    values = {
        name: Quantity(
            q.value / interval,
            None if q.sigma is None else q.sigma / interval,
            q.unit.replace("K/s", "K/sample"),
        )
        for name, q in item.parameters.items()
    }
    note = "Its size is per sample, as the clock is invalid, and fits this recording alone."
    return replace(item, kind="event", parameters=values, sentence=f"{item.sentence} {note}")


def _without_rates(
    names: tuple[str, ...], covariance: FloatArray
) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and covariance without rates."""
    keep = [i for i, n in enumerate(names) if not _is_rate(n.split(".")[0])]
    return tuple(names[i] for i in keep), covariance[np.ix_(keep, keep)]


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


def _without_time(turns: FloatArray, number: int) -> str:
    """Return what is missing where so many turns (k, 2) have gaps in time: they are left out."""
    shown = ", ".join(f"{start:.1f}" for start, _ in turns[:FEW_MOMENTS].tolist())
    more = ", ..." if len(turns) > FEW_MOMENTS else ""
    return (
        f"turns with all of their samples: in {len(turns)} of {number} time is missing (those from "
        f"{shown}{more} s on), and these are left out"
    )


def _unfit(thinned: Thinned, missing: tuple[str, ...], need: str, otherwise: Verdict) -> Diagnosis:
    """Return the diagnosis of a recording of which no twin can be made, for what it needs first."""
    seen = thinned.seen
    return without_fit(
        "unexplained" if seen.unexplained else otherwise,
        (*missing, need),
        _summary(thinned, thinned.poses),
        findings=seen.findings,
        unexplained=seen.unexplained,
    )


def _summary(thinned: Thinned, poses: Poses) -> dict[str, object]:
    return {
        **summarise(thinned.recording),
        "duration": thinned.duration,
        "samples": thinned.samples,
        "poses": thinned.found,
        "poses_used": len(poses),
        "turns": max(len(poses) - 1, 0),
    }


def _missing(recording: Recording, poses: Poses) -> tuple[str, ...]:
    out = []
    directions = distinct_directions(poses.accel)
    if directions < LEAST_DIRECTIONS:
        out.append(
            f"{POSES}: it has {directions} distinct one{'s' if directions != 1 else ''}, and "
            f"the accelerometer's scale and alignment need {LEAST_DIRECTIONS}"
        )
    if len(poses) < 4:
        turns = max(len(poses) - 1, 0)
        out.append(f"turns between rests: it has {turns}, and the gyroscope's scale needs several")
    if recording.clock == "invalid":
        out.append("a valid clock: only the order of samples is known, so times are not seconds")
    if recording.temperature is None:
        out.append("temperature: effects of temperature cannot be told from drift")
    elif np.ptp(recording.temperature) == 0:
        out.append("a temperature that changes: its reading is stuck at one value")
    elif directions == 1:
        out.append(
            "another pose at these temperatures: in one, a bias and a scale factor that follow "
            "temperature look alike"
        )
    return tuple(out)


def _hidden(outcome: Outcome) -> dict[str, str]:
    """Return the effects that these rows cannot show, with what they would need."""
    return {
        slug: effect.needs
        for slug, effect in effects().items()
        if slug not in outcome.tried and effect.kind == "sensor"
    }
