"""What may be the other IMU's: of two gyroscopes nobody can tell whose axes are not square.

Mounted at an angle, the other one's scale factors alone look like misalignment of the sensor. How
far its errors may be off is known (`carried.known_errors`); what lies within that is no finding.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.reference.carried import OF_GYRO
from calib.recording import AXES
from calib.types import FloatArray

BY_CHANCE = 0.01
"""Probability that the other one's errors alone are as large, above which they may be it."""

EFFECT = "gyro_misalignment"


def told_from_the_other(
    findings: Sequence[Finding], errors: FloatArray, spread: FloatArray
) -> tuple[list[Finding], tuple[str, ...]]:
    """Return the findings that are not the other IMU's, and what is missing to tell the rest.

    Parameters
    ----------
    findings : sequence of Finding
    errors, spread : (18,) arrays
        Of the other IMU in the sensor's frame, and how far they may be off. What its gyroscope has
        in excess, ``E w``, the sensor seems to lack.
    """
    kept = [f for f in findings if not _may_be(f, errors, spread)]
    gone = [f for f in findings if f not in kept]
    if not gone:
        return kept, ()
    angle = np.degrees(max(abs(q.value) for f in gone for q in f.parameters.values()))
    return kept, (
        f"a gyroscope in the reference that is known better: the axes of the two differ by "
        f"{angle:.2g}°, which its own errors may be; correct it first (imu-cal apply), or compare "
        "with a third one",
    )


def _may_be(finding: Finding, errors: FloatArray, spread: FloatArray) -> bool:
    if finding.effect != EFFECT:
        return False
    matrix, loose = (x[3:OF_GYRO].reshape(3, 3) for x in (errors, spread))
    total = 0.0
    for name, q in finding.parameters.items():
        i, j = (AXES.index(letter) for letter in name[1:])
        total += (q.value + matrix[i, j]) ** 2 / (loose[i, j] ** 2 + (q.sigma or 0.0) ** 2)
    return bool(chdtrc(len(finding.parameters), total) > BY_CHANCE)
