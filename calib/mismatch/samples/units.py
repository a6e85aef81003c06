"""Units and axes that are not those that are given, and turns that none make agree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib import faults
from calib.effects import get_effect
from calib.effects.axis_error import ORDERS, signed_permutation
from calib.mismatch.findings.diagnosis import Finding, Rival, Unexplained
from calib.mismatch.samples.found import (
    BEYOND,
    COPIED,
    DISAGREES,
    PUSHED,
    STUCK,
    fault_finding,
    intervals_of,
    join_intervals,
)
from calib.poses import Poses
from calib.recording import CHANNELS, Recording
from calib.synchrony import STEP, gyro_delay
from calib.tilts import FEWEST, GYRO_FACTORS, Closure
from calib.turns import find_turns
from calib.types import FloatArray
from calib.units import ACCEL_FACTORS, name_of, unit_faults

GYRO = CHANNELS[3:]

HARDEST = 1e3
"""m/s²: a hand does 5 g, a knock at the bench 50 g for a sample or two, and few accelerometers
measure 100 g."""

DOWNWARDS = ORDERS.index(((0, 1, 2), (-1, -1, -1)))
"""How axes lie of which all have the wrong sign."""


def look_at_units(
    recording: Recording, poses: Poses
) -> tuple[tuple[Finding, ...], tuple[Unexplained, ...]]:
    """Look for wrong units and axes; and for turns that no unit and no axes make agree.

    A channel that repeats another one, or is dead, makes both look wrong.
    """
    values = faults.values_of(recording)
    for c, d, same in faults.find_copies(values):
        if same.sum() > STUCK * len(recording):
            places = intervals_of(recording.time, np.flatnonzero(same))
            names = CHANNELS[c], CHANNELS[d]
            return (), (Unexplained(names, places, COPIED, faults.FALSE_ALARM),)
    dead = np.ptp(values[:, :3], axis=0) == 0.0
    if dead.any() and not dead.all() and len(recording) >= faults.BLOCK:
        return (), ()
    closure = Closure.of(recording, poses) if len(poses) else None
    late = gyro_delay(recording)
    if late is not None:
        # Turns that are compared with others than themselves tell nothing of units and axes.
        found, spread = {"gyro_delay": late}, {"gyro_delay": STEP}
        return (fault_finding("time_offset", recording, GYRO, found, spread=spread),), ()
    wrong = (*_units(recording, poses, closure), *_axes(recording, closure))
    if wrong or not len(poses):
        return wrong, ()
    far = np.abs(np.median(poses.gyro, axis=0)) > faults.FASTEST
    if far.any():
        axes = tuple(f"gyro.{a}" for a, off in zip("xyz", far, strict=True) if off)
        whole = (float(recording.time[0]), float(recording.time[-1]))
        return (), (Unexplained(axes, (whole,), BEYOND, faults.FALSE_ALARM),)
    turns = find_turns(recording, poses)
    spans = zip(turns.start.tolist(), turns.stop.tolist(), strict=True)
    force = np.array([np.abs(recording.accel[a:b]).max(axis=0) for a, b in spans])
    hard = np.median(force, axis=0) > HARDEST if len(force) else np.zeros(3, bool)
    if hard.any():
        axes = tuple(CHANNELS[c] for c in np.flatnonzero(hard))
        moved = float(poses.interval[0, 1]), float(poses.interval[-1, 0])
        return (), (Unexplained(axes, (moved,), PUSHED, faults.FALSE_ALARM),)
    if closure is None or len(closure) < FEWEST or closure.agrees:
        return (), ()
    where = join_intervals([(float(a), float(b)) for a, b in closure.disagreeing])
    return (), (Unexplained(CHANNELS, where, DISAGREES, faults.FALSE_ALARM),)


def _units(recording: Recording, poses: Poses, closure: Closure | None) -> list[Finding]:
    out = []
    for fault in unit_faults(recording, poses, closure):
        own = "" if fault.channel is None else f".{'xyz'[fault.channel]}"
        channels = tuple(c for c in CHANNELS if c.startswith(fault.triad + own))
        values = {fault.triad: fault.factor - 1.0}
        where = () if fault.interval is None else (fault.interval,)
        out.append(fault_finding("unit_error", recording, channels, values, fault.message, where))
    return out


def _axes(recording: Recording, closure: Closure | None) -> list[Finding]:
    """Return that turns and gravity do not have the same axes: those of one triad are wrong.

    What the gyroscope has by P, a rotation, the accelerometer may have by ``inv(P)``, or by the
    mirror image ``-inv(P)``: rates are a pseudovector, and do not tell. The fewest wrong axes are
    the likelier mistake.
    """
    if closure is None or np.array_equal(closure.axes, np.eye(3)):
        return []
    # The closure knows what undoes the mistake; the effect states the mistake.
    made = closure.axes.T
    mistakes = [("gyro", made)]
    if np.linalg.det(made) > 0:
        mirrored = min((made.T, -made.T), key=lambda mat: len(_wrong("accel", mat)))
        mistakes.append(("accel", mirrored))
    (triad, mat), *others = sorted(mistakes, key=lambda mistake: len(_wrong(*mistake)))
    found = fault_finding("axis_error", recording, _wrong(triad, mat), _laid(triad, mat))
    for other, mat in others:
        words = get_effect("axis_error").in_words(_laid(other, mat))
        found = replace(
            found,
            sentence=f"{found.sentence} Or, and nothing here tells which: {words}",
            rivals=(Rival(f"axis_error {other}", 1.0),),
            to_separate="Lay the sensor down with each of its marked axes upwards: the "
            "accelerometer reads +1 g along it if its axes are right.",
        )
    return [found]


def _wrong(triad: str, mat: FloatArray) -> tuple[str, ...]:
    """Return the channels of a triad that a signed permutation (3, 3) changes."""
    rows = zip("xyz", mat - np.eye(3), strict=True)
    return tuple(f"{triad}.{axis}" for axis, row in rows if row.any())


def _laid(triad: str, mat: FloatArray) -> dict[str, float]:
    """Return the parameters of an axis error of one triad."""
    number = next((k for k in range(len(ORDERS)) if np.array_equal(signed_permutation(k), mat)), 0)
    return {triad: 1.0, f"{triad}_axes": float(number)}


def axes_beside(
    recording: Recording, numbers: Mapping[str, int], *, other: str = "simulation"
) -> Finding:
    """Return the finding that triads show the axes of the `other` in another order."""
    values: dict[str, float] = {}
    names: list[str] = []
    for triad, number in numbers.items():
        mat = signed_permutation(number)
        values |= _laid(triad, mat)
        names += _wrong(triad, mat)
    whose = f"The two do not have the same axes: mend those of the recording, or of the {other}."
    found = fault_finding("axis_error", recording, tuple(names), values)
    words = get_effect("axis_error").in_words(values)
    if numbers.get("accel") == DOWNWARDS:
        words += " An accelerometer at rest reads 1 g upwards, and not downwards."
    return replace(found, sentence=f"{whose} Beside the {other}: {words}")


def factor_beside(
    recording: Recording, triad: str, factor: float, *, other: str, theirs: bool = False
) -> Finding:
    """Return the finding that a triad reads so many times what the `other` has.

    If it is known to be ``theirs``, by its own rests and turns, the other's unit is wrong.
    """
    channels, known = (CHANNELS[:3], ACCEL_FACTORS) if triad == "accel" else (GYRO, GYRO_FACTORS)
    found = fault_finding("unit_error", recording, channels, {triad: factor - 1.0})
    mend = f": check the units and ranges of both{name_of(factor, known)}."
    if theirs:
        name = name_of(1.0 / factor, known) or ": check its units and ranges"
        mend = f", and by its own rests and turns it is the {other} that is off{name}."
    return replace(
        found, sentence=f"The {triad} reads {factor:.4g} times what the {other} has{mend}"
    )
