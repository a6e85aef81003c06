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
from calib.mismatch.noise.sampling import unresolved
from calib.mismatch.rows.closure import (
    Closures,
    Ended,
    Spans,
    close_turns,
    follow_turns,
    integrate_turns,
    open_ends,
)
from calib.mismatch.rows.grid import Grid
from calib.mismatch.twin.selfmode import SelfProblem
from calib.mismatch.twin.twin import Twin, true_state
from calib.mismatch.twin.twinfit import fit_twin
from calib.spline import spline_between, spline_slopes
from calib.types import BoolArray, FloatArray, IntArray

SURE = 1000.0
"""Odds of a loss, against a turn that errs by as much for another reason, from which it is one. Of
such errors, five numbers of any direction, a share of ``(after / before)**5`` is mended as well at
one place; so many places are tried. Three turns may be looked at in vain, and at most one in two
hundred recordings may have a false name."""

SHARP = 0.5
"""Share of the greatest jump of the signals in a turn from which others are as likely a loss."""

NEAR = 3.0
"""Size up to which a turn closes, in what turns scatter by."""

SHARE = 0.1
"""Of a closure, what may be left of it: samples between fast ones are only interpolated. At a
thousand looks it is what the odds ask for."""

MOST = 32
"""Samples lost at once, at most: what a buffer or a packet holds."""

TRIALS = np.array([1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 19, 24, 28, MOST])
"""How many are tried first: of a few all, of more in steps of a fifth or so."""

PLACES = 400
"""Places in a turn that are tried first."""

SUSPECT = 5.0
"""Size of a turn from which samples may be lost in it, in a fit that leaves it out. Any that does
not close is looked at so: a fit that it takes part in may halve its size."""

TRIED = 3
"""Turns that are looked at so in vain, at most."""

FEWEST = 6
"""Turns that a scatter is taken from."""

BROKEN = 0.3
"""rad by which a turn is off that most others are not, if it ends where it did not lead."""

SLIGHT = 0.1
"""Of all the angle that was turned, what a sensor is off by at most."""

ALONE = 20.0
"""Times as far off as most are it is then, too."""

FEW = 0.25
"""Share of the turns that may be broken: of more, it is not the turns that are."""

INCOMPLETE = "motion: the turn ends where it did not lead, as if the recording had paused in it"

FREEDOM = 3.0
"""Degrees of freedom of the jumps that motion makes."""

CONTEXT = 6
"""Samples on either side that those put back are interpolated from."""

ELSEWHERE = 16
"""Places in a turn that tell how well samples put back are foretold."""

EDGE = 4
"""Samples at the ends of a part of a turn that are not integrated as in the whole: slopes take two
on either side, and those of velocity take the frames there, which took slopes themselves. A turn's
own ends rest."""

PART = 2 * EDGE + 1
"""Samples on either side that are integrated anew."""

Signals = tuple[FloatArray, FloatArray, FloatArray]
"""Time, force and rate of one turn."""


class Loss(NamedTuple):
    """``number`` samples are missing just before ``moment`` (s), in one segment of the grid.

    ``before`` and ``after`` are the size of its closure in scatters, with and without the loss;
    ``looks`` is at how many places, and for how many samples, a loss was as likely beforehand.
    ``spread`` is how uncertain moment (s) and number are: two samples lost in a fast moment turn
    the frame as much as four in a slow one. ``wrong`` is the size of the closure where one sample
    there is what its neighbours foretell instead.
    """

    segment: int
    moment: float
    number: int
    before: float
    after: float
    looks: int
    spread: tuple[float, float] = (0.0, 0.0)
    wrong: float = np.inf

    @property
    def stands(self) -> bool:
        """Whether the loss mends the turn, and no other error would be mended so by chance.

        Nor by one sample that is wrong: beside it, samples put back undo what it does.
        """
        mended = self.after < max(NEAR, SHARE * self.before)
        odds = (self.before / max(self.after, 1.0)) ** 5 / self.looks
        alone = self.wrong > max(NEAR, 2.0 * self.after)
        return mended and alone and self.before > SUSPECT and odds > SURE


def find_losses(problem: SelfProblem) -> list[Loss]:
    """Return the losses that turn a turn which misses its closure by far into one that closes.

    A gyroscope that is misaligned misses every closure, and a loss would not stand out of that: so
    the twin that they are compared with has the whole matrix.
    """
    grid = problem.grid
    drop, turns = _kept(problem)
    if len(turns) < FEWEST:
        return []
    whole = problem.twin
    if not problem.full_gyro:
        whole = fit_twin(
            grid, replace(whole, full_gyro=True), problem.noise, drop=drop, iterations=2
        )
    scores = _Closures(grid, whole, turns, problem.noise).scores
    out, vain = list[Loss](), 0
    while vain < TRIED and scores.max() >= NEAR:
        # What one turn misses by, the fit spreads over its neighbours: fit without it.
        s = int(turns[np.argmax(scores)])
        drop[s] = True
        twin = fit_twin(grid, whole, problem.noise, drop=drop)
        closures = _Closures(grid, twin, turns, problem.noise)
        loss = closures.mended(s)
        if loss.stands:
            out.append(loss)
        else:
            vain += 1
        scores = np.where(drop[turns], 0.0, closures.scores)
    return out


def leave_out_unwhole(problem: SelfProblem) -> tuple[list[Loss], list[int]]:
    """Leave turns out that are not whole; return the losses in them, and those that are broken."""
    losses = find_losses(problem)
    problem.leave_out([loss.segment for loss in losses])
    broken = find_broken(problem)
    if broken:
        problem.leave_out(broken)
        # What others miss shows now.
        more = find_losses(problem)
        problem.leave_out([loss.segment for loss in more])
        losses += more
    return losses, broken


def find_broken(problem: SelfProblem) -> list[int]:
    """Return the turns that end where they did not lead, each in a fit without those before it.

    Of a turn that a logger slept through a part is missing, and no clock tells.
    """
    grid = problem.grid
    drop, turns = _kept(problem)
    out, twin = list[int](), problem.twin
    most = FEW * len(turns)
    while len(turns) >= FEWEST and len(out) <= most:
        closures = _Closures(grid, twin, turns, problem.noise)
        least = max(BROKEN, ALONE * float(np.median(closures.angle)))
        excess = closures.angle / np.maximum(least, SLIGHT * closures.turned)
        s = int(turns[np.argmax(excess)])
        if not excess.max() > 1.0:
            return out
        out.append(s)
        drop[s], turns = True, turns[turns != s]
        twin = fit_twin(grid, twin, problem.noise, drop=drop)
    return []


def _kept(problem: SelfProblem) -> tuple[BoolArray, IntArray]:
    """Return which segments are left out, to add to, and the turns that are not."""
    grid = problem.grid
    drop = np.zeros(len(grid.first), bool) if problem.drop is None else problem.drop.copy()
    return drop, np.flatnonzero(~grid.is_rest & ~drop)


class _Closures:
    """Closures of turns, and their sizes in scatters of them all.

    What jolts between its samples may add to a turn is in its own scatter: a sensor that is set
    down hard misses a velocity by as much, and samples put back there would undo it.
    """

    def __init__(self, grid: Grid, twin: Twin, turns: IntArray, noise: FloatArray) -> None:
        self._grid, self._twin, self._turns = grid, twin, turns
        self._state = true_state(grid, twin, headed=False)
        state, (points, first) = self._state, grid.points_of(turns)
        spans = Spans(grid.time[points], first)
        signals = state.force[points], state.rate[points]
        ups = twin.up[grid.before[turns]], twin.up[grid.after[turns]]
        closed = close_turns(spans, *signals, *ups, gravity=twin.gravity)
        left = closed.residual
        self.angle = np.linalg.norm(left[:, :2], axis=1)
        """By which turns are off, rad; `turned` is how far they went, to and fro."""
        speed = np.linalg.norm(signals[1], axis=1)
        self.turned = spans.duration * np.add.reduceat(speed, first[:-1]) / np.diff(first)
        # White noise of a rate turns the frame by the root of time, and gravity in it by time more.
        longer = np.maximum(spans.duration / np.median(spans.duration), 1.0)
        scale = np.repeat(np.sqrt([longer, longer**3]).T, (2, 3), axis=1)
        size = ROBUST * np.median(np.abs(left / scale), axis=0)
        scatter = np.repeat([size[:2].mean(), size[2:].mean()], (2, 3))
        self._scatter = np.zeros((len(grid.first), 5))
        jolts = unresolved(closed, *signals, noise[points], spans)
        white, leaned = _white(closed, noise[points], spans), _leaned(grid, twin, noise)
        for ends, pose in ((closed.before, grid.before), (closed.after, grid.after)):
            white += np.square(ends).sum(axis=2) * leaned[pose[turns], None]
        # Most turns show theirs; one that is shaken, or ends in a rest that is, has more.
        louder = np.maximum(white / scale**2 - np.median(white / scale**2, axis=0), 0.0)
        self._scatter[turns] = np.sqrt((scatter**2 + louder) * scale**2 + jolts)
        self.scores = self._sizes(left, turns)

    def mended(self, s: int) -> Loss:
        """Return the loss in one turn that leaves least of its closure."""
        own = slice(int(self._grid.first[s]), int(self._grid.last[s]))
        signals = self._grid.time[own], self._state.force[own], self._state.rate[own]
        last = len(signals[0]) - 2
        stride = max(1, last // PLACES)
        jump = _jump(np.hstack(signals[1:]))
        whole = Spans(signals[0], np.array([0, len(signals[0])]))
        path = follow_turns(whole, *signals[1:])

        def tried(places: Iterable[int], numbers: IntArray = TRIALS) -> FloatArray:
            """Return places, numbers, sizes of what is left, and how unlikely it is, (4, n)."""
            grid = np.meshgrid(np.fromiter(places, np.int64), numbers, indexing="ij")
            at, number = (values.ravel() for values in grid)
            mended, longer = _mended(signals, path, at, number)
            duration = signals[0][-1] - signals[0][0] + longer
            turns = np.full(len(at), s)
            size = self._sizes(self._residuals(turns, mended, duration), turns)
            unlikely = 5 * size**2 + jump[number, at] + 2 * np.log(number)
            return np.stack((at, number, size, unlikely))

        # A long shot first; then where the signals themselves jump, and about the better of them.
        sharp = int(np.argmin(jump[1:].min(axis=0)))
        first = tried(range(2, last, stride))
        best = first[:, np.argmin(first[3])]
        places = [int(best[0]), min(max(sharp, 2), last - 1)]
        near = sorted(
            {k for p in places for k in range(max(2, p - stride), min(last, p + stride + 1))}
        )
        found = np.hstack((first, tried(near)))
        # Of many, all numbers between those that were tried.
        at, number = found[:2, np.argmin(found[3])].astype(np.int64)
        beside = np.searchsorted(TRIALS, number)
        between = np.arange(
            TRIALS[max(beside - 1, 0)] + 1, TRIALS[min(beside + 1, len(TRIALS) - 1)]
        )
        between = between[~np.isin(between, TRIALS)]
        if len(between):
            about = range(max(2, at - number), min(last, at + number + 1))
            found = np.hstack((found, tried(about, between)))
        at, number, after, least = found[:, np.argmin(found[3])]
        before = float(self.scores[self._turns.tolist().index(s)])
        likely = jump[1:] <= SHARP * jump.min()
        if not likely[int(number) - 1, int(at)]:
            likely[:] = True
        # Few are lost more often than many: as often as their number is smaller.
        looks = int(np.ceil(number * (1.0 / np.arange(1, MOST + 1)) @ likely.sum(axis=1)))
        # What is left is then what interpolating misses, and no two numbers are told apart by less.
        weight = np.exp(
            0.5 * (least - found[3] - 5 * (after**2 - found[2] ** 2) * (1 - max(after, 1.0) ** -2))
        )
        moment = signals[0][found[0].astype(np.int64)]
        here = np.array([signals[0][int(at)], number])
        spread = np.sqrt(np.square(np.stack((moment, found[1])) - here[:, None]) @ weight)
        spread /= np.sqrt(weight.sum())
        speed = float(np.linalg.norm(signals[2][int(at)]))
        spread[1] = np.hypot(
            spread[1], _misjudged(signals, int(at), int(number)) / max(speed, 1e-9)
        )
        return Loss(
            int(s),
            float(here[0]),
            int(number),
            before,
            float(after),
            looks,
            tuple(spread.tolist()),
            self._foretold(s, signals, int(at)),
        )

    def _foretold(self, s: int, signals: Signals, at: int) -> float:
        """Return the least of the sizes with one sample of those near `at` as foretold."""
        time, both = signals[0], np.hstack(signals[1:])
        n = len(time)
        near = np.unique(np.clip(at + np.arange(-3, 3), 2, n - 3))
        case = np.arange(len(near))
        values = np.repeat(both[None], len(near), axis=0)
        beside, far = both[near - 1] + both[near + 1], both[near - 2] + both[near + 2]
        values[case, near] = (4 * beside - far) / 6
        clock = time + case[:, None] * (time[-1] - time[0] + 1.0)
        spans = Spans(clock.ravel(), n * np.arange(len(near) + 1))
        flat = values.reshape(-1, 6)
        ended = integrate_turns(spans, flat[:, :3], flat[:, 3:])
        turns = np.full(len(near), s)
        return float(self._sizes(self._residuals(turns, ended, spans.duration), turns).min())

    def _residuals(self, turns: IntArray, ended: Ended, duration: FloatArray) -> FloatArray:
        """Return the five residuals of each, (k, 5)."""
        up, gravity = self._twin.up, self._twin.gravity
        before, after = up[self._grid.before[turns]], up[self._grid.after[turns]]
        return open_ends(ended, before, after, duration, gravity=gravity)

    def _sizes(self, closures: FloatArray, turns: IntArray) -> FloatArray:
        return np.asarray(np.sqrt(np.mean(np.square(closures / self._scatter[turns]), axis=1)))


def _white(closed: Closures, noise: FloatArray, spans: Spans) -> FloatArray:
    """Return the variance (k, 5) of closures by noise (n, 6) of their points."""
    out = np.zeros((len(spans.start), 5))
    parts = (closed.accel_weights, noise[:, :3]), (closed.gyro_weights, noise[:, 3:])
    for weights, own in parts:
        each = np.einsum("rnc,nc->nr", np.square(weights), own)
        out += np.add.reduceat(each, spans.start)
    return out


def _leaned(grid: Grid, twin: Twin, noise: FloatArray) -> FloatArray:
    """Return the variance (p,) of the angles of poses, rad², by the noise of means over rests."""
    rest = grid.pose >= 0
    told = np.bincount(grid.pose[rest], 1.0 / noise[rest, :3].mean(axis=1), grid.n_poses)
    return np.asarray(1.0 / told / twin.gravity**2)


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
        change = _heavy(jump - number * step) - _heavy(jump)
        out[number, CONTEXT : len(values) - CONTEXT + 1] = change.sum(axis=1)
    return out


def _heavy(jump: FloatArray) -> FloatArray:
    """Return minus twice the log-likelihood of jumps in scatters, by Student's t of `FREEDOM`.

    A hand, or a table, makes jumps of its own, a few of which are many scatters large.
    """
    return np.asarray((FREEDOM + 1.0) * np.log1p(np.square(jump) / FREEDOM))


def _mended(
    signals: Signals, path: Ended, at: IntArray, count: IntArray
) -> tuple[Ended, FloatArray]:
    """Return where a turn ends with ``count[i]`` samples put in before sample ``at[i]``, k times.

    Far from there it turns as it did: what is integrated anew is a few samples on either side.
    Beside it, how much longer it takes.
    """
    n = len(signals[0])
    low, high = np.maximum(at - PART, 0), np.minimum(at + PART, n)
    near, first, longer = _put_back(signals, low, high, at, count)
    frame, velocity = follow_turns(Spans(near[0], first), *near[1:])
    a, b = low + EDGE * (low > 0), high - 1 - EDGE * (high < n)
    start, stop = first[:-1] + EDGE * (low > 0), first[1:] - 1 - EDGE * (high < n)
    leading = path.frame[a] @ np.swapaxes(frame[start], 1, 2)
    through = leading @ frame[stop] @ np.swapaxes(path.frame[b], 1, 2)
    gained = np.einsum("kij,kj->ki", leading, velocity[stop] - velocity[start])
    rest = np.einsum("kij,kj->ki", through, path.velocity[-1] - path.velocity[b])
    return Ended(through @ path.frame[-1], path.velocity[a] + gained + rest), longer


def _misjudged(signals: Signals, lost: int, number: int) -> float:
    """Return by how much, rad/s, rates put back for ``number`` samples at once are off in sum.

    At worst, as samples are missed where motion is fast: by leaving out as many at places all over
    the turn, but not beside where some are ``lost``.
    """
    time, *both = signals
    n = len(time) - number
    places = np.unique(np.linspace(2, n - 3, ELSEWHERE).astype(np.int64))
    off = []
    for at in places[(places > lost + EDGE) | (places + number < lost - EDGE)].tolist():
        low, high = max(at - PART, 0), min(at + PART, n)
        left = [np.delete(values, np.s_[at : at + number], axis=0) for values in both]
        where = [np.array([k]) for k in (low, high, at, number)]
        (_, _, rate), *_ = _put_back((time[:n], left[0], left[1]), *where)
        missing = slice(at - low, at - low + number)
        off.append(np.linalg.norm((rate[missing] - both[1][at : at + number]).sum(axis=0)))
    return float(np.max(off)) if off else np.inf


def _put_back(
    signals: Signals, low: IntArray, high: IntArray, at: IntArray, count: IntArray
) -> tuple[Signals, IntArray, FloatArray]:
    """Return the parts ``[low[i], high[i])`` of signals with ``count[i]`` samples put in, k times.

    One after another, each later than the last, and where each begins; and how much longer it is.
    """
    time, force, rate = signals
    step = float(np.median(np.diff(time)))
    both = np.hstack((force, rate))
    longer = np.asarray(count * step, np.float64)
    most = int(count.max())
    put = np.empty((len(at), most, both.shape[1]))
    fresh = time[at - 1, None] + step * np.arange(1, most + 1)
    # Near the ends of a turn there is less to interpolate from.
    width = high - low
    wanted = np.arange(most) < count[:, None]
    for points in np.unique(width):
        own = np.flatnonzero(width == points)
        near = low[own, None] + np.arange(points)
        true = time[near] + longer[own, None] * (near >= at[own, None])
        slopes = spline_slopes(true, both[near])
        gap = np.repeat(points * np.arange(len(own)) + at[own] - 1 - low[own], count[own])
        flat = (true.ravel(), both[near.ravel()], slopes.reshape(near.size, -1))
        mine = wanted & (width == points)[:, None]
        put[mine] = spline_between(*flat, gap, fresh[mine])
    first = np.append(0, np.cumsum(width + count))
    case = np.repeat(np.arange(len(at)), width + count)
    index = low[case] + np.arange(first[-1]) - first[case]
    late = np.maximum(index - at[case] + 1, 0)
    new = (late > 0) & (late <= count[case])
    source = np.minimum(index - np.minimum(late, count[case]), high[case] - 1)
    whole = both[source]
    whole[new] = put[case[new], late[new] - 1]
    clock = time[source] + longer[case] * (late > count[case])
    clock[new] = fresh[case[new], late[new] - 1]
    clock += case * (time[-1] - time[0] + (most + 1) * step)
    return (clock, whole[:, :3], whole[:, 3:]), first, longer
