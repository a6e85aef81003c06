"""What effects are functions of, found from measured signals where nobody states it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.effects.base import State, window_mean, windows
from calib.effects.vibration import vibration_variance
from calib.types import BoolArray, FloatArray

TURNING = 0.1
"""rad/s above which the sensor turns, on average over `STEADY`: a hand holds it stiller."""

STEADY = 0.25
"""s over which a hand's tremor, and what shakes a sensor, averages out."""

PAUSE = 0.4
"""s of rest that end a turn."""

LOOK = 1.0
"""s of rest at a turn's end, or before its start, that show what the gyroscope reads at rest."""

MOVES = 5.0
"""Standard deviations at rest from which on a rate is that of a turn."""

CREEPING = 2e-3
"""rad/s below which none is, however quiet the rest: a table's profile has no noise, and a low-pass
rings after a turn."""

CARRIED = 0.1
"""m/s² below which nothing is carried, however quiet the rest: what settles may be as much."""

SWINGS = 0.06
"""s after which a force that is carried has not yet changed its sign, and one that rings has: a
sensor that is put down rings at 8 Hz and more, a hand is slower."""

TURN_REACH = STEADY + PAUSE + LOOK
"""s on either side of a moment that decide whether a turn is under way."""


class Turns(NamedTuple):
    """When turns start and end, and when what they leave ringing is quiet, (k,) s each."""

    start: FloatArray
    end: FloatArray
    quiet: FloatArray


def observed(state: State, reads: Collection[str]) -> State:
    """Return the state with ``vibration`` and the turns filled in where `reads` names them.

    What the state already has stays. ``rate`` must be free of bias to much less than 0.1 rad/s.
    """
    shakes = "vibration" in reads and state.vibration is None
    turns = bool({"since_turn", "turning"} & set(reads)) and state.since_turn is None
    if not (shakes or turns):
        return state
    found = observed_turns(state.time, state.rate, state.force)
    since, turning = since_and_during(state.time, found.start, found.end)
    if shakes:
        _, loud = since_and_during(state.time, found.start, found.quiet)
        state = replace(state, vibration=vibration_variance(state.time, state.force, loud))
    return replace(state, since_turn=since, turning=turning) if turns else state


def observed_turns(time: FloatArray, rate: FloatArray, force: FloatArray | None = None) -> Turns:
    """Return when turns start and end.

    A turn is where the mean rate is above `TURNING`, until it stays below for `PAUSE`. It ends
    with the last sample that stands out of what the gyroscope reads in the rest after it, and
    starts likewise: a hand slows down over tenths of a second, in which much of a settling is gone.
    It may still carry what turns no more, which ``force`` (n, 3), if it is given, tells. What is
    put down rings: it has stopped by then.
    """
    mean = window_mean(rate, *windows(time, STEADY))
    both = rate if force is None else np.hstack((rate, force))
    fast = np.flatnonzero(np.linalg.norm(mean, axis=1) > TURNING)
    if not len(fast):
        return Turns(*np.zeros((3, 0)))
    at = time[fast]
    first = fast[np.diff(at, prepend=-np.inf) > PAUSE]
    last = fast[np.diff(at, append=np.inf) > PAUSE]
    backwards = -time[::-1]
    starts = [
        _edge(backwards, both[::-1], len(time) - 1 - b, -after)[1]
        for b, after in zip(first, np.append(-np.inf, time[last[:-1]]), strict=True)
    ]
    ends = [
        _edge(time, both, a, before)
        for a, before in zip(last, np.append(time[first[1:]], np.inf), strict=True)
    ]
    end, quiet = np.transpose(ends)
    return Turns(-np.array(starts), end, quiet)


def _edge(time: FloatArray, both: FloatArray, last: int, following: float) -> tuple[float, float]:
    """Return when a turn ends and is quiet, whose mean rate is high until sample `last`.

    ``both`` (n, 3 or 6) are rates, and forces if they are looked at. At ``following`` s the
    next turn is under way; its start is not looked at.
    """
    now = float(time[last])
    stop = int(np.searchsorted(time, min(now + LOOK, 0.5 * (now + following)), side="right"))
    rest = both[(last + stop) // 2 : stop]
    if len(rest) < 2:
        return now, now
    a, b = np.searchsorted(time, (now - STEADY, now + LOOK - PAUSE))
    most = np.maximum(MOVES * rest.std(axis=0), np.repeat((CREEPING, CARRIED), 3)[: rest.shape[1]])
    near = slice(a, min(b, stop))
    away = both[near] - rest.mean(axis=0)
    off = np.abs(away) > most
    carried = off.copy()
    carried[:, 3:] &= _lasts(np.sign(away[:, 3:]) * off[:, 3:], time[near])

    def until(moves: BoolArray) -> float:
        some = np.flatnonzero(moves.any(axis=1))
        return float(time[a + some[-1]]) if len(some) else now

    return until(carried), until(off)


def _lasts(sign: FloatArray, time: FloatArray) -> BoolArray:
    """Return where (n, k) signs stay what they are for `SWINGS` s or more."""
    lasts = np.zeros(sign.shape, bool)
    if len(time) < 2:
        return ~lasts
    interval = (time[-1] - time[0]) / (len(time) - 1)
    for own, column in zip(lasts.T, sign.T, strict=True):
        edges = np.concatenate(([0], np.flatnonzero(np.diff(column)) + 1, [len(column)]))
        number = np.diff(edges)
        own[:] = np.repeat(number * interval >= SWINGS, number)
    return lasts


def since_and_during(
    time: FloatArray, starts: FloatArray, ends: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return `State.since_turn` and `State.turning` of turns, in their order, at (n,) times."""
    ended = np.searchsorted(ends, time, side="right")
    since = time - np.append(-np.inf, ends)[ended]
    return since, np.searchsorted(starts, time, side="right") > ended
