"""Samples that went missing in a turn, and a clock that did not notice.

One sample lost at 200 degrees a second turns the frame by 2 degrees at 100 Hz: hundreds of standard
errors, too many for a linear column. So a turn that misses its closure by far is integrated with
samples put back, at every place. A loss has two unknowns, where and how many; the turn has five
equations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.faults import ROBUST
from calib.mismatch.closure import across, turned_frame
from calib.mismatch.grid import Grid
from calib.mismatch.selfmode import SelfProblem
from calib.mismatch.twin import Twin, fit_twin, true_state
from calib.rotation import mat_from_quat
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
        self._grid, self._twin = grid, twin
        self._state = true_state(grid, twin)
        left = np.array([self._residual(s, self._signals(s)) for s in turns])
        size = ROBUST * np.median(np.abs(left), axis=0)
        self._scatter = np.repeat([size[:2].mean(), size[2:].mean()], (2, 3))
        self.scores = np.array([self._score(closure) for closure in left])

    def mended(self, s: int) -> Loss:
        """Return the loss in one turn that leaves least of its closure."""
        signals = self._signals(s)
        last = len(signals[0]) - 2
        stride = max(1, last // PLACES)

        jump = _jump(np.hstack(signals[1:]))

        def score(at: int, number: int) -> float:
            return self._score(self._residual(s, _put_back(signals, at, number)))

        def best(places: range, counts: range) -> tuple[int, int]:
            tried = ((k, n) for k in places for n in counts)
            return min(tried, key=lambda kn: 5 * score(*kn) ** 2 + jump[kn[1], kn[0]])

        # A long shot first; then where the signals themselves jump, and about the better of them.
        counts = range(1, MOST + 1)
        coarse = range(2, last, stride)
        sharp = int(np.argmin(jump[1:].min(axis=0)))
        places = [best(coarse, counts)[0], min(max(sharp, 2), last - 1)]
        around = [range(max(2, k - stride), min(last, k + stride + 1)) for k in places]
        found = [best(near, counts) for near in around]
        at, number = min(found, key=lambda kn: 5 * score(*kn) ** 2 + jump[kn[1], kn[0]])
        before = self._score(self._residual(s, signals))
        return Loss(int(s), float(signals[0][at]), number, before, score(at, number))

    def _signals(self, s: int) -> Signals:
        own = slice(int(self._grid.first[s]), int(self._grid.last[s]))
        return self._grid.time[own], self._state.force[own], self._state.rate[own]

    def _residual(self, s: int, signals: Signals) -> FloatArray:
        """Return the five residuals of `closure.close_turn`."""
        time, force, rate = signals
        up, gravity = self._twin.up, self._twin.gravity
        before, after = up[self._grid.before[s]], up[self._grid.after[s]]
        mat = mat_from_quat(turned_frame(time, rate))
        turned = np.einsum("nij,nj->ni", mat, force)
        total = 0.5 * np.diff(time) @ (turned[:-1] + turned[1:])
        attitude = across(before).T @ (mat[-1] @ after - before)
        return np.concatenate((attitude, total - gravity * (time[-1] - time[0]) * before))

    def _score(self, closure: FloatArray) -> float:
        return float(np.sqrt(np.mean(np.square(closure / self._scatter))))


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


def _put_back(signals: Signals, at: int, count: int) -> Signals:
    """Return time, force and rate with `count` samples put in before sample `at`."""
    from scipy.interpolate import CubicSpline  # a third of a second to import

    time, force, rate = signals
    step = float(np.median(np.diff(time)))
    near = slice(max(at - CONTEXT, 0), at + CONTEXT)
    true = time + count * step * (np.arange(len(time)) >= at)
    fresh = true[at - 1] + step * np.arange(1, count + 1)
    both = np.hstack((force, rate))
    put = CubicSpline(true[near], both[near])(fresh)
    whole = np.insert(both, [at] * count, put, axis=0)
    return np.insert(true, [at] * count, fresh), whole[:, :3], whole[:, 3:]
