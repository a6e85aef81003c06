"""Accelerometer bias that settles after each turn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import (
    Column,
    Effect,
    G,
    ShapeParameter,
    State,
    axis_columns,
    per_axis,
    seconds_of_samples,
)
from calib.effects.observed import PAUSE


class AccelSettling(Effect):
    """``f_m,i += k_i exp(-t/tau), t since the last turn ended``."""

    slug = "accel_settling"
    title = "accel settling after a turn"
    equation = "f_m,i += k_i exp(-t/tau), t since the last turn ended"
    source = (
        "Slow release of mechanical stress and charge after a change of load (anelastic "
        "recovery); 1 mg over seconds is an estimate"
    )
    parameters = per_axis("accel", "k", "m/s²", 1e-3 * G)
    shape = (ShapeParameter("tau", "s", 0.2, 15.0),)
    follows = "time since the last turn"
    needs = "short moves, and statics several times longer than the settling"
    sentence = (
        "The accelerometer drifts in the first seconds after each move: wait before the "
        "pose is taken."
    )
    absorbed_by = ("accel.bias",)
    rivals = ("bandwidth",)
    reads = ("since_turn",)

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        # The last turn must be in sight as long as its settling is.
        return seconds_of_samples(12 * parameters["tau"] + PAUSE, interval)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the exponential of the time since the last turn; nothing without turns."""
        if state.since_turn is None:
            return {}
        return axis_columns("accel", "k", np.exp(-state.since_turn / shape["tau"]))


EFFECT = AccelSettling()
