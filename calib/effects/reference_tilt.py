"""The reference's vertical is not along gravity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, Parameter, State
from calib.recording import AXES


class ReferenceTilt(Effect):
    """``f_m += g mat_sn (tilt x z_n)``."""

    slug = "reference_tilt"
    title = "tilt of the reference"
    equation = "f_m += g mat_sn (tilt x z_n)"
    source = "A table or a motion-capture floor levelled by eye; 0.5 degrees is typical"
    kind = "setup"
    parameters = tuple(
        Parameter(
            name, "rad", np.radians(0.5), ("accel.x", "accel.y", "accel.z"), reference_only=True
        )
        for name in ("east", "north")
    )
    follows = "orientation in the reference frame"
    needs = "a reference orientation, at rest in several headings"
    sentence = (
        "The reference's vertical leans: gravity comes from a slightly different direction "
        "than it says."
    )
    absorbed_by = ("accel.bias", "accel.misalignment")
    rivals = ("reference_misalignment",)
    reads = ("mat_ns",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return gravity tipped about east and about north; nothing if orientation is not known."""
        if state.mat_ns is None:
            return {}
        east, north = (state.gravity * state.mat_ns[:, row, :] for row in (0, 1))
        return {
            "east": {f"accel.{a}": -north[:, i] for i, a in enumerate(AXES)},
            "north": {f"accel.{a}": east[:, i] for i, a in enumerate(AXES)},
        }


EFFECT = ReferenceTilt()
