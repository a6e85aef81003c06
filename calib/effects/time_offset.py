"""Gyroscope and accelerometer, or the recording and its reference, shifted in time."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import (
    SPLINE_REACH,
    Column,
    Parameter,
    Signals,
    State,
    TransformEffect,
    seconds_of_samples,
)
from calib.effects.resampling import resample, triad_column
from calib.recording import CHANNELS
from calib.types import FloatArray

MOST = 0.2
"""s that a gyroscope may be late or early by: a low-pass of 5 Hz delays by 19 ms (MPU-6050 register
map rev. 4.2, DLPF_CFG 6), a host that polls two chips by a few of its rounds."""


class TimeOffset(TransformEffect):
    """``f_m(t) = f(t - delay)``, ``w_m(t) = w(t - delay - gyro_delay)``."""

    slug = "time_offset"
    title = "time offset"
    equation = "f_m(t) = f(t - delay), w_m(t) = w(t - delay - gyro_delay)"
    source = (
        "Group delays of unlike low-passes, or registers read one after the other: 2 ms is the "
        "difference of neighbouring filter settings (MPU-6050 register map rev. 4.2, DLPF_CFG)"
    )
    parameters = (
        Parameter("gyro_delay", "s", 2e-3, CHANNELS[3:], least=-MOST, most=MOST),
        Parameter("delay", "s", 1e-2, CHANNELS, reference_only=True),
    )
    follows = "derivative of the signal"
    regressor = ("derivative of the signal, its sign changed", "{unit}/s")
    needs = "fast changes of rate and of specific force at once"
    sentence = (
        "The gyro runs late (or early) against the accelerometer, or both against the reference."
    )
    rivals = ("inter_axis_skew", "bandwidth", "accel_size_effect")

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        delay = abs(parameters.get("delay", 0.0)) + abs(parameters.get("gyro_delay", 0.0))
        return SPLINE_REACH + seconds_of_samples(delay, interval)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return minus the derivative, of the gyro alone and of both."""
        accel, gyro = (
            triad_column("accel", -state.force_dot),
            triad_column("gyro", -state.rate_dot),
        )
        return {"gyro_delay": gyro, "delay": {**accel, **gyro}}

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        delay, gyro_delay = parameters.get("delay", 0.0), parameters.get("gyro_delay", 0.0)
        return Signals(
            resample(time, signals.accel, time - delay) if delay else signals.accel,
            resample(time, signals.gyro, time - delay - gyro_delay),
        )

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return self.transform(time, signals, {k: -v for k, v in parameters.items()})


EFFECT = TimeOffset()
