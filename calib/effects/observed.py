"""What effects are functions of, found from measured signals where nobody states it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from calib.effects.base import State
from calib.types import BoolArray, FloatArray

VIBRATION_WINDOW = 1.0
"""s over which the variance of vibration is averaged."""

TURNING = 0.1
"""rad/s above which the sensor turns; a hand holds it stiller, a turn's last tenth is slower."""

PAUSE = 0.4
"""s of rest that end a turn."""


def observed(state: State, reads: Collection[str]) -> State:
    """Return the state with ``vibration`` and the turns filled in where `reads` names them.

    What the state already has stays. ``rate`` must be free of bias to much less than 0.1 rad/s.
    """
    if "vibration" in reads and state.vibration is None:
        state = replace(state, vibration=short_time_variance(state.time, state.force))
    if {"since_turn", "turning"} & set(reads) and state.since_turn is None:
        since, turning = observed_turns(state.time, state.rate)
        state = replace(state, since_turn=since, turning=turning)
    return state


def short_time_variance(time: FloatArray, force: FloatArray) -> FloatArray:
    """Return the variance (n, 3) of what is too fast for motion, over a second about each sample.

    The mean of squared second differences over six: for vibration that is faster than the samples
    (white when sampled) it is the variance; slow motion drops out. Output noise is part of it.
    """
    n = len(time)
    square = np.zeros_like(force)
    if n > 2:
        square[1:-1] = np.square(force[2:] - 2 * force[1:-1] + force[:-2]) / 6
        square[0], square[-1] = square[1], square[-2]
    total = np.zeros((n + 1, 3))
    np.cumsum(square, axis=0, out=total[1:])
    first = np.searchsorted(time, time - 0.5 * VIBRATION_WINDOW)
    last = np.searchsorted(time, time + 0.5 * VIBRATION_WINDOW, side="right")
    mean: FloatArray = (total[last] - total[first]) / (last - first)[:, None]
    return mean


def observed_turns(time: FloatArray, rate: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the time since the last turn ended, (n,) s, and whether one is under way, (n,) bool.

    The time goes on through the next turn, and is infinite before the first end. A turn ends where
    the rate stays below `TURNING` for `PAUSE`.
    """
    turning = np.flatnonzero(np.linalg.norm(rate, axis=1) > TURNING)
    at = time[turning]
    starts = at[np.diff(at, prepend=-np.inf) > PAUSE]
    ends = at[np.diff(at, append=np.inf) > PAUSE]
    return since_and_during(time, starts, ends)


def since_and_during(
    time: FloatArray, starts: FloatArray, ends: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return `State.since_turn` and `State.turning` of turns, in their order, at (n,) times."""
    ended = np.searchsorted(ends, time, side="right")
    since = time - np.append(-np.inf, ends)[ended]
    return since, np.searchsorted(starts, time, side="right") > ended
