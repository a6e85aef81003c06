"""What a calibration that is read must be to be one of a sensor on Earth.

A file that was edited by hand, or by a program that means other units, is told from one that
`imu-cal` wrote by physics alone. The bounds are wide: they refuse what no sensor can be, not what a
bad one is.
"""

from __future__ import annotations

import numpy as np

from calib.calibration import Calibration
from calib.effects import get_effect
from calib.effects.base import Effect, Term
from calib.errors import CalibrationFileError
from calib.gravity import EARTH
from calib.model import Triad

BIAS = {"accel": (100.0, "m/s²"), "gyro": (10.0, "rad/s")}
"""The most that a bias may be: ten times gravity, and a quarter of a full scale of 2000 °/s. Parts
are within 1 m/s² and 0.35 rad/s (MPU-6050 product specification rev. 3.4, sections 6.1 and 6.2)."""

GAIN = (0.1, 10.0)
"""What a sensor reads of a unit vector, at least and at most. Parts are within 10-15 % of 1
(`calib.units`), and full scales that were mistaken make up to 8."""

TEMPERATURE = (-100.0, 300.0)
"""°C; parts for bore holes go to 225."""

BEYOND = 10.0
"""Times its physical limits (`Effect.limits`) that a parameter of a further term may be."""

UNLIMITED = 1e6
"""Times its typical size that one may be which has no such limit."""

AGAIN = "was the file edited? Restore it from a copy, or calibrate again"


def check_plausible(calibration: Calibration) -> None:
    """Check that a sensor on Earth can be what a calibration says.

    Raises
    ------
    CalibrationFileError
        Naming what cannot be, and what was expected.
    """
    gravity = calibration.gravity
    if not EARTH[0] < gravity.value < EARTH[1]:
        raise CalibrationFileError(
            f"`gravity.value` is {gravity.value:g} m/s², expected {EARTH[0]} to {EARTH[1]}, as on "
            f"Earth: a calibration is in m/s², also of a sensor that reads g; {AGAIN}"
        )
    for name, triad in (("accel", calibration.model.accel), ("gyro", calibration.model.gyro)):
        _check_triad(name, triad)
    _check_temperature("reference_temperature", calibration.model.reference_temperature)
    if span := calibration.temperature:
        _check_temperature("temperature_range.low", span.low)
        _check_temperature("temperature_range.high", span.high)
        if span.low > span.high:
            raise CalibrationFileError(
                f"`temperature_range` is {span.low:g} to {span.high:g} °C, expected the lower one "
                f"first; {AGAIN}"
            )
    for term in calibration.model.terms:
        _check_term(term, get_effect(term.effect))


def _check_triad(name: str, triad: Triad) -> None:
    most, unit = BIAS[name]
    worst = float(triad.bias[np.argmax(np.abs(triad.bias))])
    if abs(worst) > most:
        raise CalibrationFileError(
            f"`parameters.{name}.bias` has {worst:g} {unit}, expected {most:g} at most; {AGAIN}"
        )
    gain = np.linalg.svd(triad.matrix, compute_uv=False)
    if gain.min() < GAIN[0] or gain.max() > GAIN[1]:
        seen = float(gain.min() if gain.min() < GAIN[0] else gain.max())
        raise CalibrationFileError(
            f"with its `parameters.{name}.scale_factor_error` and `misalignment` the sensor would "
            f"read {round(seen, 3):g} of 1 in some direction, expected {GAIN[0]:g} to "
            f"{GAIN[1]:g}: scale factor errors are relative (0.01 is 1 %); {AGAIN}"
        )


def _check_temperature(name: str, value: float) -> None:
    if not TEMPERATURE[0] <= value <= TEMPERATURE[1]:
        raise CalibrationFileError(
            f"`{name}` is {value:g} °C, expected {TEMPERATURE[0]:g} to {TEMPERATURE[1]:g}; {AGAIN}"
        )


def _check_term(term: Term, effect: Effect) -> None:
    for item in effect.parameters:
        value = term.parameters.get(item.name, 0.0)
        least, most = effect.limits([item.name])
        most_of_all = BEYOND * max(abs(float(least[0])), abs(float(most[0])))
        if not np.isfinite(most_of_all):
            most_of_all = UNLIMITED * item.typical
        if abs(value) > most_of_all:
            raise CalibrationFileError(
                f"`{item.name}` of {term.effect} is {value:g} {item.unit}, expected "
                f"{most_of_all:.3g} at most; {AGAIN}"
            )
    for shape in effect.shape:
        value = term.parameters.get(shape.name, 1.0)
        if shape.spacing == "log" and not value > 0:
            raise CalibrationFileError(
                f"`{shape.name}` of {term.effect} is {value:g} {shape.unit}, expected more than "
                f"0; {AGAIN}"
            )
