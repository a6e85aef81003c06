"""Linear g-sensitivity of the gyroscope: specific force shifts its output."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, G, Parameter, State
from calib.recording import AXES


class GyroGSensitivity(Effect):
    """``w_m += G f``, G full 3x3 in (rad/s)/(m/s²)."""

    slug = "gyro_g_sensitivity"
    title = "gyro g-sensitivity"
    equation = "w_m += G f"
    source = (
        "IEEE Std 528-2019 (g-sensitive drift); 0.1 dps/g is typical of consumer data sheets "
        "(MPU-6050 product specification rev. 3.4, linear acceleration sensitivity)"
    )
    parameters = tuple(
        Parameter(f"g{a}{b}", "(rad/s)/(m/s²)", np.radians(0.1) / G, (f"gyro.{a}",))
        for a in AXES
        for b in AXES
    )
    follows = "specific force at rest"
    regressor = ("specific force along {axis}", "m/s²")
    needs = "many static poses: each axis up and down"
    sentence = "The gyro's output at rest changes with the pose: it senses specific force."
    absorbed_by = ("gyro.bias",)
    rivals = ("earth_rate", "gyro_g_squared_sensitivity")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the nine columns of ``G f``."""
        return {
            f"g{a}{b}": {f"gyro.{a}": state.force[:, j]} for a in AXES for j, b in enumerate(AXES)
        }


EFFECT = GyroGSensitivity()
