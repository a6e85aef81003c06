"""What a recording is compared with: the signals of another one, or of a captured motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from calib.effects.base import State
from calib.recording import Recording
from calib.rotation import mat_from_quat
from calib.simulation.bridges import LONG_STEP as LONG_STEP
from calib.simulation.through import DEGREE as DEGREE
from calib.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

MISSING, UNEVEN = 1.5, 0.01
"""Intervals from which on something is missing in a step, and the scatter of the others, of an
interval, from which on times are not even."""

GAP = 3.5
"""Sample intervals over which a truth is interpolated; beyond, it is not known."""

ENDS = 8
"""Samples at either end through which an interpolating spline is loose, as nothing holds it beyond:
what ends within a turn would be off there by more than noise."""

REACH = 2
"""Samples about a spoilt one at which an interpolating spline still feels it."""


def near(known: FloatArray, time: FloatArray, limit: float | None = None) -> BoolArray:
    """Return where times lie between known ones that are no gap apart, (n,) bool.

    A gap is longer than `limit`, s: of `GAP` intervals if that is not given.
    """
    if len(known) < 2:
        return np.zeros(len(time), bool)
    if limit is None:
        limit = GAP * float(np.median(np.diff(known)))
    after = np.clip(np.searchsorted(known, time), 1, len(known) - 1)
    inside = (time >= known[0]) & (time <= known[-1])
    return np.asarray(inside & (known[after] - known[after - 1] <= limit))


def is_uneven(time: FloatArray) -> bool:
    """Whether samples that follow each other, none of them missing, do so at uneven steps."""
    step = np.diff(time)
    own = step[step < MISSING * np.median(step)]
    return bool(own.std() > UNEVEN * own.mean())


@dataclass(frozen=True, eq=False)
class RecordingTruth:
    """The signals of another recording: of a simulated sensor, or of one on the same body.

    ``spoilt`` marks samples that are not to be believed (clipped). ``quat`` (n, 4) are orientations
    ``mat_ns``, where they are known; neighbours have one sign. ``gradient`` (n, 3, 3) is that of
    the motion, where the signals themselves do not tell it (`State.known_gradient`). Unless it is
    ``placed``, its forces are those of a body at rest: where its point moved nobody knows.
    """

    recording: Recording
    gravity: float
    spoilt: BoolArray | None = None
    quat: FloatArray | None = None
    gradient: FloatArray | None = None
    placed: bool = True
    _good: FloatArray = field(init=False)
    _spline: BSpline = field(init=False)
    _rate: BSpline = field(init=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import BSpline, make_interp_spline  # a tenth of a second to import

        r = self.recording
        good = np.ones(len(r), bool)
        if self.spoilt is not None:
            good = np.convolve(self.spoilt, np.ones(2 * REACH + 1), mode="same") < 0.5
        signals = [r.accel, r.gyro]
        signals += [] if self.gradient is None else [self.gradient.reshape(-1, 9)]
        signals += [] if self.quat is None else [self.quat]
        object.__setattr__(self, "_good", r.time[good])
        # Through all samples: a clipped one is nearer to the truth than what a spline makes of a
        # hole.
        spline = make_interp_spline(r.time, np.hstack(signals), k=DEGREE)
        object.__setattr__(self, "_spline", spline)
        object.__setattr__(self, "_rate", BSpline(spline.t, spline.c[:, 3:6], DEGREE))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.recording.time[0]), float(self.recording.time[-1])

    def covers(self, time: FloatArray) -> BoolArray:
        """Return where the recording has samples enough on either side, (n,) bool."""
        edge = min(ENDS, (len(self.recording) - 1) // 2)
        first, last = self.recording.time[[edge, -1 - edge]]
        return np.asarray(near(self._good, time) & (time >= first) & (time <= last))

    def state(self, time: FloatArray) -> State:
        """Return what was measured as the true state, its angular acceleration by spline."""
        inside = np.clip(time, *self.span)
        values = self._spline(inside)
        quat = values[:, -4:]
        return State(
            time,
            values[:, :3],
            values[:, 3:6],
            mat_ns=None
            if self.quat is None
            else mat_from_quat(quat / np.linalg.norm(quat, axis=1, keepdims=True)),
            angular_acceleration=self._rate(inside, nu=1),
            gravity=self.gravity,
            known_gradient=None if self.gradient is None else values[:, 6:15].reshape(-1, 3, 3),
        )
