"""Temperature as it was, from what a thermometer reads: coarse steps, noise, held for seconds.

A part's temperature is smooth: it follows the heat that flows. So it is the smoothest path that
agrees with the readings, where each reading is the path plus noise, rounded. Rounding is no noise:
a coarse thermometer that stays at one reading says that the path is within half a step of it, and
one that goes to and fro between two that it is between them. For the path T in short cells of time

    log p(T) = sum_k n_k log(Phi((T - r_k + h) / s) - Phi((T - r_k - h) / s))
               - l^6 |D³ T|² / (2 s²)

with n_k readings r_k of noise s and half a step h, and third differences D³. Noise and smoothing
length l (in cells) are those of the highest evidence (Laplace's method).

References
----------
.. [1] Eilers, "A perfect smoother", Anal. Chem. 75, 2003, p. 3631 (penalised differences).
.. [2] MacKay, "Bayesian interpolation", Neural Computation 4, 1992, p. 415 (evidence).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.special import log_ndtr

from calib.recording import Recording
from calib.spline import spline_between, spline_slopes
from calib.types import BoolArray, FloatArray, IntArray

CELLS, LEAST = 400, 100
"""At most and at least so many cells, if the recording is long enough."""

CELL = 1.0
"""s that a cell is long where neither that nor the thermometer says otherwise."""

MOST = 1 << 19
"""Readings at most that are kept: of a day, six a second."""

FEW = 4
"""Different readings in a cell, on average, up to which a thermometer is coarse. Of more their mean
is much finer than a step."""

DIFFERENCES = np.array([-1.0, 3.0, -3.0, 1.0])
"""Third differences: a parabola costs nothing."""

ORDER = len(DIFFERENCES) - 1

LENGTHS = np.geomspace(CELLS / 6, 0.5, 14)
"""Smoothing lengths that are tried, in cells."""

NOISES = np.array([0.7, 1.0, 1.4])
"""Sizes that noise may have, relative to what successive differences make it."""

COARSE = np.geomspace(0.02, 0.8, 10)
"""The same of a coarse thermometer, in steps."""

NARROW = 1e-6
"""Half a step is at least so many times the noise: so that all noises compare."""

FAR = 30.0
"""Standard errors outside of a rounding interval from which its ends no longer matter."""

WINDOW = 10
"""Cells through which readings are looked at for how independent they are."""

GOLDEN, CLOSE = 0.5 * (np.sqrt(5.0) - 1.0), 0.1
"""The golden section, and the share of an interval of noises within which the best is found."""

STEPS = 30
"""Newton's steps at most."""


@dataclass(frozen=True, eq=False)
class _Readings:
    """Readings in cells of time.

    Parameters
    ----------
    time : (n,) array
        Middle of each cell.
    cell : (k,) array of int
        The cell of each reading.
    value : (k,) array
    weight : (k,) array
        How many there are of it.
    half : float
        Half the step that they are rounded to.
    noises : array
        Sizes that their noise may have: the least, some, and the most.
    """

    time: FloatArray
    cell: IntArray
    value: FloatArray
    weight: FloatArray
    half: float
    noises: FloatArray


@dataclass(frozen=True, eq=False)
class Temperature:
    """Temperature as it was: a smooth path, and how fast it goes.

    Before the first reading and after the last it is what these made it.

    Parameters
    ----------
    time : (k,) array, s
        Middles of cells.
    value, rate : (k,) arrays, °C and K/s
    first, last : float, s
        Of the readings.
    """

    time: FloatArray
    value: FloatArray
    rate: FloatArray
    first: float
    last: float

    def __call__(self, when: FloatArray) -> FloatArray:
        """Return the temperature at (n,) times, °C."""
        when = np.clip(when, self.first, self.last)
        near = np.clip(np.searchsorted(self.time, when) - 1, 0, len(self.time) - 2)
        path = spline_between(self.time, self.value[:, None], self.rate[:, None], near, when)
        return path[..., 0]

    def rate_at(self, when: FloatArray) -> FloatArray:
        """Return its rate at (n,) times, K/s.

        That of the path, which is as smooth as the readings let it be: a line through some seconds
        of them would be late by half of these where a recording begins, and heats fastest.
        """
        return np.interp(when, self.time, self.rate)

    def since(self, start: float) -> Temperature:
        """Return the same, with times counted from `start`."""
        first, last = self.first - start, self.last - start
        return replace(self, time=self.time - start, first=first, last=last)


def known_temperature(batches: Iterable[Recording]) -> Temperature | None:
    """Return the temperature of a recording of any length, or None if it was not measured.

    In memory for `MOST` of its readings: of more, each second one is left out, again and again.
    """
    parts: list[tuple[FloatArray, FloatArray]] = []
    every, offset, kept = 1, 0, 0
    for batch in batches:
        if batch.temperature is None:
            return None
        some = slice(-offset % every, None, every)
        parts.append((batch.time[some], batch.temperature[some]))
        offset += len(batch)
        kept += len(parts[-1][0])
        if kept > MOST:
            time, reading = map(np.concatenate, zip(*parts, strict=True))
            parts, every = [(time[::2], reading[::2])], 2 * every
            kept = len(parts[0][0])
    if not kept:
        return None
    time, reading = map(np.concatenate, zip(*parts, strict=True))
    return smooth_temperature(time, reading)


def smooth_temperature(time: FloatArray, reading: FloatArray) -> Temperature:
    """Return the temperature that (n,) readings at times in s agree with."""
    first, last = float(time[0]), float(time[-1])
    if first == last or np.ptp(reading) == 0:
        return _line(first, last, float(reading[0]), 0.0)
    readings = _in_cells(time, reading)
    if len(np.unique(readings.cell)) <= len(DIFFERENCES):
        line = np.polynomial.Polynomial.fit(time, reading, 1)
        return _line(first, last, float(line(first)), float(line.deriv()(first)))
    path = _smoothest(readings)
    rate = spline_slopes(readings.time, path[:, None])[:, 0]
    return Temperature(readings.time, path, rate, first, last)


def _line(first: float, last: float, value: float, rate: float) -> Temperature:
    """Return a temperature that goes on from a value at a rate."""
    time = np.array([first, max(last, np.nextafter(first, np.inf))])
    return Temperature(time, value + rate * (time - first), np.full(2, rate), first, last)


def _in_cells(time: FloatArray, reading: FloatArray) -> _Readings:
    step = _step(reading)
    new = np.flatnonzero(np.diff(reading)) + 1
    if np.median(np.abs(reading[new] - reading[new - 1])) > 1.5 * step:
        # No staircase: the thermometer measures anew only so often, and is read in between.
        time, reading = time[np.append(0, new)], reading[np.append(0, new)]
    span = float(time[-1] - time[0])
    width = max(span / CELLS, min(CELL, span / LEAST), span / len(time))
    n = max(int(np.ceil(span / width)), 1)
    width = span / n  # or the last one's readings would be earlier than its middle
    cell = np.minimum(((time - time[0]) / width).astype(np.int64), n - 1)
    middle = time[0] + width * (np.arange(n) + 0.5)
    count = np.bincount(cell, minlength=n)
    read = np.flatnonzero(count)
    mean = np.bincount(cell, reading, n)[read] / count[read]
    # From successive differences, which a smooth path hardly enters.
    noise = float(np.sqrt(np.square(np.diff(mean, 2)).mean() / 6.0)) if len(mean) > 2 else 0.0
    if step > max(noise, 1e-6 * float(np.ptp(mean))):
        code = np.round((reading - reading.min()) / step).astype(np.int64)
        pair, n_pair = np.unique(cell * (code.max() + 1) + code, return_counts=True)
        if len(pair) <= FEW * len(read):
            own, code_of = np.divmod(pair, code.max() + 1)
            weight = np.maximum(n_pair * _independent(cell, code), 1.0)
            value = reading.min() + step * code_of
            return _Readings(middle, own, value, weight, 0.5 * step, step * COARSE)
    noise = max(noise, 1e-6 * float(np.ptp(mean)), 1e-9)
    return _Readings(middle, read, mean, np.ones(len(read)), 0.0, noise * NOISES)


def _step(reading: FloatArray) -> float:
    """Return the step of the thermometer, by the readings that are nearest to each other."""
    gaps = np.diff(np.unique(reading[:: max(1, len(reading) // 20_000)]))
    if not len(gaps):
        return 0.0
    # Decimals of a file may be rounded on their own.
    return float(gaps[gaps > 1e-3 * np.median(gaps)].min())


def _independent(cell: IntArray, code: IntArray) -> float:
    """Return what share of the readings has noise of its own: they change so much less often."""
    window = cell // WINDOW
    count = np.maximum(np.bincount(window), 1)
    mean = np.bincount(window, code) / count
    share = mean - np.floor(mean)
    expected = 2.0 * float((share * (1.0 - share)) @ count)
    changes = int(np.count_nonzero(np.diff(code)))
    return min(changes / expected, 1.0) if expected > 0 else 1.0


def _smoothest(readings: _Readings) -> FloatArray:
    """Return the temperature in each cell, with noise and smoothing length of highest evidence."""
    n = len(readings.time)
    weight = np.bincount(readings.cell, readings.weight, n)
    known = np.flatnonzero(weight)
    sums = np.bincount(readings.cell, readings.weight * readings.value, n)
    start = np.interp(np.arange(n), known, sums[known] / weight[known])
    best, top = start, -np.inf
    # The longest first: for that any noise, for the others one like that of the one before.
    paths = [(_path(readings, start, float(noise), LENGTHS[0]), noise) for noise in readings.noises]
    (path, _), noise = max(paths, key=lambda found: found[0][1])
    for length in LENGTHS:
        near = np.log(noise) + np.array([-0.5, 0.5])
        near = np.clip(near, *np.log(readings.noises[[0, -1]]))
        low, high = np.exp(near)
        path, evidence, noise = _likeliest(readings, path, low, high, length)
        if evidence > top:
            best, top = path, evidence
    return best


def _likeliest(
    readings: _Readings, path: FloatArray, low: float, high: float, length: float
) -> tuple[FloatArray, float, float]:
    """Return the path with the noise between two that has the highest evidence, that, and it.

    By golden sections: each leaves the part of an interval in which the higher of two lies.
    """

    def at(share: float) -> tuple[FloatArray, float, float]:
        noise = low ** (1.0 - share) * high**share
        return (*_path(readings, path, noise, length), noise)

    a, b = 0.0, 1.0
    left, right = at(1.0 - GOLDEN), at(GOLDEN)
    while b - a > CLOSE:
        if left[1] > right[1]:
            b = a + GOLDEN * (b - a)
            right, left = left, at(b - GOLDEN * (b - a))
        else:
            a = b - GOLDEN * (b - a)
            left, right = right, at(a + GOLDEN * (b - a))
    return max(left, right, key=lambda found: found[1])


def _path(
    readings: _Readings, path: FloatArray, noise: float, length: float
) -> tuple[FloatArray, float]:
    """Return the most probable path for one noise and smoothing length, and the evidence."""
    stiff = length ** (2 * ORDER)
    rough = stiff * _roughness(len(path))
    half = np.full(len(readings.value), max(readings.half / noise, NARROW))
    top, move, log_det = -np.inf, np.zeros(len(path)), 0.0
    for _ in range(STEPS):
        there = path + move
        off = (there[readings.cell] - readings.value) / noise
        gain, *slopes = (readings.weight * v for v in _agreement(off, half))
        value = float(gain.sum() - 0.5 * stiff * np.square(_bent(there) / noise).sum())
        if value < top:
            # Too long a step: inside of a step of the thermometer there is hardly any curvature.
            move *= 0.5
            continue
        slope, curve = (np.bincount(readings.cell, v, len(path)) for v in slopes)
        # Where any path agrees nothing holds it: a small curvature holds the step.
        matrix = rough.copy()
        matrix[0] += np.maximum(curve, 1e-3)
        factor = cholesky_banded(matrix, lower=True)
        log_det = float(np.log(factor[0]).sum())
        push = noise * slope - stiff * _bent(_bent(there), back=True)
        gained, top, path = value - top, value, there
        move = cho_solve_banded((factor, True), push)
        if gained < 1e-2:
            break
    return path, top + 0.5 * (len(path) - ORDER) * np.log(stiff) - log_det


def _bent(path: FloatArray, *, back: bool = False) -> FloatArray:
    """Return ``D path``, or ``D' path``."""
    if back:
        return np.convolve(path, DIFFERENCES, mode="full")
    return np.convolve(path, DIFFERENCES[::-1], mode="valid")


def _roughness(n: int) -> FloatArray:
    """Return ``D'D`` of n cells, as the lower bands of a symmetric matrix."""
    out = np.zeros((ORDER + 1, n))
    for i in range(ORDER + 1):
        for j in range(i, ORDER + 1):
            out[j - i, i : n - ORDER + i] += DIFFERENCES[i] * DIFFERENCES[j]
    return out


def _agreement(u: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the log-likelihood of paths that are u noises off, its slope, and minus its curvature.

    By symmetry for u below zero: the interval is then at ``[a, b]`` with b the end that is nearer.
    """
    far = np.abs(u) - half
    a, b = -np.abs(u) - half, -np.abs(u) + half
    low, high = log_ndtr(a), log_ndtr(b)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        gain = high + np.log1p(-np.exp(low - high))
        at_a, at_b = (np.exp(-0.5 * v * v - gain) / np.sqrt(2 * np.pi) for v in (a, b))
        slope = at_b - at_a
        curve = b * at_b - a * at_a + np.square(slope)
    # A narrow interval is a point; of one that is far away the nearer end counts.
    point = half * np.maximum(np.abs(u), 1.0) < 1e-3
    away: BoolArray = ~point & (far > FAR)
    wide = np.log(2 * half / np.sqrt(2 * np.pi))
    for which, distance, plus in ((point, np.abs(u), wide), (away, far, np.minimum(wide, 0.0))):
        gain = np.where(which, plus - 0.5 * np.square(distance), gain)
        slope = np.where(which, distance, slope)
        curve = np.where(which, 1.0, curve)
    return gain, -np.sign(u) * slope, curve
