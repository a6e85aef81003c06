"""Signals at other times, and the parts that only some triads have: helpers of the transforms."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from calib.effects.base import Column, Signals, State
from calib.recording import AXES
from calib.spline import spline_at
from calib.types import FloatArray


def resample(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return (n, ...) values at other times, by cubic spline; held at the two ends."""
    if len(time) < 4:
        index = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
        held: FloatArray = values[index]
        return held
    flat = spline_at(time, values.reshape(len(time), -1), np.clip(at, time[0], time[-1]))
    return flat.reshape(-1, *values.shape[1:])


def triad_column(triad: str, values: FloatArray) -> Column:
    """Return the column that touches all axes of a triad with (n, 3) values."""
    return {f"{triad}.{a}": values[:, i] for i, a in enumerate(AXES)}


def present(parameters: Mapping[str, float], triad: str, size: str) -> float | None:
    """Return the size of the part of one triad, or None if that triad is untouched.

    It is there if its size is given and its presence is not 0.
    """
    return parameters.get(size) if parameters.get(triad, 1.0) else None


def presence_columns(
    state: State,
    shape: Mapping[str, float],
    size: str,
    change: Callable[[FloatArray, float], FloatArray],
) -> dict[str, Column]:
    """Return the whole change of each triad whose size ``{triad}_{size}`` is in `shape`."""
    out: dict[str, Column] = {}
    for triad, values in (("accel", state.force), ("gyro", state.rate)):
        value = shape.get(f"{triad}_{size}")
        if value is not None:
            out[triad] = triad_column(triad, change(values, value) - values)
    return out


def each_triad(
    signals: Signals,
    parameters: Mapping[str, float],
    size: str,
    change: Callable[[FloatArray, float], FloatArray],
) -> Signals:
    """Return the signals with `change` applied to each triad that the effect touches."""
    out = []
    for triad, values in zip(("accel", "gyro"), signals, strict=True):
        value = present(parameters, triad, f"{triad}_{size}")
        out.append(values if value is None else change(values, value))
    return Signals(*out)
