"""Even times for stamps that are coarse: written in tenths of a second, or by a clock that ticks.

Model: sample number ``k`` is taken at ``a + T k`` and stamped in ticks of ``r``, rounded or cut
off, so that ``stamp - a - T k`` lies in a band that is one tick high. Where ticks are no small part
of the interval, stamps beat with it: steps of 9, 10 and 11 samples, or two ticks at once now and
then. All stamps together tell the line far better than each does. What is missing is a shift of all
that follows by whole intervals, which no line within the band explains. A clock that changes its
pace is followed by the fewest straight pieces; rounding and cutting off differ by a shift of all
times.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from calib.types import BoolArray, FloatArray, IntArray

ROUNDED = "stamps rounded"
"""Key of a note: to what, and that samples were taken to be even."""

COARSE = 0.15
"""Of an interval; finer ticks are scatter, which `calib.timing` sees by the samples."""

FEWEST = 64
"""Samples below which stamps stay as they are."""

DIGIT = 1e-6
"""The finest tick that is looked for, s."""

EXACT = 1e-6
"""Of a tick: what ties and floating point leave a band higher."""

UNSTEADY = (EXACT, 0.05, 0.2, 0.5, 1.0)
"""Of a tick, or an interval if that is shorter: by how much bands are higher where what stamps is
late, too. The least that explains all stamps counts; whole samples stand out of all but the
last."""

SHARED = 0.95
"""Of steps, those that are some, at most, where stamps are shared and not by mistake alone."""

SPARED = 0.5
"""Of what seems to be lost, how much is left at most in a higher band where it is none."""

BEATS = 3
"""Steps that no exact stamps have, for each piece of a line, from which stamps are rounded: of so
many samples that were lost, hardly ever all lie on one line."""

PACE = 3e-4
"""By which crystals differ from themselves, at most: with temperature, from minute to minute."""

STEADY = 20.0
"""Time over which the clock that stamps is steady, s."""

PAUSE = 1.0
"""A hole this long (s) may be of any length."""

SPAN = 1024
"""Samples that tell roughly how far they are apart."""

SHORT = 16
"""Ticks that a line must explain at least to be one."""

MOST = 256
"""Shifts that are looked at, at most: of more, clocks are not even."""

HALVED = 50
"""Times that a range of slopes is halved: then nothing is left of it."""

THIN = 32
"""Stamps together of which the earliest and the latest tell where a clock is."""


class Even(NamedTuple):
    """Times (n,) s and numbers (n,) of samples, by stamps in ticks.

    ``interval`` (s) is from sample to sample. So many samples may be missing, ``hidden``, within
    what ticks leave open.
    """

    time: FloatArray
    number: IntArray
    tick: float
    interval: float
    hidden: int

    @property
    def said(self) -> str:
        """What was done, for who reads it."""
        rate = 1.0 / self.interval
        pace = f"{rate:.2f}" if rate > 10.0 else f"{rate:.4g}"
        done = f"to {self.tick:.4g} s: samples are taken as even, at {pace} Hz"
        lost = "a lost sample" if self.hidden == 1 else f"{self.hidden} lost samples"
        return f"{done}; {lost} could hide in that" if self.hidden else done


def even_grid(stamps: FloatArray, lost: IntArray | None = None) -> Even | None:
    """Return the even times that explain coarse stamps within their ticks; None if none do.

    Parameters
    ----------
    stamps : (n,) array, s
        As written, never decreasing.
    lost : (n,) array of int, optional
        Samples known to be missing before each.
    """
    if len(stamps) < FEWEST:
        return None
    number = np.arange(len(stamps)) + (0 if lost is None else np.cumsum(lost))
    since = stamps - stamps[0]
    step = np.diff(since)
    if not since[-1] > 0:
        return None
    far = min(SPAN, len(stamps) // 2)
    interval = float(np.median((since[far:] - since[:-far]) / (number[far:] - number[:-far])))
    for tick in _ticks(step, interval):
        weight = _beats(step, np.diff(number), tick)
        if weight < BEATS:
            continue
        found = _steadiest(since, number, (tick, interval), weight)
        if found is not None:
            return found._replace(time=found.time + stamps[0])
    return None


def _steadiest(
    since: FloatArray, number: IntArray, steps: tuple[float, float], weight: int
) -> Even | None:
    """Return the times of the lowest band, unless a higher one spares most of its losses."""
    best, least = None, np.inf
    # A few losses of exact stamps lie near a line by chance, but hardly on one.
    for part in UNSTEADY if weight > FEWEST else UNSTEADY[:2]:
        found = _Line(since, number, *steps, part).found(weight)
        if found is None:
            continue
        shifts = int(np.count_nonzero(np.diff(found.number) != np.diff(number)))
        if best is None or shifts < SPARED * least:
            best, least = found, shifts
        if least < BEATS:
            break
    return best


def _ticks(step: FloatArray, interval: float) -> list[float]:
    """Return ticks that steps may be multiples of, s; of those that are coarse."""
    up = step[step > 0]
    digits = np.rint(up / DIGIT).astype(np.int64)
    if np.abs(up - DIGIT * digits).max() > 0.4 * DIGIT:
        return []
    whole = DIGIT * int(np.gcd.reduce(digits))
    out = [whole] if whole >= COARSE * interval else []
    # A tick that is no number of the digits written is off by one of them.
    if len(up) < SHARED * len(step):
        mean = float(up.sum() / np.rint(up / up.min()).sum())
        if mean > 2.0 * whole and np.abs(up - mean * np.rint(up / mean)).max() < 1.01 * whole:
            out.append(mean + whole)
    return out


def _beats(step: FloatArray, count: IntArray, tick: float) -> int:
    """Return how many steps no exact stamps have, or only for samples that are lost."""
    usual = float(np.median(step / count))
    ticks = np.rint(step / tick)
    if usual <= 0.5 * tick or np.count_nonzero(step <= 0) >= BEATS:
        return len(step)
    odd: BoolArray = np.abs(ticks * tick - usual * count) > 0.25 * tick
    part = ticks[odd] * tick / usual
    whole = bool(np.all(np.abs(part - np.rint(part)) < 0.01))
    return int(np.count_nonzero(odd)) if whole else len(step)


class _Line:
    """Stamps (n,) since the first, their numbers, and the band about a line that holds them."""

    def __init__(
        self, stamps: FloatArray, number: IntArray, tick: float, interval: float, part: float
    ) -> None:
        self._stamps, self._number, self._tick = stamps, number, tick
        self._band = tick + part * min(tick, interval)
        # Of samples with one stamp only the first and the last are near an edge of the band.
        edge = np.diff(stamps) > 0
        self._at = np.flatnonzero(np.r_[True, edge] | np.r_[edge, True])
        self._first = np.flatnonzero(np.r_[True, edge])
        self._range = 0.5 * interval, 1.5 * interval

    def found(self, weight: int) -> Even | None:
        """Return even times, if fewer shifts than ``weight`` tells of explain all stamps."""
        x = (self._number - self._number[0]).astype(np.float64)
        cut = self._pieces(x, *self._range)
        if cut is None:
            return None
        if len(cut) > 2:
            # Pieces that are short leave their pace open: that of the longest is all of theirs.
            k = int(np.argmax(np.diff(cut)))
            fit = _fit(*self._points(x, cut[k], cut[k + 1]), self._band, *self._range)
            assert fit is not None
            pace = fit[0]
            spread = self._band / (x[cut[k + 1] - 1] - x[cut[k]] + 1.0)
            cut = self._pieces(x, pace - spread - PACE * pace, pace + spread + PACE * pace)
            if cut is None:
                return None
            tried = [self._shifted(x, cut, pace, sure=sure) for sure in (True, False)]
        else:
            tried = [x]
        # Shifts that may be none are some where one clock explains the others by that alone.
        grids = (self._even(x, straight=straight) for straight in (True, False) for x in tried)
        found = next((grid for grid in grids if grid is not None), None)
        if found is None:
            return None
        shifts = int(np.count_nonzero(np.diff(found.number) != np.diff(self._number)))
        return found if weight >= BEATS * (1 + shifts) else None

    def _points(self, x: FloatArray, first: int, last: int) -> tuple[FloatArray, FloatArray]:
        low, high = np.searchsorted(self._at, [first, last])
        own = self._at[low:high]
        return x[own], self._stamps[own]

    def _pieces(self, x: FloatArray, low: float, high: float) -> list[int] | None:
        """Return the edges of stretches that are as long as a line explains, first to last."""
        at, n = self._at, len(self._at)
        y = self._stamps[at]
        cut, begin = [0], 0
        while begin < n:
            good, bad, size = begin + 1, n + 1, FEWEST
            bounds = low, high
            while bad - good > 1:
                end = min(begin + size, n) if bad > n else (good + bad) // 2
                fit = _fit(x[at[begin:end]], y[begin:end], self._band, *bounds)
                if fit is None:
                    bad = end
                else:
                    good, bounds = end, fit[1:]
                    if end == n:
                        break
                size *= 2
            if good < n and good - begin < SHORT:
                return None
            begin = good
            cut.append(int(at[good]) if good < n else len(x))
            if len(cut) > MOST:
                return None
        return cut

    def _shifted(self, x: FloatArray, cut: list[int], pace: float, *, sure: bool) -> FloatArray:
        """Return numbers with those counted that no line goes on without.

        Where ticks leave open whether any is missing, none are if ``sure``, or else as many as are
        likely.
        """
        x = x.copy()
        reach = max(FEWEST, round(STEADY / pace))
        for k, edge in enumerate(cut[1:-1], start=1):
            late = self._stamps - pace * x
            first, last = max(cut[k - 1], edge - reach), min(cut[k + 1], edge + reach)
            after = late[edge:last]
            # How far back what follows explains stamps: what is missing is missing from there on.
            back = late[first:edge][::-1]
            highest = np.maximum(np.maximum.accumulate(back), after.max())
            lowest = np.minimum(np.minimum.accumulate(back), after.min())
            since = edge - int(np.count_nonzero(highest - lowest <= self._band))
            if since <= first:
                continue
            before, after = late[first:since], late[since:last]
            most = (after.min() - before.max() + self._band) / pace + 0.02
            least = (after.max() - before.min() - self._band) / pace - 0.02
            missing = float(max(round(0.5 * (least + most)), 0))
            if pace * least > PAUSE and not least < missing < most:
                missing = 0.5 * (least + most)  # it began anew, at any moment
            if missing < least or missing > most or (sure and least <= 0):
                continue
            x[self._place(x, since, edge, pace) :] += missing
        return x

    def _place(self, x: FloatArray, since: int, edge: int, pace: float) -> int:
        """Return before which sample of a stretch some are likely to be missing.

        Those of one stamp are too few then: between which of them nobody can tell.
        """
        low, high = np.searchsorted(self._first, [since, edge], side="right")
        group = np.append(self._first, len(x) - 1)[max(low - 1, 0) : high + 1]
        step = np.diff(self._stamps[group])
        if not len(step):
            return edge
        k = int(np.argmax(step - pace * np.diff(x[group])))
        begin, end = int(group[k]), int(group[k + 1])
        place = end if step[k] > 1.5 * self._tick else (begin + end + 1) // 2
        return min(max(place, since), edge)

    def _even(self, x: FloatArray, *, straight: bool) -> Even | None:
        """Return the times of the clock that explains all stamps, be it in one piece or several."""
        y, at = self._stamps, self._at
        span = float(x[-1])
        fit = _fit(x[at], y[at], self._band, *self._range)
        if straight and fit is None:
            return None
        if fit is not None:
            pace = _middle(x[at], y[at], *fit[1:])
            late = y - pace * x
            time = pace * x + 0.5 * (late.max() + late.min())
            spare = max(self._band - float(np.ptp(late)), 0.0)
        else:
            pace = float(y[-1]) / span
            late = y - pace * x
            knots, level, spare = self._bent(x, late, pace)
            if not len(knots):
                return None
            time = pace * x + np.interp(x, knots, level)
        number = self._number[0] + np.rint(x).astype(np.int64)
        hidden = int(spare / pace + 0.01)
        return Even(time, number, self._tick, (time[-1] - time[0]) / span, hidden)

    def _bent(
        self, x: FloatArray, late: FloatArray, pace: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return numbers and levels of the fewest pieces that hold, and what is to spare."""
        edges = np.arange(0, len(x), THIN)
        parts = list(pairwise([*edges.tolist(), len(x)]))
        ends = np.array(
            [(a + int(late[a:b].argmax()), a + int(late[a:b].argmin())) for a, b in parts]
        )
        pieces = 2
        while pieces <= max(2, pace * x[-1] / STEADY):
            knots = np.linspace(0.0, x[-1], pieces + 1)
            level, height = _lowest_band(knots, x[ends], late[ends])
            if height <= self._band:
                return knots, level, self._band - height
            pieces *= 2
        return np.zeros(0), np.zeros(0), 0.0


def _fit(
    x: FloatArray, y: FloatArray, band: float, low: float, high: float
) -> tuple[float, float, float] | None:
    """Return a slope of a line that all points are within a band of, and bounds of all such.

    None if there is no such line. Each pair of points that is too far apart for a slope bounds it.
    """
    for _ in range(HALVED):
        slope = 0.5 * (low + high)
        left = y - slope * x
        i, j = int(left.argmax()), int(left.argmin())
        if left[i] - left[j] <= band:
            return slope, low, high
        apart = x[i] - x[j]
        if apart == 0:
            return None
        bound = float((y[i] - y[j] - band) / apart)
        low, high = (max(slope, bound), high) if apart > 0 else (low, min(slope, bound))
        if low > high:
            return None
    return None


def _middle(x: FloatArray, y: FloatArray, low: float, high: float) -> float:
    """Return the slope about which the band is lowest."""
    for _ in range(HALVED):
        slope = 0.5 * (low + high)
        left = y - slope * x
        apart = x[int(left.argmax())] - x[int(left.argmin())]
        if apart == 0:
            return slope
        low, high = (slope, high) if apart > 0 else (low, slope)
    return 0.5 * (low + high)


def _lowest_band(knots: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, float]:
    """Return levels at knots of the lowest band with straight pieces, and how high it is.

    Of earliest and latest points, (m, 2) each; a linear programme.
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, vstack

    width = len(knots)
    rows = []
    for column, sign in ((0, -1.0), (1, 1.0)):
        at = x[:, column]
        piece = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, width - 2)
        share = (at - knots[piece]) / (knots[piece + 1] - knots[piece])
        m = len(at)
        row = np.tile(np.arange(m), 3)
        value = np.concatenate((sign * (1.0 - share), sign * share, np.full(m, -0.5)))
        index = np.concatenate((piece, piece + 1, np.full(m, width)))
        rows.append((csr_array((value, (row, index)), shape=(m, width + 1)), sign * y[:, column]))
    scale = float(np.abs(y).max()) or 1.0
    solved = linprog(
        np.r_[np.zeros(width), 1.0],
        A_ub=vstack([matrix for matrix, _ in rows]),
        b_ub=np.concatenate([bound for _, bound in rows]) / scale,
        bounds=[(None, None)] * width + [(0, None)],
        method="highs",
    )
    if solved.x is None:
        return np.zeros(width), np.inf
    return scale * solved.x[:-1], scale * float(solved.x[-1])
