"""Bias of the gyroscope that jumps at one moment."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, ShapeParameter, State, axis_columns, per_axis


class GyroBiasStep(Effect):
    """``w_m,i += b_i from the moment on``."""

    slug = "gyro_bias_step"
    title = "gyro bias step"
    equation = "w_m,i += b_i from the moment on"
    source = "A shock, a supply step or a reset of an internal correction; 0.05 dps is an estimate"
    kind = "event"
    parameters = per_axis("gyro", "b", "rad/s", np.radians(0.05))
    shape = (ShapeParameter("moment", "s", None, None, "linear"),)
    from_moment = True
    follows = "time: before and after one moment"
    needs = "poses before and after the moment"
    sentence = "The gyroscope reads off by a constant from one moment on."
    absorbed_by = ("gyro.bias",)
    rivals = ("gyro_bias_temperature", "gyro_warm_up")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return 0 before the moment and 1 from then on, on each axis."""
        return axis_columns("gyro", "b", state.since(shape["moment"]))


EFFECT = GyroBiasStep()
