"""What a solver is: a name, a line of help, and a function that returns a `Fit`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from calib.fit import Fit
from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.turns import Turns


class SolveAccel(Protocol):
    """Solve the accelerometer's triad from static poses and |a| = gravity (m/s²)."""

    def __call__(self, poses: Poses, *, gravity: float) -> Fit: ...


class SolveGyro(Protocol):
    """Solve the gyroscope's triad from turns between poses.

    ``accel`` is the accelerometer's calibration. ``options`` holds what a method needs beyond the
    recording (``table_rate``); a method that lacks one raises ValueError naming it.
    """

    def __call__(
        self,
        recording: Recording,
        poses: Poses,
        turns: Turns,
        accel: Triad,
        *,
        gravity: float,
        options: Mapping[str, object],
    ) -> Fit: ...


@dataclass(frozen=True)
class AccelSolver:
    """An accelerometer method, as ``--accel-method`` offers it."""

    name: str
    summary: str
    solve: SolveAccel


@dataclass(frozen=True)
class GyroSolver:
    """A gyroscope method, as ``--gyro-method`` offers it."""

    name: str
    summary: str
    solve: SolveGyro
