"""Scale factor that changes with the square of the rate: the odd part of its nonlinearity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class GyroScaleNonlinearity(Effect):
    """``w_m,i += k_i w_i³``."""

    slug = "gyro_scale_nonlinearity"
    title = "gyro cubic nonlinearity"
    equation = "w_m,i += k_i w_i³"
    source = (
        "IEEE Std 1431-2004 (scale factor nonlinearity, odd term); MPU-6050 product "
        "specification rev. 3.4: nonlinearity 0.2 %, taken at 360 dps"
    )
    parameters = per_axis("gyro", "k", "1/(rad/s)²", 2e-3 / np.radians(360.0) ** 2)
    follows = "cube of the rate"
    regressor = ("cube of the rate about {axis}", "(rad/s)³")
    needs = "slow and fast turns about each axis"
    sentence = (
        "Fast turns read wrong by more than slow ones, both ways alike: the scale is not linear."
    )
    absorbed_by = ("gyro.scale_factor_error",)
    rivals = ("saturation", "bandwidth")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the cubed rates."""
        return axis_columns("gyro", "k", state.rate**3)


EFFECT = GyroScaleNonlinearity()
