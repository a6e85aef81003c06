"""What a disturbance may remember: poses, turns, loads and temperatures that were before.

Each basis is (n, k) values at the points of a recording. What a turn does to it counts as much as
rests do: velocity closes only with what an accelerometer felt on the way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from calib.effects.base import State
from calib.effects.observed import observed
from calib.mismatch.hypotheses.followed import scaled_rates
from calib.mismatch.rows.rows import Rows
from calib.types import BoolArray, FloatArray, IntArray

MEMORIES = np.array([0.5, 2.0, 8.0])
"""How long what creeps remembers poses, in times from one to the next."""

PLAY = (0.0, 0.1, 0.2, 0.3, 0.4)
"""Load in g, beyond which what has play goes to the other side."""

LAGS = (0.05, 0.1, 0.2, 0.4)
"""Load in g, by which what is elastic lags behind at most."""

FORGOTTEN = 500.0
"""Times the memory after which nothing is left."""

LOADED = "its load before: play, or friction"
"""What has play, or sticks, depends on how it was loaded before."""

FORGETS = np.geomspace(0.5, 8.0, 5)
"""s in which a gyroscope forgets a turn, or an accelerometer a load."""

LATE = np.geomspace(10.0, 160.0, 5)
"""s by which what follows a temperature is late."""

PASSES = np.geomspace(2.0, 128.0, 7)
"""Time constants of high-passes, s."""


@dataclass(frozen=True, eq=False)
class Stretches:
    """Rests and turns of a recording, in their order.

    Parameters
    ----------
    state : State
        At the points, with ``since_turn`` and ``turning``, if there are any turns.
    number : (n,) array of int
        The stretch of each point.
    still : (s,) array of bool
        Which stretches are rests.
    interval : (s, 2) array, s
    """

    state: State
    number: IntArray
    still: BoolArray
    interval: FloatArray

    @classmethod
    def of(cls, rows: Rows) -> Stretches:
        """Return those of the rows; beside a truth, whose windows are neither, those it shows."""
        if rows.is_rest.any():
            return cls(rows.state, rows.point_segment, rows.is_rest, rows.interval)
        state = observed(rows.state, ("turning",))
        turning, time = state.turning, state.time
        assert turning is not None
        first = np.flatnonzero(np.diff(turning, prepend=not turning[0]))
        number = np.repeat(np.arange(len(first)), np.diff(first, append=len(time)))
        last = np.append(first[1:], len(time)) - 1
        return cls(state, number, ~turning[first], np.stack((time[first], time[last]), axis=1))

    @cached_property
    def rests(self) -> IntArray:
        """The numbers of the rests."""
        return np.flatnonzero(self.still)

    def means(self, signal: FloatArray) -> FloatArray:
        """Return the mean of a signal (n, k) over each stretch, (s, k)."""
        many = len(self.still)
        count = np.maximum(np.bincount(self.number, minlength=many), 1)[:, None]
        return np.stack([np.bincount(self.number, v, many) for v in signal.T], axis=1) / count

    @cached_property
    def pose(self) -> IntArray:
        """The rest that each point is in, or nearest to, counted: turns have halves."""
        start, stop = self.interval[self.still].T
        middle = 0.5 * (stop[:-1] + start[1:])
        return np.searchsorted(middle, self.state.time, side="right")


def history(rows: Rows, stretches: Stretches) -> Iterator[tuple[str, FloatArray]]:
    """Yield what came before: the direction of gravity in the last poses, and the last turn.

    What sticks remembers the last one, or which way its turn was; what creeps forgets it slowly,
    and has followed by so much less.
    """
    rests, state = stretches.rests, stretches.state
    if len(rests) < 2:
        return
    up, rate = (stretches.means(signal) for signal in (state.gravity_direction, state.rate))
    turn = rate * np.ptp(stretches.interval, axis=1)[:, None]
    turn /= np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1.0)
    pose = stretches.pose
    for name, what in (
        ("the pose before", up[rests[:-1]]),
        ("the turn before", turn[rests[1:] - 1]),
        ("the turn before", np.sign(turn[rests[1:] - 1])),
    ):
        # Nothing was before the first rest.
        yield name, np.vstack((np.zeros(3), what))[pose]
    direction = state.gravity_direction
    apart = float(np.median(np.diff(stretches.interval[rests].mean(axis=1))))
    for known in lately(rows, direction, MEMORIES * apart):
        yield "the pose before", direction - known


def lately(rows: Rows, signal: FloatArray, memory: FloatArray) -> FloatArray:
    """Return a signal (n, k) as what creeps still knows it, with r memories in seconds, (r, n, k).

    A low-pass of first order, exact where the signal stays: ``memory dx/dt = signal - x``.
    """
    time, many = rows.state.time, len(memory)
    out = np.empty((many, *signal.shape))
    ends = np.searchsorted(rows.point_segment, np.arange(len(rows.interval) + 1)).tolist()
    known, before = np.repeat(signal[None, :1], many, axis=0), float(time[0])
    for a, b in pairwise(ends):
        if a == b:
            continue
        # Of what was so long ago nothing is known.
        since = np.minimum((time[a:b] - before) / memory[:, None], FORGOTTEN)
        grown = np.ones((many, b - a + 1, 1))
        grown[:, 1:, 0] = np.exp(since)
        felt = np.cumsum((grown[:, 1:] - grown[:, :-1]) * signal[a:b], axis=1)
        out[:, a:b] = (known + felt) / grown[:, 1:]
        known, before = out[:, b - 1 : b], float(time[b - 1])
    return out


def remembered(stretches: Stretches, axis: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield what a channel may remember of how its axis was loaded before, (n, 1).

    What has play lies on the side that it was last loaded to, if by enough; where it sticks in a
    turn, on that of the pose before. What is elastic, with friction, lags behind its load, or goes
    by the way that it came. A turn tells as much of it as the rests.
    """
    if len(stretches.rests) < 2:
        return
    load = stretches.state.force[:, axis] / stretches.state.gravity
    for least in PLAY:
        yield LOADED, side_of(load, least)[:, None]
    for most in LAGS:
        yield LOADED, lag_of(load, most)[:, None] / most
    mean = stretches.means(load[:, None])[stretches.still, 0]
    for side in (mean[:-1], np.diff(mean)):
        yield LOADED, np.append(0.0, np.sign(side))[stretches.pose][:, None]


def side_of(load: FloatArray, least: float) -> FloatArray:
    """Return the side (n,) that something was last loaded to, by more than the least it takes."""
    beyond = np.abs(load) > least
    last = np.maximum.accumulate(np.where(beyond, np.arange(len(load)), -1))
    return np.where(last < 0, 0.0, np.sign(load)[last])


def lag_of(load: FloatArray, most: float) -> FloatArray:
    """Return how far something is behind its load (n,), by so much at most.

    The stop of Prandtl's model [1]_, from one reversal of the load to the next.

    References
    ----------
    .. [1] Visintin, "Differential Models of Hysteresis", Springer 1994, ch. III (play and stop).
    """
    step = np.diff(load)
    moved = np.flatnonzero(step)
    if not len(moved):
        return np.zeros(len(load))
    turned = moved[1:][step[moved[1:]] * step[moved[:-1]] < 0]
    ends = np.concatenate(([0], turned))
    lag, now = [0.0], 0.0
    for change in np.diff(load[ends]).tolist():
        now += change
        # By `min` and `max` each step takes three times as long.
        now = most if now > most else -most if now < -most else now
        lag.append(now)
    piece = np.searchsorted(ends, np.arange(len(load)), side="right") - 1
    return np.asarray(np.clip(np.array(lag)[piece] + load - load[ends][piece], -most, most))


def after_turns(rows: Rows, stretches: Stretches, c: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield what a channel may have after each turn, while it fades, (n, k).

    Once the same after all of them, and once as the turn was about its axis, either way or not. And
    what a high-pass takes away: turns go through it while they last, and what it let go comes back.
    """
    state, rests = stretches.state, stretches.rests
    if state.since_turn is None or state.turning is None or len(rests) < 2:
        return
    segment, number = stretches.number, len(stretches.still)
    rate = scaled_rates(state)[:, c % 3]
    most, least = np.zeros((2, number))
    np.maximum.at(most, segment, rate)
    np.minimum.at(least, segment, rate)
    peak = np.where(most > -least, most, least)
    # Nothing was before the first rest.
    last = np.zeros(number)
    last[rests[1:]] = peak[rests[1:] - 1]
    turned = np.zeros(number)
    turned[rests[1:]] = 1.0
    own = np.stack((turned, last, np.abs(last)), axis=1)[segment]
    own[state.turning] = 0.0
    for memory in FORGETS.tolist():
        yield "time since the last turn", np.exp(-state.since_turn / memory)[:, None] * own
    for known in lately(rows, rate[:, None], PASSES):
        yield "time since the last turn", known


def creeping(rows: Rows, stretches: Stretches, axis: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield what an accelerometer may have of a new load on its axis, while it fades, (n, 1).

    What it carries creeps by a part of what its load has changed by, or its gain is another one
    until it has settled.
    """
    state, rests = stretches.state, stretches.rests
    if state.since_turn is None or state.turning is None or len(rests) < 2:
        return
    load = state.force[:, axis : axis + 1] / state.gravity
    yield from (("the pose before", load - old) for old in lately(rows, load, FORGETS))
    # Nothing was before the first rest.
    after = ((stretches.pose > 0) & ~state.turning)[:, None]
    for memory in FORGETS.tolist():
        fades = np.exp(-state.since_turn / memory)[:, None]
        yield "time since the last turn", after * fades * load


def lagging(rows: Rows) -> Iterator[tuple[str, FloatArray]]:
    """Yield what follows a temperature late, (n, 1): its thermometer is not where the sensor is.

    And what is warmer in one place than in another, the second of which follows the first.
    """
    warmth = rows.state.warmth
    if warmth is None or not np.ptp(warmth) > 0:
        return
    warmth = warmth[:, None] / np.ptp(warmth)
    for known in lately(rows, warmth, LATE):
        yield "temperature", known
        yield "temperature", warmth - known


def of_use(rows: Rows, stretches: Stretches) -> Iterator[tuple[str, FloatArray]]:
    """Yield what any channel may have of how much the sensor was turned of late, (n, 1)."""
    if not stretches.still.any() or stretches.still.all():
        return
    speed = np.linalg.norm(scaled_rates(rows.state), axis=1, keepdims=True)
    for known in lately(rows, speed, PASSES):
        yield "time since the last turn", known
