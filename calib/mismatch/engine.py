"""Diagnose a recording against its own twin."""

from __future__ import annotations

import numpy as np

from calib.effects import effects
from calib.errors import InsufficientMotionError
from calib.mismatch.diagnosis import Diagnosis
from calib.mismatch.explain import changes, explain, verdict
from calib.mismatch.grid import connected, make_grid, steady
from calib.mismatch.search import Outcome, search
from calib.mismatch.selfmode import SelfProblem
from calib.model import SensorModel
from calib.poses import Poses
from calib.recording import Recording
from calib.statics import find_poses
from calib.types import FloatArray

LEAST_DIRECTIONS = 9
"""Distinct directions of gravity below which the accelerometer's nine parameters are open."""


def diagnose_recording(
    recording: Recording,
    *,
    gravity: float,
    model: SensorModel | None = None,
    poses: Poses | None = None,
) -> Diagnosis:
    """Find what a recording has that its twin lacks.

    Parameters
    ----------
    recording : Recording
    gravity : float, m/s²
    model : SensorModel, optional
        A calibration: the twin then has its misalignment and further terms too. Otherwise the
        twin has the paper's model. Either way the baseline is fitted to the recording.
    poses : Poses, optional
        Where they are already known.

    Raises
    ------
    InsufficientMotionError
        If the recording holds no rest.
    """
    poses = find_poses(recording) if poses is None else poses
    if not len(poses):
        raise InsufficientMotionError(
            "the recording has no moment of rest: without gravity to compare with, only a "
            "simulation or a reference can tell what is wrong (--against, --reference)"
        )
    poses = connected(steady(poses))
    grid = make_grid(recording, poses)
    full = model is not None and bool(model.gyro.misalignment.any())
    problem = SelfProblem(grid, model, gravity=gravity, full_gyro=full)
    before = problem.rows()
    skip = ("gyro_misalignment",) if full else ()
    outcome = search(problem, skip=skip)
    names = problem.twin.names
    findings, unexplained, (known, covariance) = explain(
        outcome, problem.twin.model, reference=False, names=names
    )
    missing = _missing(recording, poses, grid_turns=int((~grid.is_rest).sum()))
    change, likelihood = changes(outcome, before)
    return Diagnosis(
        verdict=verdict(tuple(findings), tuple(unexplained), able=not missing),
        findings=tuple(findings),
        unexplained=tuple(unexplained),
        missing=missing,
        hidden=_hidden(outcome),
        changes=change,
        log_likelihood=likelihood,
        model=problem.twin.model,
        names=known,
        covariance=covariance,
        summary={
            "duration": recording.duration,
            "samples": len(recording),
            "rate": 1.0 / recording.interval if recording.interval else 0.0,
            "clock": recording.clock,
            "poses": len(poses),
            "turns": int((~grid.is_rest).sum()),
        },
    )


def distinct_directions(accel: FloatArray, *, angle: float = 0.26) -> int:
    """Return how many directions of gravity differ by more than `angle` (rad) from each other."""
    up = accel / np.linalg.norm(accel, axis=1, keepdims=True)
    kept: list[FloatArray] = []
    for vec in up:
        if all(float(vec @ k) < np.cos(angle) for k in kept):
            kept.append(vec)
    return len(kept)


def _missing(recording: Recording, poses: Poses, *, grid_turns: int) -> tuple[str, ...]:
    out = []
    directions = distinct_directions(poses.accel)
    if directions < LEAST_DIRECTIONS:
        out.append(
            f"{directions} distinct pose{'s' if directions != 1 else ''}: the accelerometer's "
            f"scale and alignment need at least {LEAST_DIRECTIONS}"
        )
    if grid_turns < 3:
        out.append(f"{grid_turns} turns between rests: the gyroscope's scale needs several")
    if recording.clock == "invalid":
        out.append("a valid clock: only the order of samples is known, so nothing follows time")
    if recording.temperature is None:
        out.append("temperature: effects of temperature cannot be told from drift")
    elif np.ptp(recording.temperature) == 0:
        out.append("a temperature that changes: its reading is stuck at one value")
    return tuple(out)


def _hidden(outcome: Outcome) -> dict[str, str]:
    """Return the effects that these rows cannot show, with what they would need."""
    shown = {c.name for c in outcome.candidates if c.physical}
    return {
        slug: effect.needs
        for slug, effect in effects().items()
        if slug not in shown and effect.kind == "sensor"
    }
