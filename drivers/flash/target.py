"""What a flash target is: a device that holds corrections of its own, and how they act.

A device's corrections change its output from ``m`` to ``m' = A m + d``, for each triad. A chip's
bias registers give ``A = 1`` and a shift ``d``; an autopilot's scale a diagonal ``A``; a full 3x3
correction any ``A``. The calibration's model ``m = (I + S + M) t + b`` becomes
``m' = A (I + S + M) t + (A b + d)``, which is what is left for ``apply``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import ClassVar, Self

import numpy as np

from calib.calibration import Calibration
from calib.recording import DeviceInfo, Recording
from calib.types import FloatArray

Native = dict[str, float]
"""What a device holds, by its own names, in its own units; whole registers are whole numbers."""


@dataclass(frozen=True)
class Row:
    """One value of the plan, as the user sees it. ``wanted`` is before rounding and clipping."""

    name: str
    parameter: str
    old: float
    new: float
    wanted: float
    unit: str
    clipped: bool = False
    note: str = ""


@dataclass(frozen=True, eq=False)
class Action:
    """How new values change a triad's output: ``m' = matrix @ m + shift``."""

    matrix: FloatArray = field(default_factory=lambda: np.eye(3))
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __call__(self, vectors: FloatArray) -> FloatArray:
        """Return what (n, 3) outputs would have been."""
        return np.asarray(vectors @ self.matrix.T + self.shift)


@dataclass(frozen=True, eq=False)
class Plan:
    """What is to be written, and what it will do."""

    rows: tuple[Row, ...]
    new: Native
    accel: Action
    gyro: Action
    cannot_hold: tuple[str, ...] = ()
    """Determined parameters that stay with ``apply``, by name."""

    @property
    def changes(self) -> bool:
        """Whether anything would be written that is not there already."""
        return any(row.old != row.new for row in self.rows)


class Target(ABC):
    """A device to flash. `open` first; every method may raise a DriverError."""

    name: ClassVar[str]
    volatile: ClassVar[bool] = True
    """Whether the values are lost at power-off, unless they are persisted."""
    can_persist: bool = False
    always_stored: ClassVar[bool] = False
    """Whether a value is stored as soon as it is set, so that flashing needs ``--persist``."""
    persist_note: ClassVar[str] = ""
    """What the user should know while it stores."""

    def __init__(self, address: str) -> None:
        self.address = address

    @property
    @abstractmethod
    def info(self) -> DeviceInfo:
        """Who the device says it is."""

    @abstractmethod
    def open(self) -> None:
        """Connect."""

    @abstractmethod
    def close(self) -> None:
        """Let go; closing twice is harmless."""

    @abstractmethod
    def read(self) -> Native:
        """Return everything that `write` may change, as the device holds it now."""

    @abstractmethod
    def plan(self, old: Native, calibration: Calibration) -> Plan:
        """Return what to write so that the device's output needs no correction, as far as it can.

        Parameters that the calibration does not determine are left as they are.
        """

    @abstractmethod
    def write(self, values: Mapping[str, float]) -> None:
        """Write values; others, and reserved bits, stay as they are."""

    @abstractmethod
    def measure(self, duration: float) -> Recording:
        """Record `duration` seconds, beginning after what was written last has taken effect."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def persist(self) -> None:
        """Store what is set in non-volatile memory."""
        raise NotImplementedError(f"{self.name} stores nothing")

    def restart(self) -> None:
        """Restart the device and connect again."""
        raise NotImplementedError(f"{self.name} has no restart")

    def snippet(self, values: Mapping[str, float]) -> str:
        """Return what an application must run after power-on ('' if nothing)."""
        return ""


def determined_bias(calibration: Calibration, triad: str) -> FloatArray:
    """Return a triad's bias (3,), NaN where the calibration does not determine it."""
    values = calibration.values
    names = [f"{triad}.bias.{axis}" for axis in "xyz"]
    return np.array([values[n] if n in calibration.names else np.nan for n in names])


def not_held(calibration: Calibration, held: set[str]) -> tuple[str, ...]:
    """Return the determined parameters whose groups are not among those that a device holds."""
    return tuple(name for name in calibration.names if name.rsplit(".", 1)[0] not in held)
