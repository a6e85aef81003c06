"""Second-order nonlinearity of the accelerometer."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, G, State, axis_columns, per_axis


class AccelQuadratic(Effect):
    """``f_m,i += K2_i f_i²``."""

    slug = "accel_quadratic"
    title = "accel quadratic nonlinearity"
    equation = "f_m,i += K2_i f_i²"
    source = (
        "IEEE Std 1293-2018, model equation (K2); 3 mg/g² from consumer data sheets "
        "(nonlinearity 0.5 % of full scale in MPU-6050 product specification rev. 3.4 "
        "bounds it)"
    )
    parameters = per_axis("accel", "k", "(m/s²)/(m/s²)²", 3e-3 / G)
    follows = "square of specific force"
    regressor = ("square of specific force along {axis}", "(m/s²)²")
    needs = (
        "well spread poses, not only faces; the turns between them separate it from "
        "accel_cross_product"
    )
    sentence = (
        "Gravity reads too large when an axis points up and too small when it points down, "
        "or the other way round, beyond what bias explains."
    )
    absorbed_by = ("accel.bias", "accel.scale_factor_error")
    rivals = ("accel_cross_product", "accel_scale_asymmetry", "accel_cubic")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the squared specific force."""
        return axis_columns("accel", "k", state.force**2)


EFFECT = AccelQuadratic()
