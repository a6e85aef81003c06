"""The sensor's clock runs fast or slow: its time axis is stretched."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Parameter, Signals, State, TransformEffect
from calib.effects.resampling import resample, triad_column
from calib.recording import CHANNELS
from calib.types import FloatArray


class ClockScale(TransformEffect):
    """``x_m(t0 + (1 + scale) s) = x(t0 + s)``, s counted from the first sample."""

    slug = "clock_scale"
    title = "clock scale"
    equation = "x_m(t0 + (1 + scale) s) = x(t0 + s)"
    source = (
        "Internal oscillators of consumer parts are within 1 % (MPU-6050 product specification "
        "rev. 3.4: +-1 % at 25 °C when run from the gyro), crystals within 50 ppm"
    )
    kind = "setup"
    parameters = (Parameter("scale", "1", 5e-3, CHANNELS, reference_only=True),)
    follows = "time, ever more"
    needs = "an outside clock or a reference; alone it looks like a gyro scale common to all axes"
    sentence = "The sensor's clock runs fast (or slow): all angles are off by one share."
    absorbed_by = ("gyro.scale_factor_error",)
    rivals = ("time_offset", "gyro_scale_temperature")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return minus the derivative times the time since the first sample."""
        since = (state.time - state.time[0])[:, None]
        return {
            "scale": {
                **triad_column("accel", -since * state.force_dot),
                **triad_column("gyro", -since * state.rate_dot),
            }
        }

    def check(self, parameters: Mapping[str, float]) -> None:
        """Check the parameters as every effect does, and that the clock runs, and forwards."""
        super().check(parameters)
        scale = parameters.get("scale", 0.0)
        if scale <= -1:
            raise ValueError(f"`scale` of clock_scale must be above -1, got {scale}")

    def ahead(self, parameters: Mapping[str, float], *, time: FloatArray) -> int:
        # By a slow clock a motion is over sooner.
        return int(np.sum(_true_time(time, parameters) > time[-1]))

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        at = _true_time(time, parameters)
        return Signals(*(resample(time, values, at) for values in signals))

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        at = time[0] + (time - time[0]) * (1.0 + parameters.get("scale", 0.0))
        return Signals(*(resample(time, values, at) for values in signals))

    def size_if(self, common: float, *, gravity: float) -> float:
        return common


def _true_time(time: FloatArray, parameters: Mapping[str, float]) -> FloatArray:
    return np.asarray(time[0] + (time - time[0]) / (1.0 + parameters.get("scale", 0.0)))


EFFECT = ClockScale()
