"""Diagnose a recording against a simulation or a reference that gives its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from calib import faults
from calib.effects import effects, get_effect
from calib.measured import measured
from calib.mismatch.engine import diagnose_recording
from calib.mismatch.findings.diagnosis import (
    Diagnosis,
    Finding,
    Unexplained,
    claimed,
    summarise,
    without_fit,
)
from calib.mismatch.hypotheses.places import gathered, joined
from calib.mismatch.noise.hush import audible
from calib.mismatch.reference.alignment import LEAST_OVERLAP, Alignment, align
from calib.mismatch.reference.alike import check_apart
from calib.mismatch.reference.axes import has_own_axes
from calib.mismatch.reference.band import STILL, follows_noise, matched, too_few
from calib.mismatch.reference.carried import OF_GYRO, simulated_errors
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.corners import FEWEST
from calib.mismatch.reference.laid import laid
from calib.mismatch.reference.misread import misread
from calib.mismatch.reference.mounted import mounted_far
from calib.mismatch.reference.oriented import oriented
from calib.mismatch.reference.others import told_from_the_other
from calib.mismatch.reference.setupfindings import find_setups
from calib.mismatch.reference.shaken import noise_beside
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.reference.twinned import UNSIGNED, diagnose_twin
from calib.mismatch.reference.unturned import UNTURNED, with_any_angle
from calib.mismatch.reference.witnessed import white_noise
from calib.mismatch.samples.found import Samples
from calib.mismatch.samples.reading import with_reading
from calib.mismatch.samples.resting import told_once, unsaid
from calib.mismatch.samples.samples import look_at_samples
from calib.mismatch.samples.units import axes_beside
from calib.mismatch.samples.within import is_told, look_beside
from calib.mismatch.search.determined import open_baseline, to_determine
from calib.mismatch.search.explain import explain, verdict
from calib.mismatch.search.proof import changes
from calib.mismatch.search.search import Outcome, search
from calib.model import SensorModel
from calib.recording import AXES, Recording
from calib.rotation import rotvec_from_mat
from calib.statics import find_poses
from calib.threads import one_thread
from calib.timing import clock_errors, evened
from calib.types import FloatArray

NOWHERE = "positions in the reference"
"""What shows those."""

UNPLACED = ("accel_lever_arm", "accel_size_effect", "time_offset")
"""What shows only where it is known what an accelerometer feels while it moves: its place, that of
its axes, and its delay against the gyroscope."""

OWN_AXES = "own_axes"
"""Whether the accelerometer is turned against the frame of the simulation, and it alone."""

CORNERS = "corners"
"""How many samples are about corners that those of a simulation are too few to follow: they are
left out."""

_SELDOM_ALONE = ("earth_rate", "gravity_magnitude", "reference_tilt", "reference_smoothing")
"""What is in a simulation's own signals already, or is a scale that the baseline has; and what is
wrong with a room, or with markers."""

COMPARED, MOST_OF_IT = "compared", 0.8
"""How much of a recording was compared, where it is less than this share of it."""

BY_ITSELF = (
    "motion to compare: neither it nor the simulation turns, so it was judged by itself; rests "
    "tell of time and temperature"
)


@one_thread()
def diagnose_against(
    real: Recording,
    simulated: Recording,
    *,
    gravity: float,
    model: SensorModel | None = None,
) -> Diagnosis:
    """Find what a recording has that the user's own simulation of it lacks.

    Parameters
    ----------
    real, simulated : Recording
        The simulation's motion is the truth; its sensor may be perfect or have errors of the
        baseline's kinds. Rates and start times may differ. Of a twin the sensor is compared.
    gravity : float, m/s²
    model : SensorModel, optional
        Where the baseline starts; by default a perfect sensor.

    Raises
    ------
    NoCommonMotionError
        If the simulation is of another motion.
    """
    faults.check_sizes(real, "the recording")
    faults.check_sizes(simulated, "the simulation")
    check_apart(real, simulated)
    twin = diagnose_twin(real, simulated, gravity=gravity)
    if twin is not None:
        return twin
    read, given, stamps = measured(real), real, simulated.time
    real, simulated = read.recording, evened(simulated)
    clocks = np.hypot(clock_errors(read.stamps, real.time), clock_errors(stamps, simulated.time))
    heard = audible(real)
    poses = find_poses(heard)
    seen = with_reading(look_at_samples(real, poses), given, read)
    summary = summarise(real)
    if seen.fatal:
        return unfit(seen, summary)
    if still := at_rest(real, simulated):
        if max(_turns_by(real), _turns_by(simulated)) >= STILL:
            return undetermined(still, summary)
        found = diagnose_recording(given, gravity=gravity, model=model)
        return replace(found, missing=(*found.missing, BY_ITSELF))
    alignment = align(real.time, real.gyro, simulated.time, simulated.gyro)
    truth = RecordingTruth(simulated, gravity)
    if follows_noise(real, truth, alignment):
        return undetermined(UNSIGNED, summary)
    mat = mounted_far(real, truth, alignment)
    if mat is None and (numbers := laid(real, simulated, alignment)):
        return unfit(seen._replace(findings=(axes_beside(real, numbers), *seen.findings)), summary)
    wrong = misread(real, truth, alignment, other="simulation")
    if wrong is not None:
        return unfit(seen._replace(findings=(wrong, *seen.findings)), summary)
    problem, skip = compare_simulation(
        real, simulated, seen, alignment=alignment, gravity=gravity, model=model, mat_sr=mat
    )
    # When a simulation starts is nobody's fault; what its clock does to the motion is.
    few: tuple[str, ...] = ()
    way = np.eye(3) if mat is None else mat
    if problem.noisy and too_few(real, truth, alignment, way):
        few = (
            f"a simulation at a higher rate: at {1.0 / simulated.interval:.3g} Hz it has too few "
            "samples for its motion, of which only the slow part was compared",
        )
    elif problem.unknown is not None:
        summary[CORNERS] = int(problem.unknown.sum())
    if problem.own_axes:
        summary[OWN_AXES] = True
    return conclude(
        problem,
        seen,
        summary,
        setups=("clock_scale", *(() if mat is None else ("reference_misalignment",))),
        clocks=clocks,
        noisy=noise_beside(heard, poses, simulated, problem.setup.alignment),
        skip=skip,
        missing=few,
    )


def compare_simulation(
    real: Recording,
    simulated: Recording,
    seen: Samples,
    *,
    gravity: float,
    alignment: Alignment | None = None,
    model: SensorModel | None = None,
    mat_sr: FloatArray | None = None,
) -> tuple[ComparisonProblem, tuple[str, ...]]:
    """Align a simulation with a recording; return what to compare, and what cannot show.

    The sensor is mounted in its frame as ``mat_sr`` (3, 3) says, if at a large angle.
    """
    if alignment is None:
        alignment = align(real.time, real.gyro, simulated.time, simulated.gyro)
    truth = RecordingTruth(simulated, gravity)
    mat = np.eye(3) if mat_sr is None else mat_sr
    common = matched(real, truth, alignment, mat, spoilt=seen.spoilt)
    noisy = common.limited and not common.exact
    compare = partial(
        ComparisonProblem,
        common.real,
        common.truth if common.limited else oriented(common.truth),
        alignment,
        gravity=gravity,
        model=model,
        mat_sr=mat_sr,
        spoilt=common.spoilt,
        blur=common.blur,
        band=common.band,
        raw=real if common.limited else None,
        stuck=common.stuck,
        folded=common.folded,
        unknown=common.unknown,
        white=white_noise(real, simulated) if noisy else None,
    )
    problem = compare()
    # In a frame that is not known it is the gyroscope that is turned against the accelerometer.
    own_axes = mat_sr is None and has_own_axes(problem.rows())
    if own_axes:
        problem = compare(own_axes=True)
    if problem.arm().any():
        errors = simulated_errors(simulated, mat, gravity=gravity)
        if errors is not None:
            problem = compare(own_axes=own_axes, other=errors)
    return problem, ((*_SELDOM_ALONE, "bandwidth") if noisy else _SELDOM_ALONE)


def at_rest(*recordings: Recording) -> str:
    """Return what to say if one of the recordings is at rest all along, or short, else nothing."""
    for name, recording in zip(
        ("the recording", "what it is compared with"), recordings, strict=True
    ):
        moved = _turns_by(recording)
        if recording.duration < LEAST_OVERLAP or moved < STILL:
            return (
                f"motion to compare: {name} lasts {recording.duration:.3g} s and turns by "
                f"{np.degrees(moved):.2g} dps; turn it for {LEAST_OVERLAP:g} s or more"
            )
        if len(recording) < FEWEST:
            return (
                f"samples to compare: {name} has {len(recording)}, and fewer than {FEWEST} do not "
                "show how noisy they are; take more, or at a higher rate"
            )
    return ""


def _turns_by(recording: Recording) -> float:
    """Return how much the rate of turning varies, rad/s."""
    off = recording.gyro - np.median(recording.gyro, axis=0)
    return float(np.linalg.norm(off, axis=1).std())


def conclude(
    problem: ComparisonProblem,
    seen: Samples,
    summary: Mapping[str, object],
    *,
    setups: tuple[str, ...],
    clocks: FloatArray,
    noisy: tuple[Unexplained, ...],
    skip: tuple[str, ...],
    missing: tuple[str, ...],
    another: bool = False,
) -> Diagnosis:
    """Search, explain, and report alignments among ``setups`` as findings.

    ``clocks`` are the standard errors of the clocks' offset (s) and pace, (2,), ``another`` is
    whether the truth is another IMU, and ``noisy`` what the samples at rest show.
    """
    if problem.judged is not None:
        skip += UNPLACED
    turned = problem.turned or problem.own_axes
    skip += ("clock_scale", *(("reference_misalignment",) if turned else ()))
    skip += ("gyro_misalignment",) if problem.full_gyro else ()
    outcome = search(problem, skip=skip)
    outcome, model = _in_samples(outcome, problem.setup.model, problem.thin)
    fit = outcome.fit(reference=True)
    any_angle = False
    if problem.turned:
        p = len(problem.names)
        turns = slice(p + len(problem.alignments) - 3, p + len(problem.alignments))
        alone = partial(problem.told_by_noise, outcome.rows)
        fit, any_angle = with_any_angle(fit, turns, alone)
    findings, unexplained, (known, covariance) = explain(outcome, fit, names=problem.names)
    if any_angle:
        # What an arm is then nobody can tell, nor what it is worth.
        arm = get_effect("accel_lever_arm").follows
        unexplained = [u for u in unexplained if not u.follows.startswith(arm)]
    axes = 0.0
    if another:
        spread = problem.loose[-len(problem.setup.errors) :]
        findings, others = told_from_the_other(findings, problem.setup.errors, spread)
        missing += others
        # How another IMU is turned nobody knows better than its gyroscope's own axes.
        axes = float(np.sqrt(np.mean(np.square(spread[len(AXES) : OF_GYRO]))))
    found = find_setups(outcome, fit, problem, setups, clocks, axes=axes)
    begin = outcome.rows.interval[:, 0]
    findings = [f for f in findings if not any(_the_same(f, g, begin) for g in seen.findings)]
    findings = [*seen.findings, *found, *findings]
    noisy = (*noisy, *problem.slips())
    left = problem.left()
    if left is not None:
        noisy = (*noisy, *look_beside(*left, exact=not problem.noisy and not another))
    said, noisy = told_once(seen.unexplained, noisy)
    noisy = unsaid(noisy, findings, said, problem.given)
    noisy = tuple(item for item in noisy if not is_told(item, [*said, *unexplained]))
    unexplained = [*said, *gathered(joined([*unexplained, *noisy]))]
    slugs = {f.effect for f in findings}
    keep = [i for i, n in enumerate(known) if n in problem.names or n.split(".")[0] in slugs]
    known, covariance = tuple(known[i] for i in keep), covariance[np.ix_(keep, keep)]
    open_ = open_baseline(problem.names, fit)
    if problem.judged is not None:
        # What it lacks for one sensor is no lack for the other.
        poses = [n for n in open_ if n.startswith("accel.")]
        open_ = [n for n in open_ if n not in poses]
        missing += _unplaced(problem, poses)
    if open_:
        missing += (to_determine(open_),)
    if any_angle:
        missing += (UNTURNED,)
    change, likelihood = changes(outcome)
    alignment = problem.setup.alignment
    common, (first, last) = len(problem.time) * problem.interval, problem.time[[0, -1]].tolist()
    if common < MOST_OF_IT * cast(float, summary["duration"]):
        summary = {**summary, COMPARED: {"seconds": common, "from": first, "to": last}}
    return Diagnosis(
        verdict=verdict(tuple(findings), tuple(unexplained), able=not open_),
        findings=tuple(findings),
        unexplained=tuple(unexplained),
        missing=missing,
        hidden={
            slug: effect.needs
            for slug, effect in effects().items()
            if slug not in outcome.tried and effect.kind == "sensor" and slug not in skip
        }
        | (dict.fromkeys(UNPLACED, NOWHERE) if problem.judged is not None else {}),
        changes=change,
        log_likelihood=likelihood,
        model=claimed(model, problem.given, findings),
        names=known,
        covariance=covariance,
        undetermined=tuple(n for n in problem.names if n not in known),
        summary={
            **summary,
            "compared_samples": len(problem.time),
            "alignment": {
                "offset": alignment.offset,
                "stretch": alignment.stretch,
                "middle": alignment.middle,
                "rotation": rotvec_from_mat(problem.setup.mat_sr).tolist(),
                "correlation": alignment.correlation,
                "reference_gyro": problem.setup.errors[:OF_GYRO].tolist(),
                "reference_accel": problem.setup.errors[OF_GYRO:].tolist(),
            },
        },
    )


def _in_samples(outcome: Outcome, model: SensorModel, thin: int) -> tuple[Outcome, SensorModel]:
    """Return findings and model with numbers of samples as the recording counts them.

    They were counted in the samples that are compared, every `thin`-th.
    """
    counted = {
        slug: [p.name for p in effect.parameters if p.unit == "samples"]
        for slug, effect in effects().items()
    }
    accepted = tuple(
        replace(a, columns=a.columns / thin) if counted.get(a.candidate.name) else a
        for a in outcome.accepted
    )
    terms = tuple(
        replace(
            t,
            parameters={
                k: v * (thin if k in counted[t.effect] else 1) for k, v in t.parameters.items()
            },
        )
        for t in model.terms
    )
    return replace(outcome, accepted=accepted), replace(model, terms=terms)


def _the_same(finding: Finding, seen: Finding, begin: FloatArray) -> bool:
    """Whether the samples themselves show an event, at a moment that is exact there.

    By rows it is at the same one within its error; or, as in a rest nothing but its ends tells when
    it was, in the same rest or turn, or in the next one. They ``begin`` at these times, (s,).
    """
    if finding.effect != seen.effect or "moment" not in finding.parameters:
        return False
    own, exact = finding.parameters["moment"], seen.parameters["moment"]
    # What is anywhere in a rest is at most the square root of 12 of its standard errors off.
    if abs(own.value - exact.value) <= np.sqrt(12.0) * (own.sigma or 0.0):
        return True
    first, second = np.searchsorted(begin, [own.value, exact.value], side="right")
    return bool(abs(first - second) <= 1)


def _unplaced(problem: ComparisonProblem, poses: list[str]) -> tuple[str, ...]:
    """Return what is lacked where positions are, and rests for the parameters of `poses`."""
    assert problem.judged is not None
    rest, whole = (float(n) * problem.interval for n in (problem.judged.sum(), len(problem.time)))
    how = f"only at rest ({rest:.3g} s of {whole:.3g} s)" if rest else "not at all: nothing rests"
    positions = (
        f"{NOWHERE}: without them the accelerometer is judged {how}, and {', '.join(UNPLACED[:2])} "
        "and its delay cannot be told; if the body turned about a fixed point, as on a table, say "
        "so with --fixed-point"
    )
    if not (rest and poses):
        return (positions,)
    return positions, f"rests in poses that determine {', '.join(poses)}"


def undetermined(missing: str, summary: Mapping[str, object]) -> Diagnosis:
    """Return the diagnosis of what cannot be compared."""
    return without_fit("undetermined", (missing,), summary)


def unfit(seen: Samples, summary: Mapping[str, object]) -> Diagnosis:
    """Return the diagnosis of a recording whose units, axes or channels must be mended first."""
    return without_fit(
        "unexplained" if seen.unexplained else "explained",
        (seen.need,),
        summary,
        findings=seen.findings,
        unexplained=seen.unexplained,
    )
