"""Samples that went missing, or came twice, without the clock showing it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import (
    SAMPLES,
    SPLINE_REACH,
    Column,
    Parameter,
    ShapeParameter,
    Signals,
    State,
    TransformEffect,
)
from calib.effects.resampling import resample, triad_column
from calib.recording import CHANNELS
from calib.types import FloatArray


class DroppedSamples(TransformEffect):
    """``x_m(t) = x(t + count dt)`` from the moment on; a negative count is repeated samples."""

    slug = "dropped_samples"
    title = "dropped samples"
    equation = "x_m(t) = x(t + count dt) for t >= moment, dt the sample interval"
    source = "Overrun of a buffer or a lost packet where time is counted in samples; one sample"
    kind = "event"
    stage = "readout"
    parameters = (Parameter("count", SAMPLES, 1.0, CHANNELS),)
    shape = (ShapeParameter("moment", "s", None, None, "linear"),)
    from_moment = True
    follows = "time: one turn's angle is off by rate times the sample interval"
    needs = "that it happened in a fast turn; at rest it cannot be seen"
    sentence = "Samples are missing (or repeated) at this moment, and the time stamps hide it."
    absorbed_by = ("gyro.scale_factor_error",)
    rivals = ("gyro_bias_step",)

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return SPLINE_REACH + int(np.ceil(abs(parameters.get("count", 0.0))))

    def ahead(self, parameters: Mapping[str, float], *, time: FloatArray) -> int:
        after = int(np.sum(time >= parameters["moment"]))
        return min(after, max(0, int(np.ceil(parameters.get("count", 0.0)))))

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the derivative times one sample interval, from the moment on.

        Integrated over a turn it is minus the rate at the moment times the interval: the angle
        that was lost.
        """
        later = _interval(state.time) * state.since(shape["moment"])[:, None]
        return {
            "count": {
                **triad_column("accel", later * state.force_dot),
                **triad_column("gyro", later * state.rate_dot),
            }
        }

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        count = parameters.get("count", 0.0)
        if count == round(count):
            # A buffer counts samples: those that come twice are the same to the last bit.
            index = np.arange(len(time)) + int(count) * (time >= parameters["moment"])
            more = time[-1] + _interval(time) * np.arange(1, count + 1)
            # The last samples say how a signal goes on: no spline through all of them is needed.
            ends = (np.concatenate((x, resample(time[-4:], x[-4:], more))) for x in signals)
            return Signals(*(x[np.maximum(index, 0)] for x in ends))
        at = _true_time(time, parameters)
        return Signals(*(resample(time, values, at) for values in signals))

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Put the samples back at their true times and fill the gap by a cubic spline."""
        at = _true_time(time, parameters)
        # Repeated samples fall on times that are there already.
        before = np.maximum.accumulate(np.concatenate([[-np.inf], at[:-1]]))
        new = at > before
        return Signals(*(resample(at[new], values[new], time) for values in signals))


def _interval(time: FloatArray) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def _true_time(time: FloatArray, parameters: Mapping[str, float]) -> FloatArray:
    shift = parameters.get("count", 0.0) * _interval(time)
    return time + shift * (time >= parameters["moment"])


EFFECT = DroppedSamples()
