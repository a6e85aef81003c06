"""Scale factor that differs between the two senses of rotation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class GyroScaleAsymmetry(Effect):
    """``w_m,i += k_i |w_i|``."""

    slug = "gyro_scale_asymmetry"
    title = "gyro scale asymmetry"
    equation = "w_m,i += k_i |w_i|"
    source = "IEEE Std 528-2019 (asymmetry); 0.1 % is an estimate for consumer parts"
    parameters = per_axis("gyro", "k", "1", 1e-3)
    follows = "sign of the rate"
    regressor = ("size of the rate about {axis}", "rad/s")
    needs = "turns both ways about each axis, by like angles"
    sentence = "Turning one way reads larger than turning the other way."
    absorbed_by = ("gyro.bias", "gyro.scale_factor_error")
    rivals = ("gyro_scale_quadratic",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the absolute rates."""
        return axis_columns("gyro", "k", np.abs(state.rate))


EFFECT = GyroScaleAsymmetry()
