"""The sensor frame is turned against the body frame of the reference."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, Parameter, State
from calib.recording import AXES, CHANNELS
from calib.rotation import mat_from_rotvec
from calib.types import FloatArray


def _across(axis: str) -> tuple[str, ...]:
    return tuple(channel for channel in CHANNELS if not channel.endswith(axis))


class ReferenceMisalignment(Effect):
    """``f_m = R(-rho) f, w_m = R(-rho) w``, R the rotation by a vector; nearly ``f += f x rho``."""

    slug = "reference_misalignment"
    title = "misalignment to the reference"
    equation = "f_m = R(-rho) f, w_m = R(-rho) w"
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

    def contribution(self, state: State, parameters: Mapping[str, float]) -> dict[str, FloatArray]:
        """Return what turning both signals adds; of 3 degrees, products of two angles are seen."""
        turn = mat_from_rotvec(-np.array([parameters.get(f"r{a}", 0.0) for a in AXES]))
        if not (turn - np.eye(3)).any():
            return {}
        change = np.hstack([s @ (turn - np.eye(3)).T for s in (state.force, state.rate)])
        return dict(zip(CHANNELS, change.T, strict=True))


EFFECT = ReferenceMisalignment()
