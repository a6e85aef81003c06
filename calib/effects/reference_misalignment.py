"""The sensor frame is turned against the body frame of the reference."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, Parameter, State
from calib.recording import AXES, CHANNELS


def _across(axis: str) -> tuple[str, ...]:
    return tuple(channel for channel in CHANNELS if not channel.endswith(axis))


class ReferenceMisalignment(Effect):
    """``f_m += f x rho, w_m += w x rho``."""

    slug = "reference_misalignment"
    title = "misalignment to the reference"
    equation = "f_m += f x rho, w_m += w x rho"
    source = "Mounting of markers or fixture by hand; 1 degree is typical"
    kind = "setup"
    parameters = tuple(
        Parameter(f"r{a}", "rad", np.radians(1.0), _across(a), reference_only=True) for a in AXES
    )
    follows = "both signals, about one axis"
    needs = "a reference's own orientation or rate"
    sentence = "Sensor and reference are mounted at an angle to each other."
    absorbed_by = ("accel.misalignment", "gyro.misalignment")
    rivals = ("gyro_misalignment", "reference_tilt", "axis_error")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return both signals seen from a frame turned a little about each axis."""
        out: dict[str, Column] = {}
        for j, b in enumerate(AXES):
            axis = np.eye(3)[j]
            seen = np.hstack([np.cross(state.force, axis), np.cross(state.rate, axis)])
            out[f"r{b}"] = {c: seen[:, i] for i, c in enumerate(CHANNELS) if c in _across(b)}
        return out


EFFECT = ReferenceMisalignment()
