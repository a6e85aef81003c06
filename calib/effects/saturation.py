"""Signals cut at the end of the sensor's range."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import (
    PRESENCE,
    Column,
    Parameter,
    ShapeParameter,
    Signals,
    State,
    TransformEffect,
)
from calib.effects.resampling import each_triad, presence_columns
from calib.types import FloatArray


class Saturation(TransformEffect):
    """``x_m = clip(x, -full_scale, full_scale)``."""

    slug = "saturation"
    title = "saturation"
    equation = "x_m = clip(x, -full_scale, full_scale)"
    source = (
        "Full scales of consumer parts are 2 to 16 g and 125 to 2000 dps; a range that was set too "
        "small clips the fastest turns"
    )
    kind = "event"
    stage = "readout"
    parameters = (
        Parameter("accel", PRESENCE, 1.0, ("accel.x", "accel.y", "accel.z")),
        Parameter("gyro", PRESENCE, 1.0, ("gyro.x", "gyro.y", "gyro.z")),
    )
    shape = (
        ShapeParameter("accel_full_scale", "m/s²", None, None, optional=True),
        ShapeParameter("gyro_full_scale", "rad/s", None, None, optional=True),
    )
    follows = "size of the signal, beyond the full scale"
    needs = "the raw full scale, or plateaus at one value"
    sentence = (
        "The signal was cut at the end of the range: choose a larger full scale, or turn slower."
    )
    absorbed_by = ("gyro.scale_factor_error", "accel.scale_factor_error")
    rivals = ("gyro_scale_nonlinearity", "accel_cubic")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return what is cut off each triad whose full scale is given."""
        return presence_columns(state, shape, "full_scale", _clip)

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return each_triad(signals, parameters, "full_scale", _clip)

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Return the signals as they are: what was cut off is gone."""
        return signals


def _clip(values: FloatArray, full_scale: float) -> FloatArray:
    return np.clip(values, -full_scale, full_scale)


EFFECT = Saturation()
