"""Bias of the gyroscope that follows temperature."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class GyroBiasTemperature(Effect):
    """``w_m,i += k_i T + q_i T² + c_i T³``."""

    slug = "gyro_bias_temperature"
    title = "gyro bias temperature coefficient"
    equation = "w_m,i += k_i T + q_i T² + c_i T³"
    source = (
        "MPU-6050 product specification rev. 3.4: zero-rate output varies by +-20 dps over "
        "125 K, 0.05 dps/K on one side; square and cube are estimates, each a third of "
        "the one before at 30 K"
    )
    parameters = (
        *per_axis("gyro", "k", "(rad/s)/K", np.radians(0.05)),
        *per_axis("gyro", "q", "(rad/s)/K²", np.radians(0.0005)),
        *per_axis("gyro", "c", "(rad/s)/K³", np.radians(5e-6), refining=True),
    )
    follows = "temperature"
    needs = "a temperature span that does not just rise with time or pose"
    sentence = "The gyro reads off at rest by an amount that follows temperature."
    absorbed_by = ("gyro.bias", "gyro.scale_factor_error")
    rivals = ("gyro_warm_up", "gyro_scale_temperature", "gyro_temperature_rate", "gyro_bias_step")
    reads = ("temperature",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return three powers of temperature, on each axis; nothing where it was not measured."""
        if state.warmth is None:
            return {}
        return {
            **axis_columns("gyro", "k", state.warmth),
            **axis_columns("gyro", "q", state.warmth**2),
            **axis_columns("gyro", "c", state.warmth**3),
        }


EFFECT = GyroBiasTemperature()
