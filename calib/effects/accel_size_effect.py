"""The three accelerometer axes do not sit at one point."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import SPLINE_REACH, Column, Effect, Parameter, State
from calib.recording import AXES

MOST = 0.03
"""m that the axes of one accelerometer may sit apart, made of separate parts on one board."""


class AccelSizeEffect(Effect):
    """``f_m,i += (w x (w x r_i) + dw/dt x r_i)_i, r_x = 0``."""

    slug = "accel_size_effect"
    title = "accel size effect"
    equation = "f_m,i += (w x (w x r_i) + dw/dt x r_i)_i, r_x = 0"
    source = (
        "IEEE Std 1293-2018 (size effect); 1 mm is the spacing of proof masses in a small "
        "package, 10 mm with separate parts"
    )
    parameters = tuple(
        Parameter(f"r{a}{b}", "m", 1e-3, (f"accel.{a}",), least=-MOST, most=MOST)
        for a in ("y", "z")
        for b in AXES
    )
    follows = "rate squared and angular acceleration"
    regressor = ("rate squared and angular acceleration that an arm along {axis} feels", "1/s²")
    needs = "fast turns about several axes, from rest to rest"
    sentence = "While it turns fast, the three axes of the accelerometer disagree: they sit apart."
    rivals = ("accel_lever_arm", "time_offset", "inter_axis_skew")

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return SPLINE_REACH

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return rows y and z of ``skew(w)² + skew(dw/dt)``: positions relative to the x axis."""
        gradient = state.gradient
        return {
            f"r{a}{b}": {f"accel.{a}": gradient[:, AXES.index(a), j]}
            for a in ("y", "z")
            for j, b in enumerate(AXES)
        }


EFFECT = AccelSizeEffect()
