"""A gyroscope that is a tenth of a second late or more, put beside its accelerometer first.

A driver that reads one sensor through a queue holds it back so long. Rests that are found in both
at once then end in turns that one of them has not seen yet. So most of the delay, which
`calib.synchrony` knows to a hundredth of a second or two, is taken out of the samples; what is left
the rows find, and size.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from calib.calibration import Quantity
from calib.effects.base import Term
from calib.effects.resampling import resample
from calib.mismatch.findings.diagnosis import Diagnosis, Finding
from calib.recording import Recording

DELAY, SIZE = "time_offset", "gyro_delay"

HELD = 0.5
"""s that a queue may hold a sensor back. What is later is of another clock."""

LEFT = 0.06
"""s that are left in: more than `calib.synchrony` errs by, so that they are found whatever it is,
and more than any low-pass that is as good as a delay."""


def coarse_delay(findings: Iterable[Finding]) -> float | None:
    """Return the delay among what the samples showed, s, if a queue may be its cause."""
    for f in findings:
        if f.effect == DELAY and abs(f.parameters[SIZE].value) <= HELD:
            return f.parameters[SIZE].value
    return None


def mostly_prompt(recording: Recording, delay: float) -> tuple[Recording, float]:
    """Return a recording with all but `LEFT` of a delay of its gyroscope undone, and how much.

    By whole samples, so that even ones stay what they are. The end that one of them lacks is gone.
    """
    interval = recording.interval
    undone = float(np.sign(delay) * round((abs(delay) - LEFT) / interval) * interval)
    at = recording.time + undone
    gyro = resample(recording.time, recording.gyro, at)
    first = int(np.searchsorted(at, recording.time[0] - 0.5 * interval))
    last = int(np.searchsorted(at, recording.time[-1] + 0.5 * interval))
    return replace(recording.slice(first, last), gyro=gyro[first:last]), undone


def with_all(found: Diagnosis, undone: float) -> Diagnosis | None:
    """Return a diagnosis with what was undone in its delay; None if it has none."""
    if not any(SIZE in f.parameters for f in found.findings if f.effect == DELAY):
        return None
    findings = []
    for f in found.findings:
        if f.effect == DELAY and SIZE in f.parameters:
            q = f.parameters[SIZE]
            whole = Quantity(q.value + undone, q.sigma, q.unit)
            f = replace(f, parameters={**f.parameters, SIZE: whole})
        findings.append(f)
    terms = tuple(
        Term(t.effect, {**t.parameters, SIZE: t.parameters.get(SIZE, 0.0) + undone})
        if t.effect == DELAY
        else t
        for t in found.model.terms
    )
    model = replace(found.model, terms=terms)
    return replace(found, findings=tuple(findings), model=model)
