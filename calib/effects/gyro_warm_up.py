"""Bias of the gyroscope that settles after power-on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.accel_warm_up import FASTEST
from calib.effects.base import Column, Effect, ShapeParameter, State, axis_columns, per_axis

MOST = np.radians(20.0)
"""What an MPU-6050 drifts from -40 to 85 °C; a sensor warms itself up by less."""


class GyroWarmUp(Effect):
    """``w_m,i += k_i exp(-t/tau), t since power-on``."""

    slug = "gyro_warm_up"
    title = "gyro warm-up"
    equation = "w_m,i += k_i exp(-t/tau), t since power-on"
    source = (
        "IEEE Std 528-2019 (warm-up time); 0.1 dps over minutes is an estimate from cold "
        "starts of consumer parts"
    )
    parameters = per_axis("gyro", "k", "rad/s", np.radians(0.1), most=MOST)
    shape = (ShapeParameter("tau", "s", FASTEST, 1500.0),)
    follows = "time since power-on"
    needs = "a cold start, and statics long after it"
    sentence = (
        "The gyroscope drifts after it is switched on, and settles: let it warm up, or model it."
    )
    absorbed_by = ("gyro.bias",)
    rivals = ("gyro_bias_temperature", "gyro_temperature_rate", "gyro_bias_step")
    from_power_on = True

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the exponential of the time since power-on, on each axis."""
        since = np.maximum(state.time - state.power_on, 0.0)
        return axis_columns("gyro", "k", np.exp(-since / shape["tau"]))


EFFECT = GyroWarmUp()
