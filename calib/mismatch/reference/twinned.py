"""A recording against its own digital twin.

A twin's motion was estimated from the recording: what the sensor gets wrong is in it, and it is no
truth beside that recording. What a twin tells of is its sensor, which it therefore carries.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.effects.text import parse_term
from calib.errors import RecordingFormatError
from calib.mismatch.engine import diagnose_recording
from calib.mismatch.findings.diagnosis import Diagnosis
from calib.model import SensorModel, Triad
from calib.recording import TRIADS, Recording

NOTE, TEMPERATURE = "twin_sensor", "reference_temperature"
"""Where a twin says which sensor it is of: ``parameter=value`` and ``slug:parameter=value,...``."""

SIGNED = (
    "a simulation with a motion of its own: this is the recording's twin (simulate --like), whose "
    "motion was estimated from it; so it was compared with the sensor of the twin, as by "
    "--calibration"
)
UNSIGNED = (
    "a simulation with a motion of its own: this one moves with the recording's noise, so its "
    "motion was estimated from it (simulate --like), and what the sensor gets wrong is in both. "
    "Leave out --against and give --calibration with the twin's sensor: that compares the "
    "recording with its twin"
)


def with_sensor(twin: Recording, model: SensorModel) -> Recording:
    """Return a twin that says which sensor it is of."""
    values = model.accel.parameters("accel") | model.gyro.parameters("gyro")
    said = [f"{name}={value!r}" for name, value in values.items() if value]
    said.append(f"{TEMPERATURE}={model.reference_temperature!r}")
    for term in model.terms:
        values = {name: float(value) for name, value in term.parameters.items()}
        said.append(f"{term.effect}:" + ",".join(f"{k}={v!r}" for k, v in values.items()))
    return replace(twin, notes={**twin.notes, NOTE: " ".join(said)})


def twin_sensor(real: Recording, simulated: Recording) -> SensorModel | None:
    """Return the sensor of a simulation that is the recording's twin; None of any other.

    A twin has the recording's times.

    Raises
    ------
    RecordingFormatError
        If what it says of its sensor is damaged.
    """
    said = simulated.notes.get(NOTE, "").split()
    if not said or len(real) != len(simulated):
        return None
    if np.abs(real.time - simulated.time).max() > 0.5 * real.interval:
        return None
    span = float(real.time[0]), float(real.time[-1])
    try:
        terms = tuple(parse_term(text, span=span) for text in said if ":" in text)
        pairs = (text.split("=") for text in said if ":" not in text)
        values = {name: float(value) for name, value in pairs}
        temperature = values.pop(TEMPERATURE)
        accel, gyro = (
            Triad().with_parameters({k: v for k, v in values.items() if k.startswith(triad)})
            for triad in TRIADS
        )
        return SensorModel(accel, gyro, terms, temperature)
    except (KeyError, ValueError) as error:
        raise RecordingFormatError(
            f"the simulation's note {NOTE!r}, which says of what sensor it is, is damaged: {error}"
        ) from error


def diagnose_twin(real: Recording, simulated: Recording, *, gravity: float) -> Diagnosis | None:
    """Find what a recording has that the sensor of its twin lacks; None if it is no twin."""
    sensor = twin_sensor(real, simulated)
    if sensor is None:
        return None
    found = diagnose_recording(real, gravity=gravity, model=sensor)
    return replace(found, missing=(*found.missing, SIGNED))
