"""Gyro output from turning about the two other axes at once."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, State, axis_columns, per_axis


class GyroAnisoinertia(Effect):
    """``w_m,i += k_i w_j w_k, j and k the two other axes``."""

    slug = "gyro_anisoinertia"
    title = "gyro anisoinertia"
    equation = "w_m,i += k_i w_j w_k, j and k the two other axes"
    source = (
        "IEEE Std 528-2019 (anisoinertia); 0.1 dps at 200 dps about both axes is an "
        "estimate for vibrating-mass gyros"
    )
    parameters = per_axis("gyro", "k", "1/(rad/s)", np.radians(0.1) / np.radians(200.0) ** 2)
    follows = "product of the rates about the two other axes"
    regressor = ("product of the rates about the axes other than {axis}", "(rad/s)²")
    needs = "turns about two axes at once, in several senses"
    sentence = "An axis reads off only while the sensor turns about both of the other axes at once."
    absorbed_by = ("gyro.bias",)
    rivals = ("gyro_scale_quadratic", "accel_size_effect")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return, for each axis, the product of the two other rates."""
        x, y, z = state.rate.T
        return axis_columns("gyro", "k", np.stack([y * z, z * x, x * y], axis=1))


EFFECT = GyroAnisoinertia()
