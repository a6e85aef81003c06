"""Scale factor that changes in proportion to the rate: the even part of its nonlinearity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class GyroScaleQuadratic(Effect):
    """``w_m,i += k_i w_i²``."""

    slug = "gyro_scale_quadratic"
    title = "gyro quadratic nonlinearity"
    equation = "w_m,i += k_i w_i²"
    source = (
        "IEEE Std 1431-2004 (scale factor nonlinearity, even term); 0.1 % at 360 dps is an estimate"
    )
    parameters = per_axis("gyro", "k", "1/(rad/s)", 1e-3 / np.radians(360.0))
    follows = "square of the rate"
    regressor = ("square of the rate about {axis}", "(rad/s)²")
    needs = "turns both ways, slow and fast"
    sentence = (
        "Fast turns one way read too large, the other way too small: the scale changes with "
        "the rate."
    )
    absorbed_by = ("gyro.scale_factor_error", "gyro.bias")
    rivals = ("gyro_scale_asymmetry", "gyro_anisoinertia")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the squared rates."""
        return axis_columns("gyro", "k", state.rate**2)


EFFECT = GyroScaleQuadratic()
