"""Linear g-sensitivity of the gyroscope: specific force shifts its output."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Effect, Parameter, Signals, State
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
        Parameter(f"g{a}{b}", "(rad/s)/(m/s²)", np.radians(0.1) / 9.80665, (f"gyro.{a}",))
        for a in AXES
        for b in AXES
    )
    needs = "many static poses: each axis up and down"
    sentence = "The gyro's output at rest changes with the pose: it senses specific force."

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Signals]:
        """Return the nine columns of ``G f``."""
        out = {}
        for i, a in enumerate(AXES):
            for j, b in enumerate(AXES):
                gyro = np.zeros_like(state.rate)
                gyro[:, i] = state.force[:, j]
                out[f"g{a}{b}"] = Signals(np.zeros_like(state.force), gyro)
        return out


EFFECT = GyroGSensitivity()
