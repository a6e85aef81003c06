"""Delays and filters of a model, taken out of the turns of a grid.

They change nothing at rest, of which the grid keeps a few means. Between those and the samples of a
turn a spline would follow the noise of the first of these far into the rest: what a turn begins and
ends with is put beside it sample by sample instead.
"""

from __future__ import annotations

import numpy as np

from calib.effects import get_effect
from calib.effects.base import Signals, Term, TransformEffect
from calib.mismatch.rows.grid import Grid
from calib.mismatch.rows.restored import settle
from calib.types import FloatArray


def acts_on_turns(term: Term) -> bool:
    """Whether a term is a delay or a filter."""
    effect = get_effect(term.effect)
    return isinstance(effect, TransformEffect) and effect.stage == "signal"


def undone(grid: Grid, terms: tuple[Term, ...]) -> Signals:
    """Return the measured signals on the grid's points without the delays and filters in `terms`.

    They are in the order in which they act. Of what is read out otherwise (a unit) nothing is
    taken out.
    """
    measured = Signals(grid.accel, grid.gyro)
    late = [term for term in terms if acts_on_turns(term)]
    points, spans = grid.turns
    if not late or not len(points):
        return measured
    turns = np.flatnonzero(~grid.is_rest)
    means = _means(grid)
    rests = [Signals(means.accel[at], means.gyro[at]) for at in (turns - 1, turns + 1)]
    known = settle(spans, Signals(*(values[points] for values in measured)), *rests)
    signals = known.signals
    for term in reversed(late):
        effect = get_effect(term.effect)
        assert isinstance(effect, TransformEffect)
        signals = effect.inverse(known.time, signals, term.parameters)
    out = Signals(*(values.copy() for values in measured))
    for values, found in zip(out, signals, strict=True):
        values[points] = found[known.place]
    return out


def _means(grid: Grid) -> Signals:
    """Return the means over each segment, (s, 3)."""
    count = grid.count[:, None]
    total = np.add.reduceat(count, grid.first)
    means: list[FloatArray] = [
        np.add.reduceat(count * values, grid.first, axis=0) / total
        for values in (grid.accel, grid.gyro)
    ]
    return Signals(*means)
