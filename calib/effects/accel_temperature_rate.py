"""Bias of the accelerometer that follows the rate of temperature: heating and cooling differ."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import (
    SLOPE_MEMORY,
    SLOPE_WINDOW,
    Column,
    Effect,
    G,
    State,
    axis_columns,
    per_axis,
    seconds_of_samples,
)


class AccelTemperatureRate(Effect):
    """``f_m,i += k_i dT/dt``."""

    slug = "accel_temperature_rate"
    title = "accel bias by rate of temperature"
    equation = "f_m,i += k_i dT/dt"
    source = (
        "Thermal gradients inside the package lag behind its thermometer (often called "
        "thermal hysteresis); 1 mg at 0.03 K/s is an estimate"
    )
    parameters = per_axis("accel", "k", "(m/s²)/(K/s)", 1e-3 * G / 0.03)
    follows = "rate of temperature"
    needs = "heating and cooling through the same temperatures, or a span of heating rates"
    sentence = (
        "The accelerometer reads differently while its temperature changes, the faster the more."
    )
    absorbed_by = ("accel.bias",)
    rivals = ("accel_warm_up", "accel_bias_temperature")
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
        return axis_columns("accel", "k", state.temperature_rate)


EFFECT = AccelTemperatureRate()
