"""What a change of whole signals did to the turns of a recording.

Without a reference the signals that rows start from have the change in them, and a low-pass of a
few hertz changes a turn far beyond what is linear. So its column is no functional of signals: the
turns are integrated as recorded and as they were before the change, and the column is the
difference of their closures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from calib.effects.base import Signals, TransformEffect
from calib.mismatch.rows.closure import Spans, across, end_turns, turned_frames
from calib.mismatch.rows.rows import ClosedTurns, Rows
from calib.types import FloatArray, IntArray

STILL = 1 / 3
"""s of rest that are put at either end of each turn, in which a low-pass of 3 Hz settles, and as
long as the longest delay."""


def whole_changes(
    effect: TransformEffect, rows: Rows, shape: Mapping[str, float]
) -> dict[str, FloatArray]:
    """Return what each part of an effect, there in the recorded signals, did to the rows (m,)."""
    out: dict[str, FloatArray] = {}
    for p in effect.parameters:
        alone = {q.name: float(q is p) for q in effect.parameters}
        change = whole_change(effect, rows, {**alone, **shape})
        if change is not None:
            out[p.name] = change
    return out


def whole_change(
    effect: TransformEffect, rows: Rows, parameters: Mapping[str, float]
) -> FloatArray | None:
    """Return what an effect, there in the recorded signals, did to the rows (m,); None if nothing.

    A delay is no longer than `STILL`.
    """
    turns = rows.turns
    if not len(turns.index):
        return None
    recorded, place, restore = _settled(effect, turns, rows.state.gravity)
    before = restore(parameters)
    if all(a is b for a, b in zip(before, recorded, strict=True)):
        return None
    frame = turns.frame
    if before.gyro is not recorded.gyro:
        frame = turned_frames(turns.spans, before.gyro[place])
    ended = end_turns(turns.spans, before.accel[place], frame)
    tilt = np.einsum("kij,kj->ki", turns.ended.frame - ended.frame, turns.up_after)
    out = np.zeros(len(rows.residual))
    out[turns.index[:, :2]] = np.einsum("kij,ki->kj", across(turns.up_before), tilt)
    out[turns.index[:, 2:]] = turns.ended.velocity - ended.velocity
    return out


class Settled(NamedTuple):
    """The signals of turns, at rest before and after each: evenly spaced there, `STILL` long.

    ``time`` is none of a recording's: rests are shorter, or longer, there. ``place`` is that of
    each of the turns' own points.
    """

    time: FloatArray
    signals: Signals
    place: IntArray
    interval: float


def settle(spans: Spans, turning: Signals, before: Signals, after: Signals) -> Settled:
    """Return signals (n, 3) of turns between what they are at rest before and after each (k, 3)."""
    inside = np.ones(len(spans.time), bool)
    inside[spans.start] = False
    interval = float(np.median(spans.step[inside]))
    still = int(np.ceil(STILL / interval))
    count = np.ones(len(spans.time), np.int64)
    count[spans.start] += still
    count[spans.last] += still
    place = np.cumsum(count) - 1
    place[spans.last] -= still
    step = np.full(int(count.sum()), interval)
    step[place[inside]] = spans.step[inside]
    near = np.arange(1, still + 1)[:, None]
    out = []
    for values, first, last in zip(turning, before, after, strict=True):
        whole = np.repeat(values, count, axis=0)
        whole[place[spans.start] - near] = first
        whole[place[spans.last] + near] = last
        out.append(whole)
    return Settled(np.cumsum(step) - step[0], Signals(*out), place, interval)


@lru_cache(maxsize=1)
def _settled(
    effect: TransformEffect, turns: ClosedTurns, gravity: float
) -> tuple[Signals, IntArray, Callable[[Mapping[str, float]], Signals]]:
    """Return signals at rest before and after each turn, and what takes an effect out of them.

    Beside them the place of each of the turns' own points.
    """
    # Signals rest before and after each turn; of that the grid keeps only a few points. What they
    # are there is known: one sample more of them would be its noise, held for that long.
    before, after = (
        Signals(gravity * up, np.zeros_like(up)) for up in (turns.up_before, turns.up_after)
    )
    known = settle(turns.spans, Signals(turns.force, turns.rate), before, after)
    return known.signals, known.place, effect.restorer(known.signals, interval=known.interval)
