"""Accelerometer that sits off the point whose motion is known."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import SPLINE_REACH, Column, Effect, Parameter, State
from calib.recording import AXES


class AccelLeverArm(Effect):
    """``f_m += w x (w x r) + dw/dt x r``."""

    slug = "accel_lever_arm"
    title = "lever arm of the accelerometer"
    equation = "f_m += w x (w x r) + dw/dt x r"
    source = "Rigid-body kinematics; 1 cm is the size of a circuit board"
    kind = "setup"
    parameters = tuple(
        Parameter(f"r{a}", "m", 0.01, ("accel.x", "accel.y", "accel.z"), reference_only=True)
        for a in AXES
    )
    follows = "rate squared and angular acceleration"
    regressor = ("rate squared and angular acceleration that an arm along {axis} feels", "1/s²")
    needs = "a known motion, a second accelerometer on the same body, or a turntable"
    sentence = (
        "The accelerometer is not at the point that the reference describes: turning alone "
        "makes it read acceleration."
    )
    absorbed_by = ("accel.bias", "accel.scale_factor_error")
    rivals = ("accel_size_effect", "time_offset")

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return SPLINE_REACH

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the columns of ``skew(w)² + skew(dw/dt)``."""
        gradient = state.gradient
        return {
            f"r{b}": {f"accel.{a}": gradient[:, i, j] for i, a in enumerate(AXES)}
            for j, b in enumerate(AXES)
        }


EFFECT = AccelLeverArm()
