"""What may be the other IMU's: of two gyroscopes nobody can tell whose axes are not square.

Mounted at an angle, the other one's scale factors alone look like misalignment of the sensor. How
far its errors may be off is known (`carried.known_errors`); what lies within that is no finding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtrc

from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.reference.carried import OF_GYRO
from calib.recording import AXES
from calib.types import FloatArray

BY_CHANCE = 0.01
"""Probability that the other one's errors alone are as large, above which they may be it."""

EFFECT = "gyro_misalignment"

CLEAR = 3.0
"""Standard errors from which on an angle that is given is another one now."""


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
    return kept, (_needed(max(abs(q.value) for f in gone for q in f.parameters.values())),)


def _needed(angle: float) -> str:
    return (
        "a gyroscope in the reference that is known better: the axes of the two differ by "
        f"{np.degrees(angle):.2g}°, which its own errors may be; correct it first (imu-cal apply), "
        "or compare with a third one"
    )


def axes_since(
    moved: Mapping[str, float], names: Sequence[str], covariance: FloatArray, spread: FloatArray
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return a covariance in which angles that are given are no better known than the other's.

    And what is missing to tell whose they are, if any ``moved`` since, by name (rad), by more than
    its own standard error but by no more than that.
    """
    loose = spread[3:OF_GYRO].reshape(3, 3)
    variance, seen = np.zeros(len(names)), [0.0]
    for name, shift in moved.items():
        effect, parameter = name.split(".")
        if effect == EFFECT and name in names:
            i, j = (AXES.index(letter) for letter in parameter[1:])
            k = names.index(name)
            variance[k] = loose[i, j] ** 2
            sigma = float(np.sqrt(covariance[k, k]))
            if CLEAR * sigma < abs(shift) < CLEAR * np.hypot(loose[i, j], sigma):
                seen.append(abs(shift))
    most = max(seen)
    return covariance + np.diag(variance), (_needed(most),) if most else ()


def _may_be(finding: Finding, errors: FloatArray, spread: FloatArray) -> bool:
    if finding.effect != EFFECT:
        return False
    matrix, loose = (x[3:OF_GYRO].reshape(3, 3) for x in (errors, spread))
    total = 0.0
    for name, q in finding.parameters.items():
        i, j = (AXES.index(letter) for letter in name[1:])
        total += (q.value + matrix[i, j]) ** 2 / (loose[i, j] ** 2 + (q.sigma or 0.0) ** 2)
    return bool(chdtrc(len(finding.parameters), total) > BY_CHANCE)
