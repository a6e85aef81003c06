"""The reference was smoothed before it was given away."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, Parameter, State
from calib.effects.resampling import triad_column
from calib.recording import CHANNELS
from calib.types import FloatArray

TYPICAL = 1.0 / (2.0 * np.pi * 15.0) ** 2
"""s²: a low-pass that takes a half away at 15 Hz."""

STRONGEST = 1.0 / (2.0 * np.pi * 3.0) ** 2
"""s²: at 3 Hz it takes hand motion itself."""


class ReferenceSmoothing(Effect):
    """A low-pass without delay took ``k d²/dt²`` from angles and positions in the room's frame.

    With the rate w, its derivative and the acceleration a in the frame of the room::

        w_m -= mat_sn orientation d²w/dt²
        f_m -= mat_sn position d²a/dt² + orientation f x (mat_sn dw/dt)

    That is the beginning of what any such low-pass does: of ``1 / (1 + k (2 pi f)²)`` a half is
    left at f = 1 / (2 pi sqrt(k)), 159 Hz over the root of k in ms². No sensor does it: a sensor's
    low-pass comes late, and acts in its own frame.
    """

    slug = "reference_smoothing"
    title = "smoothing of the reference"
    equation = (
        "w_m -= mat_sn orientation d²w/dt², "
        "f_m -= mat_sn position d²a/dt² + orientation f x (mat_sn dw/dt)"
    )
    source = "Captured motion is usually low-passed forwards and backwards at 6 to 20 Hz"
    kind = "setup"
    parameters = (
        Parameter(
            "orientation", "s²", TYPICAL, CHANNELS, reference_only=True, least=0.0, most=STRONGEST
        ),
        Parameter(
            "position", "s²", TYPICAL, CHANNELS[:3], reference_only=True, least=0.0, most=STRONGEST
        ),
    )
    follows = "how fast rate and acceleration change in the room"
    regressor = ("second derivative in the room, its sign changed", "{unit}/s²")
    needs = "fast motion beside a captured one"
    sentence = (
        "Fast motion is smaller in the reference than it was: the reference has been smoothed. "
        "Export it without its filter, or with a wider one."
    )
    rivals = ("bandwidth", "accel_size_effect")
    reads = ("mat_ns",)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return what is missing of both; nothing if orientation is not known."""
        mat = state.mat_ns
        if mat is None:
            return {}

        def in_room(values: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("nij,nj->ni", mat, values))

        def in_sensor(values: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("nij,ni->nj", mat, values))

        slope = state.derivative(in_room(state.rate))
        bend = state.derivative(state.derivative(in_room(state.force)))
        return {
            "orientation": {
                **triad_column("accel", -np.cross(state.force, in_sensor(slope))),
                **triad_column("gyro", -in_sensor(state.derivative(slope))),
            },
            "position": triad_column("accel", -in_sensor(bend)),
        }


EFFECT = ReferenceSmoothing()
