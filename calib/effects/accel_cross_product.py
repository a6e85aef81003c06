"""Accelerometer output from specific force along its own and another axis at once."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, G, Parameter, State
from calib.recording import AXES

PRODUCTS = {"x": ("xy", "xz"), "y": ("xy", "yz"), "z": ("xz", "yz")}
"""For each axis the two products that contain it."""


class AccelCrossProduct(Effect):
    """``f_m,i += K_ij f_i f_j + K_ik f_i f_k``."""

    slug = "accel_cross_product"
    title = "accel cross-axis nonlinearity"
    equation = "f_m,i += K_ij f_i f_j + K_ik f_i f_k"
    source = (
        "IEEE Std 1293-2018, model equation (K_io, K_ip); 2 mg/g² is an estimate for consumer parts"
    )
    parameters = tuple(
        Parameter(f"k{a}_{p}", "(m/s²)/(m/s²)²", 2e-3 / G, (f"accel.{a}",))
        for a, pair in PRODUCTS.items()
        for p in pair
    )
    follows = "product of specific force along two axes"
    regressor = ("product of specific force along two axes", "(m/s²)²")
    needs = "well spread poses, not only faces; turns between them"
    sentence = (
        "An axis reads off when gravity lies between it and another axis, beyond what "
        "misalignment explains."
    )
    absorbed_by = ("accel.misalignment", "accel.bias")
    rivals = ("accel_quadratic",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return two products of specific force for each axis."""
        product = {
            a + b: state.force[:, i] * state.force[:, j]
            for i, a in enumerate(AXES)
            for j, b in enumerate(AXES)
            if i < j
        }
        return {
            f"k{a}_{p}": {f"accel.{a}": product[p]} for a, pair in PRODUCTS.items() for p in pair
        }


EFFECT = AccelCrossProduct()
