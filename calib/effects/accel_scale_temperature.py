"""Scale factor of the accelerometer that follows temperature."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class AccelScaleTemperature(Effect):
    """``f_m,i += k_i T f_i``."""

    slug = "accel_scale_temperature"
    title = "accel scale temperature coefficient"
    equation = "f_m,i += k_i T f_i"
    source = "MPU-6050 product specification rev. 3.4: sensitivity change 0.02 %/K; 0.02 %/K taken"
    parameters = per_axis("accel", "k", "1/K", 2e-4)
    follows = "temperature times specific force"
    regressor = ("temperature times specific force along {axis}", "K m/s²")
    needs = "each axis up and down at several temperatures"
    sentence = "Gravity reads too large or too small by a share that follows temperature."
    absorbed_by = ("accel.scale_factor_error", "accel.bias")
    rivals = ("accel_bias_temperature", "accel_warm_up")
    reads = ("temperature",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return temperature times specific force; nothing where it was not measured."""
        if state.warmth is None:
            return {}
        return axis_columns("accel", "k", state.warmth[:, None] * state.force)


EFFECT = AccelScaleTemperature()
