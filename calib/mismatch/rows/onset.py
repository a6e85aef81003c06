"""The row columns of what begins at a moment, at any moment.

What a step adds does not depend on when it began, but for being nothing before. So rows of later
segments feel all of it and those of earlier ones nothing; those of its own feel the sum over the
points from there on, which is the same sum for every moment: it is made once, from the last point
backwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.effects.base import Column, Effect
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray


class Onset:
    """An effect that acts from its ``moment`` on, on rows that feel their own segment alone.

    Parameters
    ----------
    effect : Effect
        Its one shape parameter is the moment.
    rows : Rows
    """

    def __init__(self, effect: Effect, rows: Rows) -> None:
        # Not the rows themselves: they keep this, and in a circle both would outlive their use.
        self._state, self._point_segment = rows.state, rows.point_segment
        length = rows.state.length
        self._end = rows.state.time + (0.0 if length is None else 0.5 * length)
        self._segment, self._functional = rows.segment, rows.functional
        self._signals = effect.columns(rows.state, {"moment": -np.inf})
        self._whole = {name: rows.column(signals) for name, signals in self._signals.items()}
        # The middle of each segment, which is tried first: as each row feels its own segment alone,
        # the sums of all of them are one product.
        self._middle = rows.interval.mean(axis=1)
        later = rows.state.since(self._middle[self._point_segment])
        self._half = {
            name: rows.column({c: values * later for c, values in signals.items()})
            for name, signals in self._signals.items()
        }
        self._tables: dict[int, tuple[IntArray, int, dict[str, FloatArray]]] = {}

    def columns(self, moment: float) -> dict[str, FloatArray]:
        """Return what one unit of each parameter adds to the rows, (m,)."""
        point = int(np.searchsorted(self._end, moment))
        if point == len(self._end):
            return {name: np.zeros(len(whole)) for name, whole in self._whole.items()}
        segment = int(self._point_segment[point])
        later = self._segment > segment
        out = {name: np.where(later, whole, 0.0) for name, whole in self._whole.items()}
        if moment == self._middle[segment]:
            own = self._segment == segment
            for name, half in self._half.items():
                out[name][own] = half[own]
            return out
        own, first, tables = self._of(segment)
        share = float(self._state.since(moment)[point])
        for name, table in tables.items():
            own_point, rest = table[:, point - first], table[:, point - first + 1]
            out[name][own] = rest + share * (own_point - rest)
        return out

    def _of(self, segment: int) -> tuple[IntArray, int, dict[str, FloatArray]]:
        """Return a segment's rows, its first point, and sums from each point on, and of none."""
        if segment not in self._tables:
            own = np.flatnonzero(self._segment == segment)
            first, last = np.searchsorted(self._point_segment, (segment, segment + 1)).tolist()
            channels = {c for signals in self._signals.values() for c in signals}
            felt = {
                c: _dense(self._functional[CHANNELS.index(c)], own, first, last) for c in channels
            }
            sums = {
                name: _from_each_on(_each(felt, signals, first, last))
                for name, signals in self._signals.items()
            }
            self._tables[segment] = own, first, sums
        return self._tables[segment]


def _dense(functional: Any, rows: IntArray, first: int, last: int) -> FloatArray:
    """Return some rows of a sparse matrix that are zero but in columns ``[first, last)``."""
    begins = functional.indptr[rows]
    number = functional.indptr[rows + 1] - begins
    at = np.repeat(begins - np.cumsum(number) + number, number) + np.arange(number.sum())
    out = np.zeros((len(rows), last - first))
    out[np.repeat(np.arange(len(rows)), number), functional.indices[at] - first] = functional.data[
        at
    ]
    return out


def _each(felt: Mapping[str, FloatArray], signals: Column, first: int, last: int) -> FloatArray:
    """Return what each point of a segment adds to its rows, (rows, points)."""
    return np.asarray(sum(felt[name] * values[first:last] for name, values in signals.items()))


def _from_each_on(values: FloatArray) -> FloatArray:
    """Return sums of (rows, n) values from each of the n on, and at the end of none."""
    sums = np.zeros((len(values), values.shape[1] + 1))
    sums[:, :-1] = np.cumsum(values[:, ::-1], axis=1)[:, ::-1]
    return sums
