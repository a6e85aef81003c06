"""The plot that convinced: residual against what a finding follows, before and after.

So does what is unexplained: where it is in time, or against what it follows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.effects.base import Effect
from calib.mismatch.rows.rows import Kind, Rows
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray

MOST_SERIES = 3
MOST_POINTS = 1500

TIME = "time"

SEEN = 0.1
"""Scatter that goes from rests, in parts of what is left, from which one sees it there."""


class Regressor(NamedTuple):
    """What the largest part of an effect is in proportion to.

    ``label`` and ``unit`` as an effect has them, (m,) ``values`` for each row, and the ``channels``
    that it is on.
    """

    label: str
    unit: str
    values: FloatArray
    channels: tuple[str, ...]

    @classmethod
    def of(
        cls, effect: Effect, parameters: Sequence[str], columns: FloatArray, sizes: FloatArray
    ) -> Regressor | None:
        """Return the regressor of an effect, if that is one variable.

        Its ``parameters`` (p,) have these ``sizes``, and one unit of each adds the columns (m, p).
        """
        if not len(parameters):
            return None
        name = parameters[int(np.argmax(np.abs(sizes) * np.linalg.norm(columns, axis=0)))]
        if (regressor := effect.regressor_of(name)) is None:
            return None
        channels = next(p.channels for p in effect.parameters if p.name == name)
        values = columns[:, list(parameters).index(name)]
        return cls(*regressor, values, channels)

    def in_turns(self, unit: str) -> str | None:
        """Return its unit where closures in some unit add it up; None if they show other things."""
        triad = {"rad": "gyro", "m/s": "accel"}[unit]
        if any(c.split(".")[0] != triad for c in self.channels):
            return None
        added = {"rad/s": "rad", "m/s²": "m/s"}
        return added.get(self.unit, f"{self.unit} s")


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
    regressor: Regressor | None = None,
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
    regressor : Regressor, optional
        What its largest part is in proportion to, if that is one variable.
    """
    timed = follows.startswith(TIME) or follows in _known(rows)
    groups = _groups(rows, changes=not timed and not rows.is_rest.any())
    # How much of each group's scatter the effect takes away, in parts of what is left.
    gain = {
        name: _gain(before[own], after[own])
        for name, (own, _) in groups.items()
        if np.abs(predicted[own]).max(initial=0.0) > 0
    }
    if not gain:
        return None
    if regressor is not None and rows.is_rest.any():
        # Where it is seen at rest it is plain: in turns it comes with all that turns do.
        on = on or regressor.channels
    if max((gain[name] for name in on if name in gain), default=0.0) > SEEN:
        gain = {name: value for name, value in gain.items() if name in on}
    best = max(gain, key=lambda name: gain[name])
    unit = groups[best][1]
    alike = [n for n in gain if groups[n][1] == unit and gain[n] > 0.1 * gain[best]]
    alike = sorted(alike, key=lambda n: -gain[n])[:MOST_SERIES]
    label, x_unit, x = _abscissa(rows, follows, predicted, unit, at_rest=best in CHANNELS)
    if x is predicted and regressor is not None:
        in_turns = unit in ("rad", "m/s")
        along = regressor.in_turns(unit) if in_turns else regressor.unit.format(unit=unit)
        shown = [n for n in alike if np.abs(regressor.values[groups[n][0]]).max() > 0]
        if along is not None and best in shown:
            label = f"{regressor.label}, added up over a turn" if in_turns else regressor.label
            x_unit, x, alike = along, regressor.values, shown
    series = []
    for name in alike:
        own = np.flatnonzero(groups[name][0])[:MOST_POINTS]
        series.append(Series(name, x[own], before[own], after[own]))
    return Evidence(label, x_unit, unit, tuple(series))


def _gain(before: FloatArray, after: FloatArray) -> float:
    left = float(np.mean(after**2))
    return (float(np.mean(before**2)) - left) / max(left, 1e-300)


def _groups(rows: Rows, *, changes: bool) -> Mapping[str, tuple[BoolArray, str]]:
    """Return the rows of each channel at rest, and of each kind of closure, with their unit.

    And ``changes`` within windows, if they are wanted: what is fast shows in these.
    """
    out = {}
    for kind, text in ((Kind.MEAN, "{}"), (Kind.CONTRAST, "{}, changes"))[: 1 + changes]:
        for c, name in enumerate(CHANNELS):
            own = (rows.kind == kind) & (rows.channel == c)
            if own.any():
                out[text.format(name)] = (own, "m/s²" if c < 3 else "rad/s")
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
    if follows.startswith(TIME) and follows != "time since the last turn":
        return TIME, "s", rows.interval.mean(axis=1)[rows.segment]
    known = _known(rows)
    if at_rest and follows in known:
        x_unit, values = known[follows]
        if values is not None:
            return follows, x_unit, _means(rows, np.nan_to_num(values, posinf=0.0))
    return f"what it predicts ({follows})", unit, predicted


def _known(rows: Rows) -> Mapping[str, tuple[str, FloatArray | None]]:
    """Return what effects follow that rests have a value of, with its unit."""
    state = rows.state
    return {
        "temperature": ("°C", state.temperature),
        "rate of temperature": ("K/s", state.temperature_rate),
        "time since the last turn": ("s", state.since_turn),
    }


def _means(rows: Rows, values: FloatArray) -> FloatArray:
    """Return the mean of (n,) values over the points of each row at rest; 0 for other rows."""
    out = np.zeros(len(rows.residual))
    for c in range(len(CHANNELS)):
        own = (rows.kind == Kind.MEAN) & (rows.channel == c)
        if own.any():
            out[own] = (rows.functional[c] @ values)[own]
    return out
