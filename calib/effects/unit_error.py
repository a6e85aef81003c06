"""Values in another unit than the one declared."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, G, Parameter, Signals, State, TransformEffect
from calib.effects.resampling import triad_column
from calib.types import FloatArray

FACTORS = {
    "g declared as m/s²": 1 / G,
    "m/s² declared as g": G,
    "mg declared as m/s²": 1000 / G,
    "deg/s declared as rad/s": 180 / np.pi,
    "rad/s declared as deg/s": np.pi / 180,
    "half the full scale assumed": 0.5,
    "twice the full scale assumed": 2.0,
    "a quarter of the full scale assumed": 0.25,
    "four times the full scale assumed": 4.0,
    "an eighth of the full scale assumed": 0.125,
    "eight times the full scale assumed": 8.0,
}
"""What was seen over what is true, for the usual mistakes."""


class UnitError(TransformEffect):
    """``x_m = (1 + error) x``, all axes of a triad alike."""

    slug = "unit_error"
    title = "unit error"
    equation = "x_m = (1 + error) x"
    source = "A wrong unit or full-scale setting in a log: a factor of 2, of g, or of pi/180"
    kind = "setup"
    stage = "readout"
    parameters = (
        Parameter("accel", "1", 1.0, ("accel.x", "accel.y", "accel.z")),
        Parameter("gyro", "1", 1.0, ("gyro.x", "gyro.y", "gyro.z")),
    )
    follows = "the signal itself, all axes alike"
    needs = "gravity for the accelerometer, turns between poses for the gyro"
    sentence = (
        "All values are off by one known factor: the unit or the full scale is not as declared."
    )
    absorbed_by = ("accel.scale_factor_error", "gyro.scale_factor_error")
    rivals = ("gravity_magnitude", "clock_scale")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the signals themselves."""
        return {
            "accel": triad_column("accel", state.force),
            "gyro": triad_column("gyro", state.rate),
        }

    def check(self, parameters: Mapping[str, float]) -> None:
        """Check the parameters as every effect does, and that no factor is 0 or negative."""
        super().check(parameters)
        for name, value in parameters.items():
            if value <= -1:
                raise ValueError(f"`{name}` of unit_error must be above -1, got {value}")

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return Signals(
            signals.accel * (1 + parameters.get("accel", 0.0)),
            signals.gyro * (1 + parameters.get("gyro", 0.0)),
        )

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return Signals(
            signals.accel / (1 + parameters.get("accel", 0.0)),
            signals.gyro / (1 + parameters.get("gyro", 0.0)),
        )


def nearest_mistake(factor: float, *, tolerance: float = 0.15) -> str | None:
    """Return the usual mistake whose factor is within `tolerance` (relative), or None."""
    name = min(FACTORS, key=lambda item: abs(np.log(factor / FACTORS[item])))
    return name if abs(factor / FACTORS[name] - 1) <= tolerance else None


EFFECT = UnitError()
