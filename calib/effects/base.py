"""What an effect is: its equation, its parameters, and how it changes the signals.

Two kinds change signals in two ways:

- An `Effect` adds ``sum_k p_k * column_k(state)`` to the measured signals. The columns are
  functions of the *true* state, linear in the parameters once the shape parameters (a time
  constant, a moment) are fixed.
- A `TransformEffect` acts on the finished signals (a delay, a low-pass, rounding). It also gives
  columns: its derivative with respect to each parameter at zero, which is how it is detected.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from calib.types import FloatArray

EffectKind = Literal["sensor", "event", "setup"]
"""A ``sensor`` term belongs in the calibration; an ``event`` happened once in this recording; a
``setup`` term belongs to the fixture or the reference."""


class Signals(NamedTuple):
    """A pair of (n, 3) arrays: accelerometer in m/s², gyroscope in rad/s."""

    accel: FloatArray
    gyro: FloatArray


@dataclass(frozen=True)
class Parameter:
    """A parameter that enters linearly.

    ``typical`` is the size that a consumer part has, in ``unit``; it sets the prior.
    """

    name: str
    unit: str
    typical: float
    channels: tuple[str, ...]


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter that enters nonlinearly, searched between ``low`` and ``high``.

    ``spacing`` is how candidates are spread: ``log`` for time constants, ``linear`` for moments.
    Bounds of None mean the recording's own span.
    """

    name: str
    unit: str
    low: float | None
    high: float | None
    spacing: Literal["log", "linear"] = "log"


@dataclass(frozen=True, eq=False)
class State:
    """The true state that effects are functions of, on (n,) times; everything in SI and frame s.

    Parameters
    ----------
    time : (n,) array, s
    force, rate : (n, 3) arrays
        Specific force (m/s²) and angular rate (rad/s).
    temperature : (n,) array, °C, or None
        None where it was not measured: effects of temperature then have no columns.
    reference_temperature : float, °C
        What temperature terms are relative to.
    power_on : float, s
        The moment that warm-up is counted from.
    since_turn : (n,) array, s, or None
        Time since the last turn ended; NaN or large before the first.
    mat_ns : (n, 3, 3) array or None
        Orientation, where it is known; ``earth_rate`` needs it.
    latitude : float, rad, or None
    vibration : (n, 3) array, (m/s²)², or None
        Short-time variance of the specific force.
    """

    time: FloatArray
    force: FloatArray
    rate: FloatArray
    temperature: FloatArray | None = None
    reference_temperature: float = 25.0
    power_on: float = 0.0
    since_turn: FloatArray | None = None
    mat_ns: FloatArray | None = None
    latitude: float | None = None
    vibration: FloatArray | None = None

    def derivative(self, values: FloatArray) -> FloatArray:
        """Return the time derivative by second-order differences on uneven times."""
        if len(self.time) < 3:
            return np.zeros_like(values)
        return np.gradient(values, self.time, axis=0)

    @cached_property
    def force_dot(self) -> FloatArray:
        """Time derivative of the specific force, m/s³."""
        return self.derivative(self.force)

    @cached_property
    def rate_dot(self) -> FloatArray:
        """Angular acceleration, rad/s²."""
        return self.derivative(self.rate)

    @cached_property
    def warmth(self) -> FloatArray | None:
        """Temperature minus the reference, K."""
        if self.temperature is None:
            return None
        return self.temperature - self.reference_temperature

    @cached_property
    def temperature_rate(self) -> FloatArray | None:
        """Rate of temperature, K/s."""
        return None if self.temperature is None else self.derivative(self.temperature)


class Effect(ABC):
    """Physics that baseline leaves out. Subclasses set the class attributes and `columns`."""

    slug: str
    """Name in the catalogue, in files and in JSON."""
    title: str
    """A few words, for tables."""
    equation: str
    """The term, as it is added to the measured signals."""
    source: str
    """Where the equation and the typical size come from."""
    kind: EffectKind = "sensor"
    parameters: tuple[Parameter, ...]
    shape: tuple[ShapeParameter, ...] = ()
    needs: str
    """What a recording must contain for the effect to be identified."""
    sentence: str
    """What a technician reads when it was found."""

    @abstractmethod
    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Signals]:
        """Return, for each linear parameter, what one unit of it adds to the signals.

        An empty dict means that the state lacks what the effect is a function of (no temperature).
        """

    def contribution(self, state: State, parameters: Mapping[str, float]) -> Signals:
        """Return what the effect adds to the measured signals, with these parameters."""
        accel, gyro = np.zeros_like(state.force), np.zeros_like(state.rate)
        shape = {item.name: parameters[item.name] for item in self.shape}
        for name, column in self.columns(state, shape).items():
            value = parameters.get(name, 0.0)
            if value:
                accel += value * column.accel
                gyro += value * column.gyro
        return Signals(accel, gyro)


class TransformEffect(Effect):
    """An effect that acts on the finished signals rather than adding to them."""

    @abstractmethod
    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Return the signals with the effect in them."""

    @abstractmethod
    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Return the signals with the effect taken out, as far as that is possible."""


@dataclass(frozen=True)
class Term:
    """One effect with its values: a part of a sensor model.

    ``parameters`` holds linear and shape parameters by name, in the units of the effect's file.
    """

    effect: str
    parameters: Mapping[str, float] = field(default_factory=dict)
