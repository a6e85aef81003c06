"""The plot that convinced: residual against what a finding follows, before and after.

So does what is unexplained: where it is in time, or against what it follows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.mismatch.rows.rows import Kind, Rows
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray

MOST_SERIES = 3
MOST_POINTS = 1500

TIME = "time"

SEEN = 0.1
"""Scatter that goes from rests, in parts of what is left, from which one sees it there."""


@dataclass(frozen=True, eq=False)
class Series:
    """Residuals (n,) of one kind of rows, before and after, over ``x``."""

    channel: str
    x: FloatArray
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True, eq=False)
class Evidence:
    """Residuals in ``unit`` against ``follows`` in ``x_unit``."""

    follows: str
    x_unit: str
    unit: str
    series: tuple[Series, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the evidence as JSON."""
        return {
            "follows": self.follows,
            "x_unit": self.x_unit,
            "unit": self.unit,
            "series": [
                {
                    "channel": item.channel,
                    "x": item.x.tolist(),
                    "before": item.before.tolist(),
                    "after": item.after.tolist(),
                }
                for item in self.series
            ],
        }


def gather(
    rows: Rows,
    follows: str,
    predicted: FloatArray,
    before: FloatArray,
    after: FloatArray,
    *,
    on: tuple[str, ...] = (),
) -> Evidence | None:
    """Return what to plot of what follows something; None if no row shows it.

    Parameters
    ----------
    follows : str
        As an effect has it; `TIME` for what has a place in time.
    predicted : (m,) array
        What it adds to each row.
    before, after : (m,) arrays
        Residuals of the fits without and with it.
    on : tuple of str
        Channels that are plotted at rest, if it is `SEEN` there, instead of what shows it best.
    """
    groups = _groups(rows)
    # How much of each group's scatter the effect takes away, in parts of what is left.
    gain = {
        name: _gain(before[own], after[own])
        for name, (own, _) in groups.items()
        if np.abs(predicted[own]).max(initial=0.0) > 0
    }
    if not gain:
        return None
    if max((gain[name] for name in on if name in gain), default=0.0) > SEEN:
        gain = {name: value for name, value in gain.items() if name in on}
    best = max(gain, key=lambda name: gain[name])
    unit = groups[best][1]
    alike = [n for n in gain if groups[n][1] == unit and gain[n] > 0.1 * gain[best]]
    alike = sorted(alike, key=lambda n: -gain[n])[:MOST_SERIES]
    label, x_unit, x = _abscissa(rows, follows, predicted, unit, at_rest=best in CHANNELS)
    series = []
    for name in alike:
        own = np.flatnonzero(groups[name][0])[:MOST_POINTS]
        series.append(Series(name, x[own], before[own], after[own]))
    return Evidence(label, x_unit, unit, tuple(series))


def _gain(before: FloatArray, after: FloatArray) -> float:
    left = float(np.mean(after**2))
    return (float(np.mean(before**2)) - left) / max(left, 1e-300)


def _groups(rows: Rows) -> Mapping[str, tuple[BoolArray, str]]:
    """Return the rows of each channel at rest, and of each kind of closure, with their unit."""
    out = {}
    for c, name in enumerate(CHANNELS):
        own = (rows.kind == Kind.MEAN) & (rows.channel == c)
        if own.any():
            out[name] = (own, "m/s²" if c < 3 else "rad/s")
    for kind, name, unit in (
        (Kind.ATTITUDE, "attitude after turns", "rad"),
        (Kind.VELOCITY, "velocity after turns", "m/s"),
    ):
        own = rows.kind == kind
        if own.any():
            out[name] = (own, unit)
    return out


def _abscissa(
    rows: Rows, follows: str, predicted: FloatArray, unit: str, *, at_rest: bool
) -> tuple[str, str, FloatArray]:
    """Return label, unit and values (m,) of what is followed, for each row."""
    state = rows.state
    if follows.startswith(TIME) and follows != "time since the last turn":
        return TIME, "s", rows.interval.mean(axis=1)[rows.segment]
    known: dict[str, tuple[str, FloatArray | None]] = {
        "temperature": ("°C", state.temperature),
        "rate of temperature": ("K/s", state.temperature_rate),
        "time since the last turn": ("s", state.since_turn),
    }
    if at_rest and follows in known:
        x_unit, values = known[follows]
        if values is not None:
            return follows, x_unit, _means(rows, np.nan_to_num(values, posinf=0.0))
    return f"what it predicts ({follows})", unit, predicted


def _means(rows: Rows, values: FloatArray) -> FloatArray:
    """Return the mean of (n,) values over the points of each row at rest; 0 for other rows."""
    out = np.zeros(len(rows.residual))
    for c in range(len(CHANNELS)):
        own = (rows.kind == Kind.MEAN) & (rows.channel == c)
        if own.any():
            out[own] = (rows.functional[c] @ values)[own]
    return out
