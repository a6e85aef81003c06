"""Third-order nonlinearity of the accelerometer."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, G, State, axis_columns, per_axis


class AccelCubic(Effect):
    """``f_m,i += K3_i f_i³``."""

    slug = "accel_cubic"
    title = "accel cubic nonlinearity"
    equation = "f_m,i += K3_i f_i³"
    source = "IEEE Std 1293-2018, model equation (K3); 2 mg/g³ is an estimate for consumer parts"
    parameters = per_axis("accel", "k", "(m/s²)/(m/s²)³", 2e-3 / G**2)
    follows = "cube of specific force"
    regressor = ("cube of specific force along {axis}", "(m/s²)³")
    needs = "well spread poses between the faces, not only on them"
    sentence = "The scale of the accelerometer differs between small and large specific force."
    absorbed_by = ("accel.scale_factor_error",)
    rivals = ("accel_quadratic", "saturation")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the cubed specific force."""
        return axis_columns("accel", "k", state.force**3)


EFFECT = AccelCubic()
