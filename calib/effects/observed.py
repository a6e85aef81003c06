"""What effects are functions of, found from measured signals where nobody states it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

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

TURN_REACH = STEADY + PAUSE + LOOK
"""s on either side of a moment that decide whether a turn is under way."""


def observed(state: State, reads: Collection[str]) -> State:
    """Return the state with ``vibration`` and the turns filled in where `reads` names them.

    What the state already has stays. ``rate`` must be free of bias to much less than 0.1 rad/s.
    """
    shakes = "vibration" in reads and state.vibration is None
    turns = bool({"since_turn", "turning"} & set(reads)) and state.since_turn is None
    if not (shakes or turns):
        return state
    starts, ends = observed_turns(state.time, state.rate, state.force)
    since, turning = since_and_during(state.time, starts, ends)
    if shakes:
        state = replace(state, vibration=vibration_variance(state.time, state.force, turning))
    return replace(state, since_turn=since, turning=turning) if turns else state


def observed_turns(
    time: FloatArray, rate: FloatArray, force: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return when turns start and end, (k,) s each.

    A turn is where the mean rate is above `TURNING`, until it stays below for `PAUSE`. It ends
    with the last sample that stands out of what the gyroscope reads in the rest after it, and
    starts likewise: a hand slows down over tenths of a second, in which much of a settling is gone.
    It may still carry what turns no more, which ``force`` (n, 3), if it is given, tells.
    """
    mean = window_mean(rate, *windows(time, STEADY))
    both = rate if force is None else np.hstack((rate, force))
    fast = np.flatnonzero(np.linalg.norm(mean, axis=1) > TURNING)
    if not len(fast):
        return np.zeros(0), np.zeros(0)
    at = time[fast]
    first = fast[np.diff(at, prepend=-np.inf) > PAUSE]
    last = fast[np.diff(at, append=np.inf) > PAUSE]
    backwards = -time[::-1]
    starts = [
        _edge(backwards, both[::-1], len(time) - 1 - b, -after)
        for b, after in zip(first, np.append(-np.inf, time[last[:-1]]), strict=True)
    ]
    ends = [
        _edge(time, both, a, before)
        for a, before in zip(last, np.append(time[first[1:]], np.inf), strict=True)
    ]
    return -np.array(starts), np.array(ends)


def _edge(time: FloatArray, both: FloatArray, last: int, following: float) -> float:
    """Return the time at which a turn ends whose mean rate is high until sample `last`.

    ``both`` (n, 3 or 6) are rates, and forces if they are looked at. At ``following`` s the
    next turn is under way; its start is not looked at.
    """
    now = float(time[last])
    stop = int(np.searchsorted(time, min(now + LOOK, 0.5 * (now + following)), side="right"))
    rest = both[(last + stop) // 2 : stop]
    if len(rest) < 2:
        return now
    a, b = np.searchsorted(time, (now - STEADY, now + LOOK - PAUSE))
    most = np.maximum(MOVES * rest.std(axis=0), np.repeat((CREEPING, CARRIED), 3)[: rest.shape[1]])
    off = np.abs(both[a : min(b, stop)] - rest.mean(axis=0)) > most
    moves = np.flatnonzero(off.any(axis=1))
    return float(time[a + moves[-1]]) if len(moves) else now


def since_and_during(
    time: FloatArray, starts: FloatArray, ends: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return `State.since_turn` and `State.turning` of turns, in their order, at (n,) times."""
    ended = np.searchsorted(ends, time, side="right")
    since = time - np.append(-np.inf, ends)[ended]
    return since, np.searchsorted(starts, time, side="right") > ended
