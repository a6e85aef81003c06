"""Bias of the gyroscope that follows the rate of temperature: heating and cooling differ."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import (
    SLOPE_MEMORY,
    SLOPE_WINDOW,
    Column,
    Effect,
    State,
    axis_columns,
    per_axis,
    seconds_of_samples,
)


class GyroTemperatureRate(Effect):
    """``w_m,i += k_i dT/dt``."""

    slug = "gyro_temperature_rate"
    title = "gyro bias by rate of temperature"
    equation = "w_m,i += k_i dT/dt"
    source = (
        "Thermal gradients inside the package lag behind its thermometer (often called "
        "thermal hysteresis); 0.02 dps at 0.03 K/s is an estimate"
    )
    parameters = per_axis("gyro", "k", "(rad/s)/(K/s)", np.radians(0.02) / 0.03)
    follows = "rate of temperature"
    needs = "heating and cooling through the same temperatures, or a span of heating rates"
    sentence = "The gyroscope reads differently while its temperature changes, the faster the more."
    absorbed_by = ("gyro.bias",)
    rivals = ("gyro_warm_up", "gyro_bias_temperature")
    reads = ("temperature",)

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return seconds_of_samples(0.5 * SLOPE_WINDOW, interval) + 1

    def memory(self, parameters: Mapping[str, float], *, interval: float) -> int:
        # Beyond what the oldest sample that is corrected anew looks back to.
        return seconds_of_samples(SLOPE_MEMORY, interval) + 1

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the rate of temperature, on each axis; nothing if not measured."""
        if state.temperature_rate is None:
            return {}
        return axis_columns("gyro", "k", state.temperature_rate)


EFFECT = GyroTemperatureRate()
