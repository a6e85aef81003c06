"""The sensor's error model: the one forward model, and its inverse.

``measured = (I + S + M) @ true + bias + further terms + noise``, for each triad. Terms of the setup
(a lever arm) are part of what is true where the sensor is: see `SensorModel.felt`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.effects import get_effect
from calib.effects.base import Effect, Signals, State, Term, TransformEffect
from calib.effects.observed import observed
from calib.recording import AXES
from calib.types import FloatArray

CHUNK = 8192
"""Samples at a time: they stay in the cache, and are too few for BLAS to wake its threads."""

PARAMETER_UNITS = {
    "accel.bias": "m/s²",
    "gyro.bias": "rad/s",
    "accel.scale_factor_error": "1",
    "gyro.scale_factor_error": "1",
    "accel.misalignment": "rad",
    "gyro.misalignment": "rad",
}


@dataclass(frozen=True, eq=False)
class Triad:
    """Bias (3,), scale factor error (3,) and misalignment (3, 3) of one triad of axes."""

    bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    scale_factor_error: FloatArray = field(default_factory=lambda: np.zeros(3))
    misalignment: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        for name, shape in (
            ("bias", (3,)),
            ("scale_factor_error", (3,)),
            ("misalignment", (3, 3)),
        ):
            value = np.array(getattr(self, name), np.float64)
            if value.shape != shape:
                raise ValueError(f"`{name}` must be {shape}, got {value.shape}")
            if not np.isfinite(value).all():
                raise ValueError(f"`{name}` must be finite, got {value}")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        if np.diag(self.misalignment).any():
            raise ValueError("`misalignment` must have a zero diagonal (that is the scale factor)")

    @classmethod
    def from_matrix(cls, matrix: FloatArray, bias: FloatArray) -> Triad:
        """Return the triad whose ``I + S + M`` is `matrix`."""
        matrix = np.asarray(matrix, np.float64)
        diagonal = np.diag(matrix)
        return cls(np.asarray(bias), diagonal - 1.0, matrix - np.diag(diagonal))

    @property
    def matrix(self) -> FloatArray:
        """``I + S + M``, (3, 3)."""
        return np.eye(3) + np.diag(self.scale_factor_error) + self.misalignment

    def distort(self, true: FloatArray) -> FloatArray:
        """Return ``(I + S + M) @ true + bias`` for (n, 3) vectors."""
        return affine(self.matrix, true, self.bias)

    def correct(self, measured: FloatArray) -> FloatArray:
        """Return ``inv(I + S + M) @ (measured - bias)`` for (n, 3) vectors."""
        inverse = np.asarray(np.linalg.inv(self.matrix), np.float64)
        return affine(inverse, measured, -inverse @ self.bias)

    def parameters(self, triad: str) -> dict[str, float]:
        """Return all twelve parameters by their full names; `triad` is ``accel`` or ``gyro``."""
        out = {f"{triad}.bias.{a}": float(v) for a, v in zip(AXES, self.bias, strict=True)}
        for a, v in zip(AXES, self.scale_factor_error, strict=True):
            out[f"{triad}.scale_factor_error.{a}"] = float(v)
        for i, a in enumerate(AXES):
            for j, b in enumerate(AXES):
                if i != j:
                    out[f"{triad}.misalignment.{a}{b}"] = float(self.misalignment[i, j])
        return out

    def with_parameters(self, values: Mapping[str, float]) -> Triad:
        """Return a copy with some parameters replaced; names as in `parameters`, triad ignored."""
        bias, scale = self.bias.copy(), self.scale_factor_error.copy()
        misalignment = self.misalignment.copy()
        for name, value in values.items():
            _, group, index = name.split(".")
            place = tuple(AXES.index(letter) for letter in index)
            if group == "bias":
                bias[place] = value
            elif group == "scale_factor_error":
                scale[place] = value
            else:
                misalignment[place] = value
        return Triad(bias, scale, misalignment)


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Everything systematic about one IMU: two triads and the further terms.

    Further terms that add to the signals are functions of the true state; those that transform
    the signals (a delay, a low-pass) act afterwards, in the order in which they stand.
    """

    accel: Triad = field(default_factory=Triad)
    gyro: Triad = field(default_factory=Triad)
    terms: tuple[Term, ...] = ()
    reference_temperature: float = 25.0

    def __post_init__(self) -> None:
        for term in self.terms:
            get_effect(term.effect).check(term.parameters)

    @property
    def is_prompt(self) -> bool:
        """Whether a sample depends on what is sensed then and there: no delay, no low-pass."""
        return not self._transforms("signal")

    def distort(self, state: State, noise: Signals | None = None, *, every: int = 1) -> Signals:
        """Return what the sensor would measure in the true `state`.

        ``noise`` is added to the finished signal before it is read out (clipped, rounded). Samples
        are taken at ``every`` so many of the state's times: what is late, or passed a low-pass, is
        that of the motion, of which samples may tell less.
        """
        state = self.felt(replace(state, reference_temperature=self.reference_temperature))
        accel = self.accel.distort(state.force)
        gyro = self.gyro.distort(state.rate)
        signals = self._add(Signals(accel, gyro), state, sign=1.0, setup=False)
        for effect, parameters in self._transforms("signal"):
            signals = effect.transform(state.time, signals, parameters)
        time = state.time[::every]
        signals = Signals(signals.accel[::every], signals.gyro[::every])
        if noise is not None:
            signals = Signals(signals.accel + noise.accel, signals.gyro + noise.gyro)
        for effect, parameters in self._transforms("readout"):
            signals = effect.transform(time, signals, parameters)
        return signals

    def ahead(self, time: FloatArray) -> int:
        """Return how many samples at the end of (n,) times `distort` has no input for.

        They would show what is after the end: samples before them are gone, or the clock is slow.
        """
        found = (*self._transforms("signal"), *self._transforms("readout"))
        return sum(effect.ahead(parameters, time=time) for effect, parameters in found)

    def with_terms_moved(self, steps: Mapping[str, float]) -> SensorModel:
        """Return the model with parameters of its further terms moved, by their full names."""
        terms = []
        for term in self.terms:
            values = dict(term.parameters)
            for name, step in steps.items():
                effect, parameter = name.split(".")
                if effect == term.effect:
                    values[parameter] = values.get(parameter, 0.0) + step
            terms.append(Term(term.effect, values))
        return replace(self, terms=tuple(terms))

    def felt(self, state: State) -> State:
        """Return the true state where the sensor is, from that where the setup was said to be.

        A lever arm, or a leaning vertical, changes what there is to feel: the errors of the sensor
        act on it as on all else.
        """
        if not any(self._additive(setup=True)):
            return state
        felt = self._add(Signals(state.force, state.rate), state, sign=1.0, setup=True)
        return replace(state, force=felt.accel, rate=felt.gyro)

    def correct(self, measured: State, *, iterations: int = 12) -> Signals:
        """Return the true signals from the measured ones: the inverse of `distort`.

        Parameters
        ----------
        measured : State
            With the measured signals as ``force`` and ``rate``. Vibration and the time since the
            last turn are found from them where they are not given.
        iterations : int
            At most so many of the fixed point ``true = K (measured - bias - terms(true))``. Each
            gains a factor of the terms' size relative to the signal; it ends when nothing moves by
            more than 10⁻¹⁰ of the largest signal.
        """
        signals = Signals(measured.force, measured.rate)
        for stage in ("readout", "signal"):
            for effect, parameters in reversed(self._transforms(stage)):
                signals = effect.inverse(measured.time, signals, parameters)
        accel, gyro = self.accel.correct(signals.accel), self.gyro.correct(signals.gyro)
        additive = [*self._additive(setup=True), *self._additive(setup=False)]
        if not additive:
            return Signals(accel, gyro)
        reads = {name for effect, _ in additive for name in effect.reads}
        measured = replace(
            measured, force=accel, rate=gyro, reference_temperature=self.reference_temperature
        )
        measured = observed(measured, reads)
        for _ in range(iterations):
            true = replace(measured, force=accel, rate=gyro)
            left = self._add(signals, self.felt(true), sign=-1.0, setup=False)
            before = accel, gyro
            here = Signals(self.accel.correct(left.accel), self.gyro.correct(left.gyro))
            accel, gyro = self._add(here, true, sign=-1.0, setup=True)
            if _settled(before[0], accel) and _settled(before[1], gyro):
                break
        return Signals(accel, gyro)

    def _transforms(self, stage: str) -> list[tuple[TransformEffect, Mapping[str, float]]]:
        found = ((get_effect(t.effect), t.parameters) for t in self.terms)
        return [(e, p) for e, p in found if isinstance(e, TransformEffect) and e.stage == stage]

    def _additive(self, *, setup: bool) -> Iterator[tuple[Effect, Mapping[str, float]]]:
        """Yield the terms that add: those of the setup, or those of the sensor."""
        found = ((get_effect(t.effect), t.parameters) for t in self.terms)
        for effect, parameters in found:
            if not isinstance(effect, TransformEffect) and (effect.kind == "setup") == setup:
                yield effect, parameters

    def _add(self, signals: Signals, state: State, *, sign: float, setup: bool) -> Signals:
        accel, gyro = signals.accel.copy(), signals.gyro.copy()
        for effect, parameters in self._additive(setup=setup):
            for channel, values in effect.contribution(state, parameters).items():
                triad, axis = channel.split(".")
                (accel if triad == "accel" else gyro)[:, AXES.index(axis)] += sign * values
        return Signals(accel, gyro)


def _settled(before: FloatArray, after: FloatArray) -> bool:
    return bool(np.abs(after - before).max() <= 1e-10 * max(1.0, np.abs(after).max()))


def affine(matrix: FloatArray, vectors: FloatArray, offset: FloatArray) -> FloatArray:
    """Return ``vectors @ matrix.T + offset`` for (n, 3) vectors, channel by channel in memory.

    That is eight times faster than row by row, and `CHUNK` keeps it in the cache.
    """
    columns = np.empty((3, len(vectors)))
    for at in range(0, len(vectors), CHUNK):
        part = columns[:, at : at + CHUNK]
        np.matmul(matrix, vectors[at : at + CHUNK].T, out=part)
        part += offset[:, None]
    return columns.T
