"""The motion of a reference, as a sensor that recorded beside it would have felt it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.effects.base import Term
from calib.errors import UnitError
from calib.measured import measured
from calib.mismatch.reference.referencemode import ReferenceMotion, compared
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import quat_from_mat, quat_multiply
from calib.simulation.kinematics import Motion
from calib.simulation.recorded import temperature_of
from calib.simulation.referenced import motion_from_reference
from calib.statics import find_poses

ALIGNED = {"time_offset": "delay", "clock_scale": "scale", "reference_misalignment": "r"}
"""Effects by which a recording lies beside a reference, and how their parameters begin."""


class Beside(NamedTuple):
    """What of a recording a reference saw, and its motion, whose time 0 is the part's first sample.

    Above ``bandwidth`` (Hz, None if the reference has no noise) the motion is left out; ``notes``
    say what else is.
    """

    part: Recording
    motion: Motion
    bandwidth: float | None
    notes: Mapping[str, object]


def motion_beside(
    real: Recording,
    reference: ReferenceMotion,
    *,
    gravity: float,
    model: SensorModel | None = None,
    bandwidth: float | None = None,
) -> Beside:
    """Return the motion that a reference saw, in the time and the frame of a recording.

    Both are those from which a diagnosis of the recording beside the reference starts, under the
    further terms of `model` if it is given; the point is the reference's own. Without ``bandwidth``
    (Hz) it is that in which both agree.

    Raises
    ------
    RecordingError
        If the two do not show the same motion, or the recording has faults that hide it.
    """
    real = measured(real).recording
    seen = look_at_samples(real, find_poses(real))
    if seen.fatal:
        said = [f.sentence for f in seen.findings] or [u.follows for u in seen.unexplained]
        raise UnitError("the recording cannot be placed beside the reference: " + "; ".join(said))
    problem, _, used = compared(
        real, reference.evened().regular(), seen, gravity=gravity, model=model
    )
    assert isinstance(used, ReferenceMotion)
    time = problem.setup.alignment.moments(used.time)
    part = real.slice(*np.searchsorted(real.time, time[used.known][[0, -1]]).tolist())
    bandwidth = bandwidth or problem.bands[0] or None
    motion = motion_from_reference(
        time,
        quat_multiply(used.quat, quat_from_mat(problem.setup.mat_sr.T)),
        used.position,
        gravity=gravity,
        bandwidth=bandwidth,
        start=float(part.time[0]),
    )
    motion = replace(motion, temperature=temperature_of(part))
    return Beside(part, motion, bandwidth, problem.notes)


def without_alignment(terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Return the terms of a sensor without time and frame of a reference.

    A motion that is in the recording's own time and frame has them already.
    """
    out = []
    for term in terms:
        begin = ALIGNED.get(term.effect)
        kept = {
            name: value
            for name, value in term.parameters.items()
            if begin is None or not name.startswith(begin)
        }
        if kept:
            out.append(replace(term, parameters=kept))
    return tuple(out)
