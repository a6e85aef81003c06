"""Low-pass in the sensor: amplitude falls with frequency, and the signal comes late."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import (
    PRESENCE,
    SPLINE_REACH,
    Column,
    Parameter,
    ShapeParameter,
    Signals,
    State,
    TransformEffect,
)
from calib.effects.resampling import each_triad, presence_columns
from calib.types import FloatArray


class Bandwidth(TransformEffect):
    """First order ``1 / (1 + s/w0)``, second ``1 / (1 + sqrt(2) s/w0 + s²/w0²)`` (Butterworth).

    The filter is discretised for signals that are straight between samples (first-order hold) at
    the median sample interval.
    """

    slug = "bandwidth"
    title = "bandwidth"
    equation = "x_m = x / (1 + s/w0), or x / (1 + sqrt(2) s/w0 + s²/w0²), w0 = 2 pi cutoff"
    source = (
        "Digital low-pass of the part: 5 to 260 Hz (MPU-6050 register map rev. 4.2, DLPF_CFG); "
        "mechanical response of the proof mass"
    )
    parameters = (
        Parameter("accel", PRESENCE, 1.0, ("accel.x", "accel.y", "accel.z")),
        Parameter("gyro", PRESENCE, 1.0, ("gyro.x", "gyro.y", "gyro.z")),
    )
    shape = (
        ShapeParameter("accel_cutoff", "Hz", 3.0, 300.0, optional=True),
        ShapeParameter("gyro_cutoff", "Hz", 3.0, 300.0, optional=True),
        ShapeParameter("order", "1", 1, 2, "integer", optional=True),
    )
    follows = "frequency of the signal"
    needs = "motion over a range of frequencies; its delay alone is the same as time_offset"
    sentence = "Fast changes come out smaller and later: the sensor's low-pass is too low for them."
    rivals = ("time_offset", "gyro_scale_nonlinearity")

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return SPLINE_REACH

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return what the low-pass takes away from each triad whose cut-off is given."""
        order = int(shape.get("order", 1))
        return presence_columns(
            state, shape, "cutoff", lambda x, cutoff: low_pass(state.time, x, cutoff, order=order)
        )

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        order = int(parameters.get("order", 1))
        return each_triad(
            signals, parameters, "cutoff", lambda x, cutoff: low_pass(time, x, cutoff, order=order)
        )

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Add the derivatives that the low-pass took away; noise near the sample rate stays."""
        order = int(parameters.get("order", 1))
        return each_triad(
            signals, parameters, "cutoff", lambda x, cutoff: _sharpen(time, x, cutoff, order=order)
        )


def low_pass(time: FloatArray, values: FloatArray, cutoff: float, *, order: int) -> FloatArray:
    """Return (n, k) values through the low-pass, which starts settled at the first of them."""
    if len(time) < 2:
        return values
    w0 = 2 * np.pi * cutoff
    denominator = [1 / w0, 1.0] if order == 1 else [1 / w0**2, np.sqrt(2) / w0, 1.0]
    step = float(np.median(np.diff(time)))
    from scipy.signal import cont2discrete, lfilter, lfilter_zi  # half a second to import

    num, den, _ = cont2discrete(([1.0], denominator), step, method="foh")
    initial = lfilter_zi(num.ravel(), den)[:, None] * values[0]
    out: FloatArray = lfilter(num.ravel(), den, values, axis=0, zi=initial)[0]
    return out


def _sharpen(time: FloatArray, values: FloatArray, cutoff: float, *, order: int) -> FloatArray:
    if len(time) < 4:
        return values
    w0 = 2 * np.pi * cutoff
    from scipy.interpolate import CubicSpline  # a third of a second to import

    spline = CubicSpline(time, values)
    if order == 1:
        first: FloatArray = values + spline(time, 1) / w0
        return first
    second: FloatArray = values + np.sqrt(2) / w0 * spline(time, 1) + spline(time, 2) / w0**2
    return second


EFFECT = Bandwidth()
