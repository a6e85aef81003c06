"""Samples that went missing in a turn, and a clock that did not notice.

One sample lost at 200 degrees a second turns the frame by 2 degrees at 100 Hz: hundreds of standard
errors, too many for a linear column. So a turn that misses its closure by far is integrated with
samples put back, at every place. A loss has two unknowns, where and how many; the turn has five
equations.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.faults import ROBUST
from calib.mismatch.closure import across, integrate_turns
from calib.mismatch.grid import Grid
from calib.mismatch.selfmode import SelfProblem
from calib.mismatch.twin import Twin, fit_twin, true_state
from calib.types import FloatArray, IntArray

FAR = 20.0
"""Size of a closure that cannot be drift or drift's like, in scatters of all closures."""

NEAR = 3.0
"""The same of a turn that closes."""

SHARE = 0.05
"""Of a closure, what may be left of it: samples between fast ones are only interpolated."""

MOST = 5
"""Samples lost at once, at most."""

PLACES = 48
"""Places in a turn that are tried first."""

SUSPECT = 6.0
"""Size from which a turn is looked at again, in a fit that leaves it out."""

TRIED = 3
"""Turns that are looked at so, at most."""

FEWEST = 6
"""Turns that a scatter is taken from."""

CONTEXT = 6
"""Samples on either side that those put back are interpolated from."""

TOGETHER = 64
"""Turns that are integrated at a time: more need memory, fewer more calls."""

Signals = tuple[FloatArray, FloatArray, FloatArray]
"""Time, force and rate of one turn."""


class Loss(NamedTuple):
    """``number`` samples are missing just before ``moment`` (s), in one segment of the grid.

    ``before`` and ``after`` are the size of its closure in scatters, with and without the loss.
    """

    segment: int
    moment: float
    number: int
    before: float
    after: float


def find_losses(problem: SelfProblem) -> list[Loss]:
    """Return the losses that turn a turn which misses its closure by far into one that closes.

    A gyroscope that is misaligned misses every closure, and a loss would not stand out of that: so
    the twin that they are compared with has the whole matrix.
    """
    grid = problem.grid
    drop = np.zeros(len(grid.first), bool) if problem.drop is None else problem.drop.copy()
    turns = np.flatnonzero(~grid.is_rest & ~drop)
    if len(turns) < FEWEST:
        return []
    whole = problem.twin
    if not problem.full_gyro:
        whole = fit_twin(
            grid, replace(whole, full_gyro=True), problem.noise, drop=drop, iterations=2
        )
    scores = _Closures(grid, whole, turns).scores
    out = []
    for _ in range(TRIED):
        if scores.max() < SUSPECT:
            break
        # What one turn misses by, the fit spreads over its neighbours: fit without it.
        s = int(turns[np.argmax(scores)])
        drop[s] = True
        twin = fit_twin(grid, whole, problem.noise, drop=drop)
        closures = _Closures(grid, twin, turns)
        loss = closures.mended(s)
        if loss.before > FAR and loss.after < max(NEAR, SHARE * loss.before):
            out.append(loss)
        scores = np.where(drop[turns], 0.0, closures.scores)
    return out


class _Closures:
    """Closures of turns, and their sizes in scatters of them all."""

    def __init__(self, grid: Grid, twin: Twin, turns: IntArray) -> None:
        self._grid, self._twin, self._turns = grid, twin, turns
        self._state = true_state(grid, twin)
        own = [np.arange(grid.first[s], grid.last[s]) for s in turns]
        first = np.append(0, np.cumsum([len(k) for k in own]))
        state, points = self._state, np.concatenate(own)
        signals = grid.time[points], state.force[points], state.rate[points]
        left = self._residuals(turns, signals, first)
        size = ROBUST * np.median(np.abs(left), axis=0)
        self._scatter = np.repeat([size[:2].mean(), size[2:].mean()], (2, 3))
        self.scores = self._sizes(left)

    def mended(self, s: int) -> Loss:
        """Return the loss in one turn that leaves least of its closure."""
        own = slice(int(self._grid.first[s]), int(self._grid.last[s]))
        signals = self._grid.time[own], self._state.force[own], self._state.rate[own]
        last = len(signals[0]) - 2
        stride = max(1, last // PLACES)
        jump = _jump(np.hstack(signals[1:]))

        def best(places: Iterable[int]) -> tuple[float, int, int, float]:
            """Return what is left at the best place, the place, the number, and its size."""
            grid = np.meshgrid(np.fromiter(places, np.int64), np.arange(1, MOST + 1), indexing="ij")
            at, number = (values.ravel() for values in grid)
            parts = [slice(k, k + TOGETHER) for k in range(0, len(at), TOGETHER)]
            size = np.hstack([self._mended(s, signals, at[k], number[k]) for k in parts])
            left = 5 * size**2 + jump[number, at]
            k = int(np.argmin(left))
            return float(left[k]), int(at[k]), int(number[k]), float(size[k])

        # A long shot first; then where the signals themselves jump, and about the better of them.
        sharp = int(np.argmin(jump[1:].min(axis=0)))
        places = [best(range(2, last, stride))[1], min(max(sharp, 2), last - 1)]
        around = [range(max(2, k - stride), min(last, k + stride + 1)) for k in places]
        _, at, number, after = min((best(near) for near in around), key=lambda found: found[0])
        before = float(self.scores[self._turns.tolist().index(s)])
        return Loss(int(s), float(signals[0][at]), number, before, after)

    def _mended(self, s: int, signals: Signals, at: IntArray, number: IntArray) -> FloatArray:
        """Return the size of a turn's closure with samples put back, (k,)."""
        whole, first = _put_back(signals, at, number)
        return self._sizes(self._residuals(np.full(len(at), s), whole, first))

    def _residuals(self, turns: IntArray, signals: Signals, first: IntArray) -> FloatArray:
        """Return the five residuals of `closure.close_turns` of each, (k, 5)."""
        time, force, rate = signals
        up, gravity = self._twin.up, self._twin.gravity
        before, after = up[self._grid.before[turns]], up[self._grid.after[turns]]
        ended = integrate_turns(time, force, rate, first)
        tilt = np.einsum("kij,kj->ki", ended.frame, after) - before
        attitude = np.einsum("kij,ki->kj", across(before), tilt)
        duration = (time[first[1:] - 1] - time[first[:-1]])[:, None]
        return np.hstack((attitude, ended.velocity - gravity * duration * before))

    def _sizes(self, closures: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.mean(np.square(closures / self._scatter), axis=1)))


def _jump(values: FloatArray) -> FloatArray:
    """Return how much smoother (n, c) values are with 0 to `MOST` samples put back before each.

    A loss of k samples makes every channel jump by k of its own steps. What is left of the jump in
    squared scatters, less what was there: (MOST + 1, n), negative where a loss explains it.
    """
    out = np.zeros((MOST + 1, len(values)))
    if len(values) < 4 * CONTEXT:
        return out
    at = np.arange(CONTEXT) + 0.5
    value, slope = np.linalg.pinv(np.stack((at**0, at, at**2), axis=1))[:2]
    windows = np.lib.stride_tricks.sliding_window_view(values, CONTEXT, axis=0)
    before, after = windows[:-CONTEXT, :, ::-1], windows[CONTEXT:]
    jump = after @ value - before @ value
    step = 0.5 * (after @ slope - before @ slope)
    scatter = ROBUST * np.median(np.abs(jump), axis=0) + 1e-12
    jump, step = jump / scatter, step / scatter
    for number in range(1, MOST + 1):
        change = np.square(jump - number * step) - np.square(jump)
        out[number, CONTEXT : len(values) - CONTEXT + 1] = change.sum(axis=1)
    return out


def _put_back(signals: Signals, at: IntArray, count: IntArray) -> tuple[Signals, IntArray]:
    """Return signals with ``count[i]`` samples put in before sample ``at[i]``, for each of k.

    One after another, each as long after the last as none of them lasts; and where each begins.
    """
    time, force, rate = signals
    n, step = len(time), float(np.median(np.diff(time)))
    both = np.hstack((force, rate))
    put = np.empty((len(at), MOST, both.shape[1]))
    low, high = np.maximum(at - CONTEXT, 0), np.minimum(at + CONTEXT, n)
    shift = count * step
    fresh = time[at - 1, None] + step * np.arange(1, MOST + 1)
    # Near the ends of a turn there is less to interpolate from.
    for gap, width in np.unique(np.stack((at - 1 - low, high - low)), axis=1).T:
        own = np.flatnonzero((at - 1 - low == gap) & (high - low == width))
        near = low[own, None] + np.arange(width)
        true = time[near] + shift[own, None] * (np.arange(width) > gap)
        put[own] = _spline(true, both[near], int(gap), fresh[own])
    first = np.append(0, np.cumsum(n + count))
    case = np.repeat(np.arange(len(at)), n + count)
    index = np.arange(first[-1]) - first[case]
    late = np.maximum(index - at[case] + 1, 0)
    new = (late > 0) & (late <= count[case])
    source = np.minimum(index - np.minimum(late, count[case]), n - 1)
    whole = both[source]
    whole[new] = put[case[new], late[new] - 1]
    clock = time[source] + shift[case] * (late > count[case])
    clock[new] = fresh[case[new], late[new] - 1]
    clock += case * (time[-1] - time[0] + (MOST + 1) * step)
    return (clock, whole[:, :3], whole[:, 3:]), first


def _spline(time: FloatArray, values: FloatArray, gap: int, at: FloatArray) -> FloatArray:
    """Return (k, m, c) values at (k, m) times, by a cubic spline through each of k rows of points.

    Not-a-knot at the ends [1]_. All times ``at`` are between points `gap` and ``gap + 1``.

    Parameters
    ----------
    time, values : (k, w), (k, w, c) arrays, w > 3

    References
    ----------
    .. [1] de Boor, "A Practical Guide to Splines", Springer 1978, ch. IV, eqs. (7), (10).
    """
    step = np.diff(time, axis=1)
    slope = np.diff(values, axis=1) / step[..., None]
    system, right = np.zeros((len(time), *2 * time.shape[1:])), np.zeros_like(values)
    inner = np.arange(1, time.shape[1] - 1)
    system[:, inner, inner - 1] = step[:, 1:]
    system[:, inner, inner] = 2 * (step[:, :-1] + step[:, 1:])
    system[:, inner, inner + 1] = step[:, :-1]
    right[:, inner] = 3 * (step[:, 1:, None] * slope[:, :-1] + step[:, :-1, None] * slope[:, 1:])
    for end, beside in ((0, 1), (-1, -2)):
        h, k = step[:, end, None], step[:, beside, None]
        system[:, end, [end]], system[:, end, [beside]] = k, h + k
        outer, other = slope[:, end], slope[:, beside]
        right[:, end] = ((3 * h + 2 * k) * k * outer + h**2 * other) / (h + k)
    knots = np.linalg.solve(system, right)
    width = step[:, gap, None]
    part = ((at - time[:, gap, None]) / width)[..., None]
    y = values[:, [gap]] + slope[:, [gap]] * (at - time[:, gap, None])[..., None]
    d = (knots[:, [gap + j]] - slope[:, [gap]] for j in (0, 1))
    bend = next(d) * (1 - part) - next(d) * part
    return np.asarray(y + width[..., None] * part * (1 - part) * bend)
