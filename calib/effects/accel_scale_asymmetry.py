"""Scale factor of the accelerometer that differs between the two ends of an axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class AccelScaleAsymmetry(Effect):
    """``f_m,i += k_i |f_i|``."""

    slug = "accel_scale_asymmetry"
    title = "accel scale asymmetry"
    equation = "f_m,i += k_i |f_i|"
    source = (
        "IEEE Std 1293-2018, model equation (scale factor asymmetry); 0.1 % is an estimate "
        "for consumer parts"
    )
    parameters = per_axis("accel", "k", "1", 1e-3)
    follows = "sign of specific force"
    regressor = ("size of specific force along {axis}", "m/s²")
    needs = "poses with each axis at both ends and between"
    sentence = (
        "An axis reads gravity larger up than down, with a kink at level, beyond what bias "
        "explains."
    )
    absorbed_by = ("accel.bias",)
    rivals = ("accel_quadratic",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the absolute specific force."""
        return axis_columns("accel", "k", np.abs(state.force))


EFFECT = AccelScaleAsymmetry()
