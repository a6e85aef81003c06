"""Are the values in the unit that they claim? Physics decides, not statistics of the values.

- The specific force at rest is gravity: |a| near 9.8 m/s².
- What a turn does to gravity's direction agrees with the integral of the rate (`calib.tilts`).

Sensors as they come from the factory are within 10-15 % of their scale and a few hundred mm/s²,
degrees per second, of zero; the tests leave room for three times that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors import NoCommonMotionError, UnitError
from calib.faults import FASTEST
from calib.gravity import STANDARD_GRAVITY as G
from calib.poses import Poses
from calib.recording import TRIADS, Recording
from calib.statics import find_poses
from calib.synchrony import gyro_delay
from calib.tilts import DEGREE, GYRO_FACTORS, OWN_SCALE, Closure
from calib.types import FloatArray
from calib.unit_switch import Switch, unit_switches

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

IN_MOTION = (0.25, 6.0)
"""Times g; the median of |a| of a recording that only moves."""
NEAR = 0.35
"""How near, in log of the factor, a known confusion must be to be named."""
REMOVED = 0.03
"""Times g; |a| at rest below this means that gravity was taken out."""
ROUND = 0.1
"""By how much, relative to 1, ellipsoids miss squares of gravity that noise and axes explain."""

PLAIN = 0.05
"""Share of gravity within which poses are as long: half of one along an axis that is off by
`OWN_SCALE` makes 7 %."""


@dataclass(frozen=True)
class UnitFault:
    """One sensor that is not in its unit: ``measured = factor * true``.

    ``channel`` (0 to 2) is its only axis that is not, ``interval`` (s) the only part; None if all
    are not.
    """

    triad: str
    factor: float
    message: str
    channel: int | None = None
    interval: tuple[float, float] | None = None


def check_units(recording: Recording, poses: Poses | None = None) -> None:
    """Refuse a recording whose values are not in m/s² and rad/s, or not of one time.

    Parameters
    ----------
    recording : Recording
    poses : Poses, optional
        Its static poses, if they were found already.

    Raises
    ------
    UnitError
        With the factor that was found, and the unit that explains it.
    NoCommonMotionError
        If gyroscope and accelerometer do not show turns at the same time.
    """
    poses = find_poses(recording) if poses is None else poses
    faults = unit_faults(recording, poses, Closure.of(recording, poses))
    if faults:
        raise UnitError(
            "; ".join(fault.message for fault in faults)
            + ". Give the import profile that states the unit (--profile), or convert the values"
        )
    late = gyro_delay(recording)
    if late is not None:
        raise NoCommonMotionError(
            f"the gyroscope is {abs(late):.2f} s {'late' if late > 0 else 'early'} against the "
            "accelerometer: turns must be at the same time in both. Give both the stamps of one "
            "clock, or shift one"
        )


def unit_faults(recording: Recording, poses: Poses, closure: Closure | None) -> list[UnitFault]:
    """Return what is wrong with the units of a recording: nothing, or one fault a sensor.

    `closure` is that of its turns, as `Closure.of` returns it.
    """
    switched = [_switched(switch) for switch in unit_switches(recording)]
    if switched:
        # Of parts in unlike units the whole tells nothing.
        return switched
    found = [_accel_fault(recording, poses), _gyro_fault(recording, closure)]
    return [fault for fault in found if fault is not None]


def _switched(switch: Switch) -> UnitFault:
    triad, factor, (start, stop) = switch
    known = ACCEL_FACTORS if triad == "accel" else GYRO_FACTORS
    return UnitFault(
        triad,
        factor,
        f"from {start:.1f} to {stop:.1f} s the {TRIADS[triad]} is {factor:.4g} times as large as "
        f"in the rest of the recording{name_of(factor, known)} there",
        interval=switch.interval,
    )


def _accel_fault(recording: Recording, poses: Poses) -> UnitFault | None:
    if len(poses):
        low, high = OWN_SCALE
        norm = np.linalg.norm(poses.accel, axis=1)
        where = f"|a| at rest is {np.median(norm):.4g} m/s²"
    else:
        low, high = IN_MOTION
        norm = np.linalg.norm(recording.accel, axis=1)
        where = f"the median of |a| is {np.median(norm):.4g} m/s²"
    factor = float(np.median(norm)) / G
    gains = _gains(poses.accel)
    odd = None if gains is None else _odd(gains)
    if gains is not None and odd is not None and not _plain(poses.accel, odd):
        factor = float(gains[odd])
        return UnitFault(
            "accel",
            factor,
            f"accelerometer {'xyz'[odd]} measures {factor * G:.4g} m/s² of gravity, expected "
            f"{G:.2f}, a factor of {factor:.4g}{name_of(factor, ACCEL_FACTORS)}",
            odd,
        )
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
        f"{where}, expected {G:.2f}, a factor of {factor:.4g}{name_of(factor, ACCEL_FACTORS)}",
    )


def _gains(accel: FloatArray) -> FloatArray | None:
    """Return the gain of each axis, (3,): semi-axes of the ellipsoid of (n, 3) poses, over g.

    None if the poses do not lie on one that they determine.
    """
    if len(accel) < 9:
        return None
    scale = np.abs(accel).max(axis=0)
    if not scale.all():
        return None
    unit = accel / scale
    design = np.hstack((np.square(unit), unit))
    if np.linalg.cond(design) > 30:
        return None
    found = np.linalg.lstsq(design, np.ones(len(unit)), rcond=None)[0]
    square, linear = found[:3], found[3:]
    if (square <= 0).any() or np.std(design @ found - 1) > ROUND:
        return None
    size = 1 + np.sum(np.square(linear) / (4 * square))
    return np.asarray(scale * np.sqrt(size / square) / G)


def _odd(gains: FloatArray) -> int | None:
    """Return the one axis of which the gain is not that of a sensor; None if there is not one."""
    low, high = OWN_SCALE
    wrong = np.flatnonzero((gains < low) | (gains > high))
    return int(wrong[0]) if len(wrong) == 1 else None


def _plain(accel: FloatArray, axis: int) -> bool:
    """Whether most poses that an axis has a part in are as long as gravity.

    Or most of all, if it has a part in none: its gain is what an ellipsoid makes of the others. A
    single one that is none, but a steady push while moving, bends the ellipsoid of all (n, 3).
    """
    norm = np.linalg.norm(accel, axis=1)
    felt = norm[np.abs(accel[:, axis]) > 0.5 * norm]
    return abs(float(np.median(felt if len(felt) else norm)) / G - 1) < PLAIN


def _gyro_fault(recording: Recording, closure: Closure | None) -> UnitFault | None:
    if closure is not None:
        factor, odd = closure.factor, closure.channel
        if factor == 1.0:
            return None
        what = "the gyroscope" if odd is None else f"gyroscope {'xyz'[odd]}"
        return UnitFault(
            "gyro",
            factor,
            f"turns are {factor:.4g} times as large by {what} as by the direction of "
            f"gravity{name_of(factor, GYRO_FACTORS)}",
            odd,
        )
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


def name_of(factor: float, known: dict[float, str]) -> str:
    """Return what a factor means, if it is near one that is known."""
    values = np.array(list(known))
    distance = np.abs(np.log(factor / values))
    nearest = int(np.argmin(distance))
    return f": {list(known.values())[nearest]}" if distance[nearest] < NEAR else ""
