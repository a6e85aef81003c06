"""The digital twin of a recording: the sensor model and the attitudes that reproduce it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.effects import get_effect
from calib.effects.base import State
from calib.mismatch.rows.closure import across
from calib.mismatch.rows.grid import Grid
from calib.mismatch.twin.heading import orient
from calib.mismatch.twin.undone import acts_on_turns, undone
from calib.model import SensorModel
from calib.recording import AXES
from calib.types import FloatArray

ACCEL_MISALIGNMENT = ("yx", "zx", "zy")
GYRO_MISALIGNMENT = ("xy", "xz", "yx", "yz", "zx", "zy")


@dataclass(frozen=True, eq=False)
class Twin:
    """A sensor model, and the unit vector up in frame s at each rest (k, 3).

    Where a recording says nothing the model is as that of the ``expected`` sensor.
    """

    model: SensorModel
    up: FloatArray
    full_gyro: bool
    gravity: float
    expected: SensorModel

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the baseline's parameters, in the order of their columns."""
        names = [f"accel.bias.{a}" for a in AXES]
        names += [f"accel.scale_factor_error.{a}" for a in AXES]
        names += [f"accel.misalignment.{p}" for p in ACCEL_MISALIGNMENT]
        names += [f"gyro.bias.{a}" for a in AXES]
        names += [f"gyro.scale_factor_error.{a}" for a in AXES]
        if self.full_gyro:
            names += [f"gyro.misalignment.{p}" for p in GYRO_MISALIGNMENT]
        return tuple(names)

    def unexpected(self) -> FloatArray:
        """Return how far the baseline's parameters are from those of the expected sensor, (p,)."""
        now, expected = (
            {**model.accel.parameters("accel"), **model.gyro.parameters("gyro")}
            for model in (self.model, self.expected)
        )
        return np.array([now[name] - expected[name] for name in self.names])

    def moved(self, step: Mapping[str, float], angles: FloatArray) -> Twin:
        """Return the twin with baseline parameters and attitudes (k, 2) moved."""
        triads = []
        for name, triad in (("accel", self.model.accel), ("gyro", self.model.gyro)):
            now = triad.parameters(name)
            new = {k: now[k] + v for k, v in step.items() if k in now}
            triads.append(triad.with_parameters(new))
        up = self.up + np.einsum("kij,kj->ki", across(self.up), angles)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        return replace(self, model=replace(self.model, accel=triads[0], gyro=triads[1]), up=up)


def true_state(grid: Grid, twin: Twin, *, headed: bool = True) -> State:
    """Return the true state on the grid: at rest exactly so, in turns as the twin corrects it.

    Its headings are left out unless they are wanted, or the model has terms that go with them.
    """
    signals = undone(grid, twin.model.terms)
    model = replace(
        twin.model, terms=tuple(term for term in twin.model.terms if not acts_on_turns(term))
    )
    measured = State(
        time=grid.time,
        force=signals.accel,
        rate=signals.gyro,
        temperature=grid.temperature,
        reference_temperature=twin.model.reference_temperature,
        power_on=grid.began,
        since_turn=grid.since_turn,
        turning=grid.turning,
        vibration=grid.vibration,
        temperature_slope=grid.temperature_slope,
        gravity=twin.gravity,
        length=grid.length,
    )
    corrected = model.correct(measured)
    felt = any("mat_ns" in get_effect(term.effect).reads for term in model.terms)
    if headed or felt:
        measured = replace(measured, mat_ns=orient(grid, twin.up, corrected.gyro))
    if felt:
        corrected = model.correct(measured)
    pose = grid.pose
    rest = pose >= 0
    force, rate = corrected.accel.copy(), corrected.gyro.copy()
    force[rest] = twin.gravity * twin.up[pose[rest]]
    rate[rest] = 0.0
    return replace(measured, force=force, rate=rate)


def baseline_column(name: str, state: State) -> dict[str, FloatArray]:
    """Return what one unit of a baseline parameter adds to the signals."""
    triad, group, index = name.split(".")
    values = state.force if triad == "accel" else state.rate
    channel = f"{triad}.{index[0]}"
    if group == "bias":
        return {channel: np.ones(len(values))}
    return {channel: values[:, AXES.index(index[-1])]}
