"""Diagnose a recording against a simulation or a reference that gives its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import sparse

from calib import faults
from calib.measured import measured
from calib.mismatch.engine import diagnose_recording
from calib.mismatch.findings.diagnosis import (
    Diagnosis,
    summarise,
    without_fit,
)
from calib.mismatch.noise.hush import audible
from calib.mismatch.reference.alignment import LEAST_OVERLAP, Alignment, align
from calib.mismatch.reference.alike import check_apart
from calib.mismatch.reference.axes import has_own_axes
from calib.mismatch.reference.band import STILL, follows_noise, matched, too_few
from calib.mismatch.reference.carried import simulated_errors
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.conclusion import conclude
from calib.mismatch.reference.corners import FEWEST
from calib.mismatch.reference.counted import rounded_at_rest
from calib.mismatch.reference.laid import laid
from calib.mismatch.reference.misread import misread
from calib.mismatch.reference.mounted import mounted_far
from calib.mismatch.reference.oriented import oriented
from calib.mismatch.reference.shaken import noise_beside
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.reference.twinned import UNSIGNED, diagnose_twin
from calib.mismatch.reference.witnessed import white_noise
from calib.mismatch.samples.found import Samples
from calib.mismatch.samples.reading import with_reading
from calib.mismatch.samples.samples import look_at_samples
from calib.mismatch.samples.units import axes_beside
from calib.model import SensorModel
from calib.recording import Recording
from calib.statics import find_poses
from calib.threads import one_thread
from calib.timing import clock_errors, evened
from calib.types import FloatArray

OWN_AXES = "own_axes"
"""Whether the accelerometer is turned against the frame of the other, and it alone."""

CORNERS = "corners"
"""How many samples are about corners that those of a simulation are too few to follow: they are
left out."""

_SELDOM_ALONE = ("earth_rate", "reference_tilt", "reference_smoothing")
"""What is in a simulation's own signals already; and what is wrong with a room, or with markers."""

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
        stuck=common.stuck or _rounded(real, common.real.time, truth, alignment, mat, seen),
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


def _rounded(
    real: Recording,
    time: FloatArray,
    truth: RecordingTruth,
    alignment: Alignment,
    mat: FloatArray,
    seen: Samples,
) -> tuple[sparse.csr_matrix, ...]:
    """Return `rounded_at_rest` at (n,) times, if counts were found to be coarse."""
    if not any(f.effect == "quantization" for f in seen.findings):
        return ()
    at = np.clip(alignment.times(time), *truth.span)
    return rounded_at_rest(real, time, truth.state(at).rate @ mat.T, seen.findings)


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
