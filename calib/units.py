"""Are the values in the unit that they claim? Physics decides, not statistics of the values.

- The specific force at rest is gravity: |a| near 9.8 m/s².
- What a turn does to gravity's direction must agree with the integral of the rate, ``u_before =
  R(w / factor) u_after``. Of the factors that go with a confusion of units, the one with which it
  does is found.

Sensors as they come from the factory are within 10-15 % of their scale and a few hundred mm/s²,
degrees per second, of zero; the tests leave room for three times that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.closure import TurnSteps, closure_residual
from calib.errors import UnitError
from calib.poses import Poses
from calib.recording import Recording
from calib.rotation import cumulative_quat_segments, mat_from_quat, quat_from_rotvec
from calib.statics import find_poses
from calib.turns import find_turns
from calib.types import FloatArray

G = 9.80665
DEGREE = np.pi / 180

ACCEL_FACTORS = {
    1 / G: "the accelerometer is in g",
    1000 / G: "the accelerometer is in mg",
    **{
        scale: f"the accelerometer's full scale is {_times} what was assumed"
        for scale, _times in (
            (0.25, "4 times"),
            (0.5, "twice"),
            (2.0, "half"),
            (4.0, "a quarter of"),
        )
    },
    **{
        2.0**power / G: f"the accelerometer is in counts of {2**power} LSB/g"
        for power in range(11, 16)
    },
}
"""Measured over true, m/s² being declared, and what such a factor means."""

GYRO_FACTORS = {
    1 / DEGREE: "the gyroscope is in deg/s",
    1000 / DEGREE: "the gyroscope is in mdeg/s",
    DEGREE: "the gyroscope was in rad/s already and was converted from deg/s again",
    **{
        scale: f"the gyroscope's full scale is {_times} what was assumed"
        for scale, _times in (
            (0.125, "8 times"),
            (0.25, "4 times"),
            (0.5, "twice"),
            (2.0, "half"),
            (4.0, "a quarter of"),
            (8.0, "an eighth of"),
        )
    },
    **{
        counts / DEGREE: f"the gyroscope is in counts of {counts} LSB/(deg/s)"
        for counts in (16.4, 32.8, 65.5, 131.0)
    },
}
"""Measured over true, rad/s being declared, and what such a factor means."""

AT_REST = (0.7, 1.4)
"""Times g; |a| at rest outside of this is not a sensor's error."""
IN_MOTION = (0.25, 6.0)
"""Times g; the median of |a| of a recording that only moves."""
NEAR = 0.35
"""How near, in log of the factor, a known confusion must be to be named."""
REMOVED = 0.03
"""Times g; |a| at rest below this means that gravity was taken out."""
MOVED = 20 * DEGREE
"""By how much a turn must tilt the sensor to tell anything of the gyroscope's unit."""
AGREE = 20 * DEGREE
"""Closure that an uncalibrated sensor reaches: 10 % of a half turn."""
FASTEST = 150.0
"""rad/s, twice the largest full scale that MEMS gyroscopes have."""


@dataclass(frozen=True)
class UnitFault:
    """One sensor that is not in its unit: ``measured = factor * true``."""

    triad: str
    factor: float
    message: str


def check_units(recording: Recording, poses: Poses | None = None) -> None:
    """Refuse a recording whose values are not in m/s² and rad/s.

    Parameters
    ----------
    recording : Recording
    poses : Poses, optional
        Its static poses, if they were found already.

    Raises
    ------
    UnitError
        With the factor that was found, and the unit that explains it.
    """
    faults = unit_faults(recording, poses)
    if faults:
        raise UnitError(
            "; ".join(fault.message for fault in faults)
            + ". Give the import profile that states the unit (--profile), or convert the values"
        )


def unit_faults(recording: Recording, poses: Poses | None = None) -> list[UnitFault]:
    """Return what is wrong with the units of a recording: nothing, or one fault a sensor."""
    poses = find_poses(recording) if poses is None else poses
    found = [_accel_fault(recording, poses), _gyro_fault(recording, poses)]
    return [fault for fault in found if fault is not None]


def _accel_fault(recording: Recording, poses: Poses) -> UnitFault | None:
    if len(poses):
        low, high = AT_REST
        norm = np.linalg.norm(poses.accel, axis=1)
        where = f"|a| at rest is {np.median(norm):.4g} m/s²"
    else:
        low, high = IN_MOTION
        norm = np.linalg.norm(recording.accel, axis=1)
        where = f"the median of |a| is {np.median(norm):.4g} m/s²"
    factor = float(np.median(norm)) / G
    if low <= factor <= high:
        return None
    if factor < REMOVED:
        return UnitFault(
            "accel",
            factor,
            f"{where}, expected {G:.2f}: gravity was taken out of it; calibration needs the "
            "accelerometer's own output",
        )
    return UnitFault(
        "accel",
        factor,
        f"{where}, expected {G:.2f}, a factor of {factor:.4g}{_name(factor, ACCEL_FACTORS)}",
    )


def _gyro_fault(recording: Recording, poses: Poses) -> UnitFault | None:
    closure = closure_of_turns(recording, poses)
    if closure is not None:
        error = closure.error
        best = int(np.argmin(error))
        if error[0] > AGREE and error[best] < min(AGREE, error[0] / 3):
            factor = float(closure.factors[best])
            return UnitFault(
                "gyro",
                factor,
                f"turns are {factor:.4g} times as large by the gyroscope as by the direction of "
                f"gravity{_name(factor, GYRO_FACTORS)}",
            )
        return None
    rate = np.linalg.norm(recording.gyro - np.median(recording.gyro, axis=0), axis=1)
    fast = float(np.quantile(rate, 0.99))
    if fast > FASTEST:
        return UnitFault(
            "gyro",
            1 / DEGREE,
            f"rates reach {fast:.4g} rad/s, more than any MEMS gyroscope measures; perhaps they "
            "are in deg/s",
        )
    return None


class Closure(NamedTuple):
    """Median angle (rad) by which gravity misses over `turns` turns, with each factor (1 first)."""

    factors: FloatArray
    error: FloatArray
    turns: int


def closure_of_turns(recording: Recording, poses: Poses) -> Closure | None:
    """Return how well the gyroscope explains the turns; None if no turn tilted the sensor."""
    turns = find_turns(recording, poses)
    if not len(turns):
        return None
    up = poses.accel / np.linalg.norm(poses.accel, axis=1, keepdims=True)
    before, after = up[turns.before], up[turns.after]
    tilt = np.linalg.norm(closure_residual(before, after), axis=1)
    whole = np.array(
        [
            recording.lost is None or not recording.lost[a + 1 : b].any()
            for a, b in zip(turns.start, turns.stop, strict=True)
        ]
    )
    which = np.flatnonzero((tilt > MOVED) & whole)
    if not which.size:
        return None
    turns, before, after = turns.select(which), before[which], after[which]
    steps = TurnSteps.of(recording, turns)
    angle = steps.angle - np.median(poses.gyro, axis=0) * steps.step[:, None]
    factors = np.array([1.0, *GYRO_FACTORS])
    errors = np.empty((len(factors), len(which)))
    for k, factor in enumerate(factors):
        quat = cumulative_quat_segments(quat_from_rotvec(angle / factor), steps.first)
        mat = mat_from_quat(quat[steps.first[1:] - 1])
        predicted = np.einsum("mij,mj->mi", mat, after)
        errors[k] = np.linalg.norm(closure_residual(before, predicted), axis=1)
    return Closure(factors, np.median(errors, axis=1), len(which))


def _name(factor: float, known: dict[float, str]) -> str:
    """Return what a factor means, if it is near one that is known."""
    values = np.array(list(known))
    distance = np.abs(np.log(factor / values))
    nearest = int(np.argmin(distance))
    return f": {list(known.values())[nearest]}" if distance[nearest] < NEAR else ""
