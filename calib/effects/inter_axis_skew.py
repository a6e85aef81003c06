"""The axes of a triad are sampled one after another."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import (
    SPLINE_REACH,
    Column,
    Parameter,
    Signals,
    State,
    TransformEffect,
    seconds_of_samples,
)
from calib.effects.resampling import resample
from calib.recording import AXES
from calib.types import FloatArray

NAMES = tuple((triad, axis) for triad in ("accel", "gyro") for axis in ("y", "z"))


class InterAxisSkew(TransformEffect):
    """``x_m,i(t) = x_i(t - delay_i)``, relative to the x axis of the same triad."""

    slug = "inter_axis_skew"
    title = "skew between axes"
    equation = "x_m,i(t) = x_i(t - delay_i), delay_x = 0"
    source = (
        "One converter that serves the axes in turn, or registers read one by one: two bytes on a "
        "100 kHz I2C bus take 0.2 ms; 0.5 ms is an estimate with overhead"
    )
    parameters = tuple(Parameter(f"{t}_{a}", "s", 5e-4, (f"{t}.{a}",)) for t, a in NAMES)
    follows = "derivative of the signal on one axis"
    regressor = ("derivative of the signal, its sign changed", "{unit}/s")
    needs = "fast turns about several axes"
    sentence = "The axes are not sampled at the same moment."
    rivals = ("time_offset", "accel_size_effect")

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        longest = max((abs(value) for value in parameters.values()), default=0.0)
        return SPLINE_REACH + seconds_of_samples(longest, interval)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return minus the derivative of each y and z."""
        slopes = {"accel": state.force_dot, "gyro": state.rate_dot}
        return {f"{t}_{a}": {f"{t}.{a}": -slopes[t][:, AXES.index(a)]} for t, a in NAMES}

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        out = Signals(np.array(signals.accel), np.array(signals.gyro))
        for triad, axis in NAMES:
            delay = parameters.get(f"{triad}_{axis}", 0.0)
            if delay:
                values = out.accel if triad == "accel" else out.gyro
                i = AXES.index(axis)
                values[:, i] = resample(time, values[:, i], time - delay)
        return out

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return self.transform(time, signals, {k: -v for k, v in parameters.items()})


EFFECT = InterAxisSkew()
