"""Misalignment of the gyroscope to the accelerometer frame: one axis sees turns about another."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, Parameter, State
from calib.recording import AXES


class GyroMisalignment(Effect):
    """``w_m += M w, M zero on its diagonal``."""

    slug = "gyro_misalignment"
    title = "gyro misalignment"
    equation = "w_m += M w, M zero on its diagonal"
    source = (
        "IEEE Std 528-2019 (misalignment); MPU-6050 product specification rev. 3.4: cross- "
        "axis sensitivity +-2 %, so 0.01 rad is typical"
    )
    parameters = tuple(
        Parameter(f"m{a}{b}", "rad", 0.01, (f"gyro.{a}",)) for a in AXES for b in AXES if a != b
    )
    follows = "rate about the other axes"
    regressor = ("rate about {axis}", "rad/s")
    needs = "turns about several axes, each reached from several poses"
    sentence = (
        "Turning about one axis shows on another: the gyro axes are not square to the "
        "accelerometer axes."
    )
    absorbed_by = ("gyro.scale_factor_error",)
    rivals = ("axis_error", "reference_misalignment")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the six columns of ``M w``."""
        return {
            f"m{a}{b}": {f"gyro.{a}": state.rate[:, j]}
            for a in AXES
            for j, b in enumerate(AXES)
            if a != b
        }


EFFECT = GyroMisalignment()
