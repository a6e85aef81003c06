"""Bias of the accelerometer that follows temperature."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, G, State, axis_columns, per_axis


class AccelBiasTemperature(Effect):
    """``f_m,i += k_i T + q_i T² + c_i T³``."""

    slug = "accel_bias_temperature"
    title = "accel bias temperature coefficient"
    equation = "f_m,i += k_i T + q_i T² + c_i T³"
    source = (
        "MPU-6050 product specification rev. 3.4: zero-g output varies by 35 to 60 mg over "
        "70 K, 0.5 mg/K; square and cube are estimates, each a third of the one before at 30 K"
    )
    parameters = (
        *per_axis("accel", "k", "(m/s²)/K", 0.5e-3 * G),
        *per_axis("accel", "q", "(m/s²)/K²", 0.005e-3 * G),
        *per_axis("accel", "c", "(m/s²)/K³", 5e-8 * G, refining=True),
    )
    follows = "temperature"
    needs = "a temperature span that does not just rise with time or pose"
    sentence = "The accelerometer reads off by an amount that follows temperature."
    absorbed_by = ("accel.bias", "accel.scale_factor_error")
    rivals = (
        "accel_warm_up",
        "accel_scale_temperature",
        "accel_temperature_rate",
        "accel_bias_step",
    )
    reads = ("temperature",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return three powers of temperature, on each axis; nothing where it was not measured."""
        if state.warmth is None:
            return {}
        return {
            **axis_columns("accel", "k", state.warmth),
            **axis_columns("accel", "q", state.warmth**2),
            **axis_columns("accel", "c", state.warmth**3),
        }


EFFECT = AccelBiasTemperature()
