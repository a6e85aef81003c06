"""Output rounded to counts that are coarse against the noise."""

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


class Quantization(TransformEffect):
    """``x_m = lsb round(x / lsb)``."""

    slug = "quantization"
    title = "quantization"
    equation = "x_m = lsb round(x / lsb)"
    source = (
        "IEEE Std 952-1997, C.1.5; 16-bit parts round to 0.06-0.5 mg and 4-60 mdps, 8-bit parts "
        "and logs printed with few digits to far more"
    )
    stage = "readout"
    parameters = (
        Parameter("accel", PRESENCE, 1.0, ("accel.x", "accel.y", "accel.z")),
        Parameter("gyro", PRESENCE, 1.0, ("gyro.x", "gyro.y", "gyro.z")),
    )
    shape = (
        ShapeParameter("accel_lsb", "m/s²", 1e-5, 1.0, optional=True),
        ShapeParameter("gyro_lsb", "rad/s", 1e-6, 0.1, optional=True),
    )
    follows = "distance of the signal from the nearest count"
    needs = "few distinct values at rest: an LSB larger than twice the noise"
    sentence = "The output steps in coarse counts: noise no longer averages it out."
    absorbed_by = ("gyro.bias", "accel.bias")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the rounding error of each triad whose LSB is given."""
        return presence_columns(state, shape, "lsb", _round)

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return each_triad(signals, parameters, "lsb", _round)

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Return the signals as they are: what was rounded off is gone."""
        return signals


def _round(values: FloatArray, lsb: float) -> FloatArray:
    return np.asarray(np.round(values / lsb) * lsb)


EFFECT = Quantization()
