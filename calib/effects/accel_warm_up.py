"""Bias of the accelerometer that settles after power-on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, G, ShapeParameter, State, axis_columns, per_axis

FASTEST = 10.0
"""s: below what a small board takes to warm up. Half a gram of it (1 J/gK, 10 W/m²K from 10 cm²)
takes 50 s, 20 s with wires that cool it. The package follows its board in 2 s (0.03 J/K at 60 K/W),
but the 10 mW of a sensor make that half a kelvin."""


MOST = 0.5 * G
"""Ten times what consumer parts drift over 70 K (MPU-6050: 35 to 60 mg); a sensor warms itself up
by less."""


class AccelWarmUp(Effect):
    """``f_m,i += k_i exp(-t/tau), t since power-on``."""

    slug = "accel_warm_up"
    title = "accel warm-up"
    equation = "f_m,i += k_i exp(-t/tau), t since power-on"
    source = (
        "IEEE Std 528-2019 (warm-up time); 5 mg over minutes is an estimate from cold "
        "starts of consumer parts"
    )
    parameters = per_axis("accel", "k", "m/s²", 5e-3 * G, most=MOST)
    shape = (ShapeParameter("tau", "s", FASTEST, 1500.0),)
    follows = "time since power-on"
    needs = "a cold start, and statics long after it"
    sentence = (
        "The accelerometer drifts after it is switched on, and settles: let it warm up, or "
        "model it."
    )
    absorbed_by = ("accel.bias", "accel.scale_factor_error")
    rivals = ("accel_bias_temperature", "accel_temperature_rate", "accel_bias_step")
    from_power_on = True

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the exponential of the time since power-on, on each axis."""
        since = np.maximum(state.time - state.power_on, 0.0)
        return axis_columns("accel", "k", np.exp(-since / shape["tau"]))


EFFECT = AccelWarmUp()
