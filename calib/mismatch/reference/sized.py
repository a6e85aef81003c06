"""Positions whose unit is a little off: beside them gravity seems to be another one.

What a body is moved by grows with the unit of its positions, and gravity does not: an accelerometer
with a scale factor of its own shows their ratio. So another gravity, and positions that are too
large or too small (a wand that was not measured, a wrong focal length), are the same beside
markers. But gravity is within half a percent of its mean all over the Earth.
"""

from __future__ import annotations

from dataclasses import replace

from calib.mismatch.findings.diagnosis import Diagnosis, Finding, Rival

GRAVITY = "gravity_magnitude"

SCALE = "the scale of the reference's positions"

LEAST, MOST = 9.764, 9.834
"""m/s²: on the highest mountains of the tropics, and at sea level in the Arctic."""

SURELY = 3.0
"""Standard errors by which gravity is beyond these."""

BEYOND = 100.0
"""Odds of the scale where gravity would be one that no place on Earth has."""

MEASURE = "measure a length with the markers that is known: a rod, or the wand"


def with_scale(found: Diagnosis, *, gravity: float) -> Diagnosis:
    """Return a diagnosis beside positions with their scale as the rival of another gravity."""
    findings: list[Finding] = []
    missing = found.missing
    for item in found.findings:
        if item.effect == GRAVITY:
            error = item.parameters["error"]
            there, room = gravity + error.value, SURELY * (error.sigma or 0.0)
            nowhere = not LEAST - room <= there <= MOST + room
            rival = Rival(SCALE, BEYOND if nowhere else 1.0)
            to_separate = f"{item.to_separate} {SCALE}: {MEASURE}.".strip()
            item = replace(item, rivals=(rival, *item.rivals), to_separate=to_separate)
            if nowhere:
                missing += (
                    f"positions in metres: no place on Earth has a gravity of {there:.3f} m/s², "
                    f"and positions that are {there / gravity:.4g} times as large as they should "
                    f"be do the same; {MEASURE}",
                )
        findings.append(item)
    return replace(found, findings=tuple(findings), missing=missing)
