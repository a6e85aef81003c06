"""Signals at other times, and the parts that only some triads have: helpers of the transforms."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from calib.effects.base import Column, Signals, State
from calib.recording import AXES
from calib.spline import spline_at
from calib.types import FloatArray

FURTHER = 5.0
"""Intervals beyond the first and the last sample that a signal is continued; then it is held."""


def resample(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return (n, ...) values at other times, by cubic spline.

    Beyond the two ends it is continued by a parabola, for some samples: who begins or ends in a
    motion would otherwise see it stop.
    """
    if len(time) < 4:
        index = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
        held: FloatArray = values[index]
        return held
    flat = values.reshape(len(time), -1)
    out = spline_at(time, flat, np.clip(at, time[0], time[-1]))
    for end, inner, further in ((0, 1, 2), (-1, -2, -3)):
        step, before = time[end] - time[inner], time[inner] - time[further]
        since = np.clip((at - time[end]) / step, 0.0, FURTHER)
        beyond = since > 0
        if beyond.any():
            chord = (flat[end] - flat[inner]) / step
            bend = (chord - (flat[inner] - flat[further]) / before) / (step + before)
            past = (since[beyond] * step)[:, None]
            out[beyond] = flat[end] + past * (chord + (step + past) * bend)
    return out.reshape(-1, *values.shape[1:])


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
