"""Gyro output that follows the square of specific force, the same for both ends of an axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, G, State, axis_columns, per_axis


class GyroGSquaredSensitivity(Effect):
    """``w_m,i += g_i f_i²``."""

    slug = "gyro_g_squared_sensitivity"
    title = "gyro g-squared sensitivity"
    equation = "w_m,i += g_i f_i²"
    source = (
        "IEEE Std 528-2019 (g-squared-sensitive drift); 0.02 dps/g² is an estimate for "
        "consumer parts, a fifth of their g-sensitivity"
    )
    parameters = per_axis("gyro", "g", "(rad/s)/(m/s²)²", np.radians(0.02) / G**2)
    follows = "square of specific force at rest"
    regressor = ("square of specific force along {axis}", "(m/s²)²")
    needs = "poses with each axis up, level and down"
    sentence = (
        "The gyro reads off at rest when an axis is vertical, up or down alike: it senses "
        "the square of specific force."
    )
    absorbed_by = ("gyro.bias",)
    rivals = ("gyro_g_sensitivity", "gyro_vibration_rectification")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return each axis' own squared specific force."""
        return axis_columns("gyro", "g", state.force**2)


EFFECT = GyroGSquaredSensitivity()
