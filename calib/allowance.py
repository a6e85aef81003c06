"""By how much a sensor may change by itself, without its calibration being wrong.

A bias wanders from pose to pose while it is calibrated, Earth turns, and beyond the temperatures
that were calibrated typical coefficients apply, unless the model has its own.
"""

from __future__ import annotations

import numpy as np

from calib.calibration import Calibration
from calib.effects import get_effect
from calib.effects.earth_rate import RATE as EARTH_RATE
from calib.poses import Poses
from calib.recording import AXES
from calib.types import FloatArray

THERMAL = {
    "accel.bias": "accel_bias_temperature",
    "accel.scale_factor_error": "accel_scale_temperature",
    "gyro.bias": "gyro_bias_temperature",
    "gyro.scale_factor_error": "gyro_scale_temperature",
}
"""The effect whose typical size is the coefficient of each group of parameters."""


def wander(calibration: Calibration) -> dict[str, float]:
    """Return one standard deviation of what biases do by themselves, by name.

    For the accelerometer that is what its own fit left over; for the gyroscope the spread of its
    static output from pose to pose, and Earth's rotation in an unknown direction.
    """
    accel = 0.0 if calibration.accel is None else calibration.accel.residual_rms
    gyro = float(np.sqrt(EARTH_RATE**2 / 3 + _static_variance(calibration)))
    out = {f"accel.bias.{axis}": accel for axis in AXES}
    return out | {f"gyro.bias.{axis}": gyro for axis in AXES}


def thermal(calibration: Calibration) -> dict[str, float]:
    """Return the typical coefficient of temperature by name, per K; none that the model has."""
    present = {term.effect for term in calibration.model.terms}
    return {
        f"{group}.{axis}": get_effect(slug).parameters[0].typical
        for group, slug in THERMAL.items()
        if slug not in present
        for axis in AXES
    }


def beyond(calibration: Calibration, poses: Poses) -> FloatArray:
    """Return how far poses (k,) are outside the calibrated temperatures: signed, K, 0 within."""
    span, temperature = calibration.temperature, poses.temperature
    if span is None or temperature is None:
        return np.zeros(len(poses))
    return temperature - np.clip(temperature, span.low, span.high)


def between(first: Calibration, second: Calibration) -> dict[str, float]:
    """Return by how much parameters may differ between two calibrations of an unchanged device."""
    one, two = wander(first), wander(second)
    variance = {name: one[name] ** 2 + two[name] ** 2 for name in one}
    a, b = first.temperature, second.temperature
    gap = 0.0 if a is None or b is None else max(a.low - b.high, b.low - a.high, 0.0)
    if gap:
        for name, coefficient in thermal(first).items():
            variance[name] = variance.get(name, 0.0) + (coefficient * gap) ** 2
    return {name: float(np.sqrt(value)) for name, value in variance.items()}


def _static_variance(calibration: Calibration) -> float:
    """Return the variance of the static rate from pose to pose when it was calibrated."""
    table = calibration.poses
    if table is None or calibration.gyro is None:
        return 0.0
    still = np.ones(len(table.gyro), bool)
    for item in calibration.gyro.excluded:
        low, high = item.interval
        still &= (table.interval[:, 0] < low) | (table.interval[:, 1] > high)
    return float(table.gyro[still].var(axis=0, ddof=1).max()) if still.sum() > 2 else 0.0
