"""Accelerometer bias that settles after each turn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import (
    FORM,
    Column,
    Effect,
    G,
    ShapeParameter,
    State,
    axis_columns,
    per_axis,
    seconds_of_samples,
)
from calib.effects.observed import TURN_REACH

FADING, WHOLE, NONE = range(3)
"""What there is of it while the next turn lasts: it fades on from the last, it is all there (that
is what disturbs it), or nothing. No physics says which."""

_WORDS = (
    "It goes on fading through the next turn.",
    "All of it is there while the sensor turns.",
    "Nothing of it is there while the sensor turns.",
)


class AccelSettling(Effect):
    """``f_m,i += k_i exp(-t/tau), t since the last turn ended``; in turns as ``in_turns`` says."""

    slug = "accel_settling"
    title = "accel settling after a turn"
    equation = "f_m,i += k_i exp(-t/tau), t since the last turn ended"
    source = (
        "Slow release of mechanical stress and charge after a change of load (anelastic "
        "recovery); 1 mg over seconds is an estimate"
    )
    parameters = per_axis("accel", "k", "m/s²", 1e-3 * G)
    shape = (
        ShapeParameter("tau", "s", 0.2, 15.0),
        ShapeParameter("in_turns", FORM, 0, 2, "integer", optional=True),
    )
    follows = "time since the last turn"
    needs = "short moves, and statics several times longer than the settling"
    sentence = (
        "The accelerometer drifts in the first seconds after each move: wait before the "
        "pose is taken."
    )
    absorbed_by = ("accel.bias",)
    rivals = ("bandwidth",)
    reads = ("since_turn", "turning")

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        return seconds_of_samples(TURN_REACH, interval)

    def memory(self, parameters: Mapping[str, float], *, interval: float) -> int:
        # The last turn must be in sight as long as its settling is.
        return seconds_of_samples(12 * parameters["tau"] + 2 * TURN_REACH, interval)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the exponential of the time since the last turn; nothing without turns."""
        if state.since_turn is None or state.turning is None:
            return {}
        there = np.exp(-state.since_turn / shape["tau"])
        form = shape.get("in_turns", FADING)
        if form != FADING:
            there[state.turning] = float(form == WHOLE)
        return axis_columns("accel", "k", there)

    def must_show(self, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """Return what fades after turns: a bias while it turns, and no longer, settles nothing."""
        return {**shape, "in_turns": NONE} if shape.get("in_turns", FADING) == WHOLE else None

    def in_words(self, shape: Mapping[str, float]) -> str:
        return _WORDS[int(shape.get("in_turns", FADING))]


EFFECT = AccelSettling()
