"""Scale factor of the gyroscope that follows temperature."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class GyroScaleTemperature(Effect):
    """``w_m,i += k_i T w_i``."""

    slug = "gyro_scale_temperature"
    title = "gyro scale temperature coefficient"
    equation = "w_m,i += k_i T w_i"
    source = (
        "MPU-6050 product specification rev. 3.4: sensitivity varies by +-2 % over 125 K; "
        "0.02 %/K taken"
    )
    parameters = per_axis("gyro", "k", "1/K", 2e-4)
    follows = "temperature times rate"
    regressor = ("temperature times the rate about {axis}", "K rad/s")
    needs = "like turns about each axis at several temperatures"
    sentence = "Turns read too large or too small by a share that follows temperature."
    absorbed_by = ("gyro.scale_factor_error", "gyro.bias")
    rivals = ("gyro_bias_temperature", "gyro_warm_up", "clock_scale")
    reads = ("temperature",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return temperature times the rates; nothing where it was not measured."""
        if state.warmth is None:
            return {}
        return axis_columns("gyro", "k", state.warmth[:, None] * state.rate)


EFFECT = GyroScaleTemperature()
