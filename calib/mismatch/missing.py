"""What a recording lacks for a diagnosis by itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.effects import effects
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.rows.choice import distinct_directions
from calib.mismatch.search.search import Outcome
from calib.poses import Poses
from calib.recording import CHANNELS, Recording
from calib.types import FloatArray

NO_REST = (
    "a moment of rest: without gravity to compare with, only a simulation or a reference can tell "
    "what is wrong (--against, --reference)"
)

LEANING = (
    "another pose: in one, what the sensor lies on may lean where its accelerometer seems to drift"
)

FEW_MOMENTS = 5
"""Moments that are named one by one, at most."""

LEAST_DIRECTIONS = 9
"""Distinct directions of gravity below which the rests leave the accelerometer's nine parameters
open."""

POSES = "enough poses"
"""What is missing then."""


def lacking(recording: Recording, poses: Poses) -> tuple[str, ...]:
    """Return what a recording with such poses lacks."""
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


def with_turns(
    missing: tuple[str, ...], directions: int, *, rests: int, left_open: Sequence[str]
) -> tuple[str, ...]:
    """Return what is missing where there are few directions, but turns between them as well.

    ``left_open`` are the parameters of the baseline that both leave open. If there are none in
    enough rests, no poses are missing.
    """
    so = ""
    if rests < LEAST_DIRECTIONS:
        if directions >= 3:
            so = f"; or {LEAST_DIRECTIONS} rests, as turns between few poses tell of the axes too"
    elif left_open:
        so = f"; the turns between its {rests} rests leave {', '.join(left_open)} open"
    else:
        return tuple(item for item in missing if not item.startswith(POSES))
    return tuple(item + so if item.startswith(POSES) else item for item in missing)


def without_time(turns: FloatArray, number: int) -> str:
    """Return what is missing where so many turns (k, 2) have gaps in time: they are left out."""
    shown = ", ".join(f"{start:.1f}" for start, _ in turns[:FEW_MOMENTS].tolist())
    more = ", ..." if len(turns) > FEW_MOMENTS else ""
    return (
        f"turns with all of their samples: in {len(turns)} of {number} time is missing (those from "
        f"{shown}{more} s on), and these are left out"
    )


def across_gravity(findings: Sequence[Finding], poses: Poses) -> bool:
    """Whether in one pose an accelerometer was found to change across gravity."""
    if distinct_directions(poses.accel) != 1:
        return False
    along = CHANNELS[int(np.argmax(np.abs(poses.accel.mean(axis=0))))]
    channels = {c for f in findings if f.held_out is not None for c in f.channels}
    return any(c.startswith("accel") and c != along for c in channels)


def hidden_effects(outcome: Outcome) -> dict[str, str]:
    """Return the effects that these rows cannot show, with what they would need.

    What acts on the readout shows in samples.
    """
    return {
        slug: effect.needs
        for slug, effect in effects().items()
        if slug not in outcome.tried and effect.kind == "sensor" and not effect.is_readout
    }
