"""Values in another unit than the one declared; `calib.units` knows the usual ones."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Parameter, Signals, State, TransformEffect
from calib.effects.resampling import triad_column
from calib.types import FloatArray


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


EFFECT = UnitError()
