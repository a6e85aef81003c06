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

STRONGEST = 1.0 / (2.0 * np.pi * 2.0) ** 2
"""s²: at 2 Hz it takes hand motion itself."""


class ReferenceSmoothing(Effect):
    """A low-pass without delay took ``k d²/dt² - m d⁴/dt⁴`` from quaternions and positions.

    With the rate w, dots for its derivatives, and the acceleration a, in the frame of the room::

        v = m (w... + w.. x w - (w . w.) w - |w|² w. / 2) - k w.
        w_m += mat_sn dv/dt
        f_m += mat_sn (position_fourth d⁴a/dt⁴ - position d²a/dt²) + f x mat_sn v

    of which k is ``orientation``, m ``orientation_fourth``; v is ``2 (m d⁴q/dt⁴ - k d²q/dt²) q*``.
    That is the beginning of what any such low-pass does: of ``1 / (1 + k (2 pi f)² + m (2 pi f)⁴)``
    with k alone a half is left at 159 Hz over the root of k in ms², and with m alone (a Butterworth
    of second order forwards and backwards) at 159 Hz over the fourth root of m in ms⁴. No sensor
    does it: a sensor's low-pass comes late, and acts in its own frame.
    """

    slug = "reference_smoothing"
    title = "smoothing of the reference"
    equation = (
        "w_m += mat_sn dv/dt, f_m += mat_sn (position_fourth d⁴a/dt⁴ - position d²a/dt²) "
        "+ f x mat_sn v, v = 2 (orientation_fourth d⁴q/dt⁴ - orientation d²q/dt²) q*"
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
        Parameter(
            "orientation_fourth",
            "s⁴",
            TYPICAL**2,
            CHANNELS,
            reference_only=True,
            least=0.0,
            most=STRONGEST**2,
            refining=True,
        ),
        Parameter(
            "position_fourth",
            "s⁴",
            TYPICAL**2,
            CHANNELS[:3],
            reference_only=True,
            least=0.0,
            most=STRONGEST**2,
            refining=True,
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
    together = tuple(
        own
        for both in (("orientation", "position"), ("orientation_fourth", "position_fourth"))
        for own in ((both[0],), (both[1],), both)
    )

    def regressor_of(self, name: str) -> tuple[str, str] | None:
        if name.endswith("_fourth"):
            return "fourth derivative in the room", "{unit}/s⁴"
        return super().regressor_of(name)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return what is missing of both; nothing if orientation is not known."""
        mat = state.mat_ns
        if mat is None:
            return {}

        def in_room(values: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("nij,nj->ni", mat, values))

        def in_sensor(values: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("nij,ni->nj", mat, values))

        def turned(by: FloatArray) -> Column:
            return {
                **triad_column("accel", np.cross(state.force, in_sensor(by))),
                **triad_column("gyro", in_sensor(state.derivative(by))),
            }

        seen = state if state.captured is None else state.captured
        w, force = in_room(seen.rate), [in_room(seen.force)]
        slope = state.derivative(w)
        bend = state.derivative(slope)
        for _ in range(4):
            force.append(state.derivative(force[-1]))
        along, square = ((w * v).sum(axis=1, keepdims=True) for v in (slope, w))
        fourth = state.derivative(bend) + np.cross(bend, w) - along * w - 0.5 * square * slope
        return {
            "orientation": turned(-slope),
            "position": triad_column("accel", -in_sensor(force[2])),
            "orientation_fourth": turned(fourth),
            "position_fourth": triad_column("accel", in_sensor(force[4])),
        }


EFFECT = ReferenceSmoothing()
