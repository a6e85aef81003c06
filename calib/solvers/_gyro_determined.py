"""Which parameters of a gyroscope a recording determines, and what to record for the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.closure import TurnSteps, propagate
from calib.directions import Directions
from calib.model import Triad
from calib.recording import AXES
from calib.turns import Turns
from calib.types import BoolArray, FloatArray

GYRO_NAMES = tuple(Triad().parameters("gyro"))
"""The twelve names: three biases, three scale factor errors, six misalignments."""

GYRO_UNITS = ("rad/s",) * 3 + ("1",) * 3 + ("rad",) * 6

TOLERANCE = np.array([np.radians(20.0)] * 3 + [0.03] * 3 + [0.02] * 6)
"""What a consumer part promises without calibration: bias 20 deg/s, scale factor 3 %, cross-axis
sensitivity 2 % (MPU-6050 product specification, rev. 3.4, section 6.1). A parameter that the data
leaves less certain than this is not determined by the data."""


@dataclass(frozen=True, eq=False)
class Determined:
    """What an information matrix determines.

    Parameters
    ----------
    free : (p,) array of bool
        Parameters to solve for; the others stay at their prior value.
    known : (p,) array of bool
        Parameters whose standard error, with all others free, is within tolerance.
    condition_number : float
        Of the design with unit columns, over the free parameters.
    """

    free: BoolArray
    known: BoolArray
    condition_number: float


def determined(information: FloatArray, tolerance: FloatArray) -> Determined:
    """Judge an information matrix (p, p) against the tolerance (p,) of each parameter."""
    scaled = information * np.outer(tolerance, tolerance)
    free = np.ones(len(tolerance), bool)
    values, vectors = np.linalg.eigh(scaled)
    # A floor far below 1 only keeps directions without any information finite.
    variance = (vectors**2 / np.maximum(values, 1e-9)).sum(axis=1)
    known = variance <= 1.0
    while free.any():
        values, vectors = np.linalg.eigh(scaled[np.ix_(free, free)])
        if values[0] > 1.0:
            break
        free[np.flatnonzero(free)[np.argmax(np.abs(vectors[:, 0]))]] = False
    known &= free
    return Determined(free, known, condition_number(information[np.ix_(free, free)]))


def condition_number(information: FloatArray) -> float:
    """Condition number of the design behind an information matrix, its columns scaled to one."""
    diagonal = np.sqrt(np.diag(information))
    if not len(diagonal) or not (diagonal > 0).all():
        return float("inf")
    values = np.linalg.eigvalsh(information / np.outer(diagonal, diagonal))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")


def visible_turning(
    steps: TurnSteps, directions: Directions, turns: Turns, gyro: Triad
) -> tuple[FloatArray, FloatArray]:
    """Return how far each axis turned, (3,) rad, and the part of it that gravity could see.

    The part is each step weighted by the sine of the angle between the axis and the vertical.
    """
    if not len(turns):
        return np.zeros(3), np.zeros(3)
    motion = propagate(steps, gyro.matrix, gyro.bias)
    before = np.repeat(directions.up[turns.before], np.diff(steps.first), axis=0)
    up = np.einsum("nji,nj->ni", motion.middle, before)
    angle = np.abs(gyro.correct(steps.angle / steps.step[:, None])) * steps.step[:, None]
    return angle.sum(axis=0), (angle * np.sqrt(np.clip(1 - up**2, 0, 1))).sum(axis=0)


def gyro_advice(
    undetermined: tuple[str, ...], turned: FloatArray, horizontal: FloatArray
) -> tuple[str, ...]:
    """Say for each axis why it is not determined and what to record.

    Parameters
    ----------
    undetermined : tuple of str
    turned : (3,) array, rad
        How far each axis turned in all, forth and back added up.
    horizontal : (3,) array, rad
        The part of it that gravity could see: each step weighted by the sine of the angle
        between the axis and the vertical.
    """
    advice = []
    for j, axis in enumerate(AXES):
        scale = f"gyro.scale_factor_error.{axis}"
        cross = [n for n in undetermined if n.startswith("gyro.mis") and n.endswith(axis)]
        if scale not in undetermined and not cross:
            continue
        if turned[j] > np.radians(45) and horizontal[j] < 0.3 * turned[j]:
            why = (
                f"axis {axis} was vertical while it turned, and gravity does not see that; remount "
                f"the sensor with {axis} horizontal and turn it about {axis}"
            )
        elif turned[j] < np.radians(45):
            why = f"axis {axis} hardly turned; turn the sensor about {axis} while it is horizontal"
        else:
            why = (
                f"the turns about axis {axis} do not separate it from the others; turn the sensor "
                f"about {axis} alone, while it is horizontal, from two or more starting poses"
            )
        advice.append(f"{why}, by 90 degrees or more, both ways, at rest before and after")
    if any(name.startswith("gyro.bias") for name in undetermined):
        advice.append("keep the sensor at rest for at least 5 s, so that the bias can be read")
    return tuple(advice)
