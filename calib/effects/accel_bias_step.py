"""Bias of the accelerometer that jumps at one moment."""

from __future__ import annotations

from collections.abc import Mapping

from calib.effects.base import Column, Effect, G, ShapeParameter, State, axis_columns, per_axis


class AccelBiasStep(Effect):
    """``f_m,i += b_i from the moment on``."""

    slug = "accel_bias_step"
    title = "accel bias step"
    equation = "f_m,i += b_i from the moment on"
    source = "A shock, a supply step or a reset of an internal correction; 2 mg is an estimate"
    kind = "event"
    parameters = per_axis("accel", "b", "m/s²", 2e-3 * G)
    shape = (ShapeParameter("moment", "s", None, None, "linear"),)
    from_moment = True
    follows = "time: before and after one moment"
    needs = "poses before and after the moment"
    sentence = "The accelerometer reads off by a constant from one moment on."
    absorbed_by = ("accel.bias",)
    rivals = ("accel_bias_temperature", "accel_warm_up")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return 0 before the moment and 1 from then on, on each axis."""
        return axis_columns("accel", "b", state.since(shape["moment"]))


EFFECT = AccelBiasStep()
