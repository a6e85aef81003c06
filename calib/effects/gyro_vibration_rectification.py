"""Gyro output whose mean shifts when the sensor is shaken."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, G, State, axis_columns, per_axis, seconds_of_samples
from calib.effects.observed import TURN_REACH
from calib.effects.vibration import UNLIMITED, VIBRATION_REACH


class GyroVibrationRectification(Effect):
    """``w_m,i += k_i var(f), summed over the axes``."""

    slug = "gyro_vibration_rectification"
    title = "gyro vibration rectification"
    equation = "w_m,i += k_i var(f), summed over the axes"
    source = (
        "IEEE Std 528-2019 (vibration rectification error); 0.02 dps at 1 g rms is an "
        "estimate for consumer parts"
    )
    parameters = per_axis("gyro", "k", "(rad/s)/(m/s²)²", np.radians(0.02) / G**2, most=UNLIMITED)
    follows = "variance of specific force within a second, all axes together"
    regressor = ("variance of specific force within a second, all axes", "(m/s²)²")
    needs = "the same pose with and without vibration"
    sentence = "The mean of the gyro shifts while the sensor is shaken."
    absorbed_by = ("gyro.bias",)
    rivals = ("gyro_g_squared_sensitivity", "gyro_bias_step")
    reads = ("vibration",)

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return seconds_of_samples(VIBRATION_REACH + TURN_REACH, interval) + 8

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the variance of specific force, all axes together; nothing if not known."""
        if state.vibration is None:
            return {}
        return axis_columns("gyro", "k", state.vibration.sum(axis=1))


EFFECT = GyroVibrationRectification()
