"""Accelerometer output whose mean shifts when the sensor is shaken."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, G, State, axis_columns, per_axis, seconds_of_samples
from calib.effects.observed import TURN_REACH
from calib.effects.vibration import UNLIMITED, VIBRATION_REACH


class AccelVibrationRectification(Effect):
    """``f_m,i += k_i var(f_i)``."""

    slug = "accel_vibration_rectification"
    title = "accel vibration rectification"
    equation = "f_m,i += k_i var(f_i)"
    source = (
        "IEEE Std 1293-2018 (vibration rectification error); 10 mg at 1 g rms is an estimate "
        "for consumer parts: 1 mg where nothing clips, 60 mg where the range is nearly reached"
    )
    parameters = per_axis("accel", "k", "(m/s²)/(m/s²)²", 1e-2 / G, most=UNLIMITED)
    follows = "variance of specific force within a second"
    regressor = ("variance of specific force within a second", "(m/s²)²")
    needs = "the same pose with and without vibration"
    sentence = "The mean of the accelerometer shifts while the sensor is shaken."
    absorbed_by = ("accel.bias",)
    rivals = ("accel_quadratic", "accel_bias_step")
    reads = ("vibration",)

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return seconds_of_samples(VIBRATION_REACH + TURN_REACH, interval) + 8

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return each axis' own variance of specific force; nothing where it is not known."""
        if state.vibration is None:
            return {}
        return axis_columns("accel", "k", state.vibration)


EFFECT = AccelVibrationRectification()
