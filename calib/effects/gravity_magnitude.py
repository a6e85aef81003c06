"""Local gravity is not the one that was assumed."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, Parameter, State
from calib.recording import AXES


class GravityMagnitude(Effect):
    """``f_m += error * up``."""

    slug = "gravity_magnitude"
    title = "gravity magnitude"
    equation = "f_m += error * up"
    source = (
        "Normal gravity spans 9.780 to 9.832 m/s² from equator to pole (WGS 84), so 0.02 "
        "m/s² is typical of a wrong latitude; the highest mountains take off another 0.03"
    )
    kind = "setup"
    parameters = (
        Parameter(
            "error",
            "m/s²",
            0.02,
            ("accel.x", "accel.y", "accel.z"),
            reference_only=True,
            least=-0.1,
            most=0.1,
        ),
    )
    follows = "direction of gravity, all axes alike"
    needs = (
        "a known local gravity: from statics alone it is the same as a common accelerometer "
        "scale factor"
    )
    sentence = (
        "Gravity here is not the value that was assumed; give the local one (--latitude and "
        "--height)."
    )
    absorbed_by = ("accel.scale_factor_error",)
    rivals = ("unit_error", "accel_scale_temperature")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the unit vector up; along the specific force where orientation is not known."""
        up = state.gravity_direction
        return {"error": {f"accel.{a}": up[:, i] for i, a in enumerate(AXES)}}

    def size_if(self, common: float, *, gravity: float) -> float:
        return common * gravity


EFFECT = GravityMagnitude()
