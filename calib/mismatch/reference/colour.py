"""The colour of differences, and what they are seen through so that their noise is white.

What a captured motion says of rates and accelerations are derivatives of what was seen: its noise
grows with frequency. Seen through ``1 / sqrt(S(f) / S(0))`` every frequency counts by what it
tells; the response at zero frequency is 1, so that a constant stays what it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import fft
from scipy import linalg, sparse

from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

PASSED = 0.898
"""Noise bandwidth of `calib.mismatch.reference.filters.smoothed`, relative to its cut-off."""

PART, LONG_PART = 1.5, 6.0
"""s of the parts that spectra are taken of: short, so that most of them hold no turn; and where
turns do not matter."""

FEW_PARTS = 8
"""Parts that show a spectrum at least."""

SLOWEST = 1.0
"""Hz: noise below is drift, which has a model of its own."""

STEEPEST = 1e4
"""Power of the noise at the cut-off, relative to that at rest, beyond which it is taken as this."""

FAST = 0.98
"""Share of the samples that turn slower than the motion at its fastest."""


SURE = 4.0
"""Square of the standard errors by which the colour of noise must need another power."""

ALIKE_BESIDE = 1.0 + 2.0 * (2.0 / 3.0) ** 2 + 2.0 * (1.0 / 6.0) ** 2
"""What spectra through a Hann window vary by where they are smooth, relative to one frequency's
variance: neighbours are alike."""

LOOSE = 30.0
"""How large, in its typical size, an effect may be that is no noise."""

ALIKE = 1e-6
"""Of a column's square, what is left of it beside others that counts as none."""


class Blur(NamedTuple):
    """What signals are seen through: from n points to the m that are ``seen``.

    ``matrices`` (m, n) are those of accelerometer and gyroscope, ``power`` how many of the m points
    are independent on either, as a share. Where the noise of the n points is white, it is not
    afterwards; if the blur ``whitens``, it is the other way round: of white noise that comes on top
    (shaking) the shares ``white`` are seen on either, and slow noise whole. What shakes at one
    moment is ``heard`` around it, through the low-pass too: so its variance is spread. Where
    the truth knows forces at rest only, the accelerometer is ``judged`` at some of the m points.

    With orientations ``mat_ns`` (n, 3, 3) the gyroscope is seen in a frame that does not turn, and
    turned back at each point: a channel is then seen on the others of its triad as well.
    """

    matrices: tuple[sparse.csr_matrix, sparse.csr_matrix]
    seen: IntArray
    power: tuple[float, float]
    whitens: bool = False
    white: tuple[float, float] = (1.0, 1.0)
    heard: tuple[FloatArray, FloatArray] = (np.ones(1), np.ones(1))
    judged: BoolArray | None = None
    mat_ns: FloatArray | None = None

    @property
    def clear(self) -> bool:
        """Whether points are seen as they are."""
        return self.power == (1.0, 1.0) and not self.whitens and self.judged is None

    @property
    def alike(self) -> list[list[int]]:
        """Return the channels that are seen on each other, in groups."""
        if self.mat_ns is None:
            return [[c] for c in range(6)]
        return [[0], [1], [2], [3, 4, 5]]

    def see(self, signals: FloatArray) -> FloatArray:
        """Return what is seen of (n, 6) signals, (m, 6)."""
        columns = [(name, values) for name, values in zip(CHANNELS, signals.T, strict=True)]
        return np.stack([np.sum(own, axis=0) for own in self.see_columns(columns)], axis=1)

    def see_columns(self, columns: list[tuple[str, FloatArray]]) -> list[list[FloatArray]]:
        """Return what is seen on each channel of (channel, (n,) values): lists of (m,) values."""
        seen: list[list[FloatArray]] = []
        for triad, matrix in enumerate(self.matrices):
            names = CHANNELS[3 * triad : 3 * triad + 3]
            own = [(names.index(name), values) for name, values in columns if name in names]
            if triad and own and self.mat_ns is not None:
                seen += self._in_one_frame(own)
                continue
            for k in range(3):
                mine = [values for i, values in own if i == k]
                if mine and not self.clear:
                    # All at once, which takes half of the time.
                    mine = list(np.ascontiguousarray((matrix @ np.stack(mine, axis=1)).T))
                seen.append(mine)
        return seen

    def _in_one_frame(self, columns: list[tuple[int, FloatArray]]) -> list[list[FloatArray]]:
        assert self.mat_ns is not None
        axis = np.array([i for i, _ in columns])
        values = np.stack([v for _, v in columns], axis=1)
        seen = np.zeros((3, len(self.seen), len(columns)))
        for mat in np.moveaxis(self.mat_ns, 1, 0):
            part = self.matrices[1] @ (mat[:, axis] * values)
            seen += mat[self.seen].T[:, :, None] * part
        return [list(own.T) for own in seen]

    def seen_by(self, weights: sparse.csr_matrix, channel: int) -> dict[int, sparse.csr_matrix]:
        """Return the (r, n) weights of values on channels for (r, m) weights of what is seen."""
        if self.clear:
            return {channel: weights}
        matrix = self.matrices[channel // 3]
        if channel < 3 or self.mat_ns is None:
            return {channel: weights @ matrix}
        out = dict.fromkeys((3, 4, 5), sparse.csr_matrix((weights.shape[0], matrix.shape[1])))
        for mat in np.moveaxis(self.mat_ns, 1, 0):
            part = weights @ sparse.diags(mat[self.seen, channel - 3]) @ matrix
            for j in range(3):
                out[3 + j] = out[3 + j] + part @ sparse.diags(mat[:, j])
        return out

    def judging(self, points: BoolArray) -> Blur:
        """Return the blur that sees nothing of the accelerometer but these of the n points."""
        own = (self.matrices[0] @ sparse.diags(points.astype(float))).tocsr()
        return self._replace(matrices=(own, self.matrices[1]), judged=points[self.seen])

    def counts(self, channel: int) -> BoolArray:
        """Return which of the m points tell of a channel."""
        if self.judged is None or channel >= 3:
            return np.ones(len(self.seen), bool)
        return self.judged


class Colour(NamedTuple):
    """Spectral density of noise relative to that of slow noise: ``1 + square f² + fourth f⁴``.

    The ``density`` of slow noise, SI/√Hz, is nan where it was not looked for.
    """

    square: float
    fourth: float
    density: float = np.nan

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the density at (n,) frequencies, Hz."""
        return np.asarray(1.0 + self.square * frequency**2 + self.fourth * frequency**4)


WHITE = Colour(0.0, 0.0)


def gaussian(time: FloatArray, width: float, interval: float) -> Blur:
    """Return the blur of points at (n,) times; those near a gap have none, and are not seen.

    Parameters
    ----------
    time : (n,) array, s
    width : float, s
        Standard deviation; 0 leaves the points as they are.
    interval : float, s
        Between neighbours.
    """
    reach = int(np.ceil(3.0 * width / interval))
    if not reach:
        same = sparse.identity(len(time), format="csr")
        return Blur((same, same), np.arange(len(time)), (1.0, 1.0))
    tap = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) * interval / width))
    tap /= tap.sum()
    seen = _away(time, reach, interval)
    matrix = _running(tap, seen, len(time))
    power = float(tap @ tap)
    return Blur((matrix, matrix), seen, (power, power))


def whitening(
    time: FloatArray,
    colours: list[Colour],
    interval: float,
    bands: tuple[float, float],
    mat_ns: FloatArray | None = None,
) -> Blur:
    """Return what makes low-passed noise of these colours (accelerometer, gyroscope) flat.

    Parameters
    ----------
    time : (n,) array, s
    colours : two of Colour
    interval : float, s
    bands : two floats, Hz
        Up to where accelerometer and gyroscope are seen. The higher is the cut-off of the low-pass
        that both have passed; the other passes its own here.
    mat_ns : (n, 3, 3) array, optional
        Orientations, where the gyroscope's colour is that in a frame that does not turn.
    """
    size = 2 * int(np.ceil(PART / interval))
    taps, heard = [], []
    frequency = np.asarray(fft.rfftfreq(size, interval), np.float64)
    for colour, band in zip(colours, bands, strict=True):
        response = 1.0 / np.sqrt(colour.at(frequency))
        passed = response / (1.0 + (frequency / band) ** 8)
        taps.append(fft.irfft(passed if band < max(bands) else response, size)[: size // 2])
        both = np.square(fft.irfft(passed, size))
        heard.append(np.roll(both, size // 2)[1:] / both.sum())
    # As far as anything of it is left.
    left = np.max([np.abs(t) / np.abs(t).max() for t in taps], axis=0)
    reach = int(np.flatnonzero(left > 3e-3)[-1])
    seen = _away(time, reach, interval)
    matrices = []
    for half in taps:
        tap = np.concatenate((half[reach:0:-1], half[: reach + 1]))
        matrices.append(_running(tap / tap.sum(), seen, len(time)))
    accel, gyro = (
        float(np.mean(1.0 / colour.at(np.linspace(0.0, PASSED * band, 50))))
        for colour, band in zip(colours, bands, strict=True)
    )
    each = (
        min(1.0, 2.0 * PASSED * bands[0] * interval),
        min(1.0, 2.0 * PASSED * bands[1] * interval),
    )
    return Blur(
        (matrices[0], matrices[1]),
        seen,
        each,
        whitens=True,
        white=(accel, gyro),
        heard=(heard[0], heard[1]),
        mat_ns=mat_ns,
    )


def steepest_beside(rate: FloatArray) -> float:
    """Return how steep, in s², the density of a motion's noise can be, of its rates (n, 3), rad/s.

    A turn makes slow noise of rates of the noise of angles: ``w x angle`` beside ``d(angle)/dt``.
    """
    turning = float(np.quantile(np.linalg.norm(rate, axis=1), FAST))
    return (2 * np.pi / max(turning, 1e-3)) ** 2


def find_colour(
    time: FloatArray,
    left: FloatArray,
    interval: float,
    band: float,
    *,
    steepest: float = np.inf,
    least: float = 0.0,
    long: bool = False,
    highest: float | None = None,
) -> Colour:
    """Return the colour of (n, k) differences that passed `filters.smoothed`.

    The median over parts counts little of what a few turns have of their own. ``steepest`` bounds
    the rise with the square of the frequency, 1/Hz². Parts may be ``long``. Only what is below the
    ``highest`` frequency counts, the low-pass's ``band`` if it is not given. Slow
    noise has the density ``least`` (SI/√Hz) at least, unless all there is has less.
    """
    from scipy.optimize import nnls  # a fifth of a second to import

    for part in (LONG_PART, PART) if long else (PART,):
        length = max(int(part / interval), 16)
        starts = np.arange(0, len(time) - length + 1, max(length // 2, 1))
        even = time[starts + length - 1] - time[starts] < (length + 0.5) * interval
        if even.sum() >= FEW_PARTS:
            break
    else:
        return WHITE
    parts = np.stack([left[a : a + length] for a in starts[even]])
    window = np.hanning(length)
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window[:, None]
    density = np.median(np.square(np.abs(fft.rfft(parts, axis=1))), axis=0).mean(axis=1)
    frequency = fft.rfftfreq(length, interval)
    own = (frequency >= SLOWEST) & (frequency <= 0.9 * (highest or band))
    if own.sum() < 4:
        return WHITE
    f = frequency[own]
    density = density[own] * np.square(1.0 + (f / band) ** 8)
    design = np.stack((np.ones(len(f)), f**2, f**4), axis=1)
    fits = []
    for powers in ([0, 1], [0, 2], [0, 1, 2]):
        found, expected = np.zeros(3), density
        for _ in range(3):
            found[powers] = nnls(design[:, powers] / expected[:, None], density / expected)[0]
            expected = design @ found
        fits.append((float(np.square(density / expected - 1.0).sum()), found, expected))
    # Both powers of the frequency leave open what is slow: one of them is enough for most.
    simple, both = min(fits[:2], key=lambda fit: fit[0]), fits[2]
    error = ALIKE_BESIDE / np.log(2.0) ** 2 / (even.sum() * left.shape[1])  # of medians, squared
    _, found, expected = both if simple[0] - both[0] > SURE * error else simple
    # Half of the squares of a frequency are below log 2 of their mean.
    unit = 2.0 * interval / np.log(2.0) / np.square(window).sum()
    slow = max(float(found[0]), float(found[1]) / steepest, float(expected[-1]) / STEEPEST)
    if least**2 < unit * expected[0]:
        slow = max(slow, least**2 / unit)
    level = unit * slow
    return Colour(float(found[1]) / slow, float(found[2]) / slow, float(np.sqrt(level)))


def explained_by(left: FloatArray, columns: list[tuple[str, FloatArray]], blur: Blur) -> FloatArray:
    """Return what columns explain of (n, 6) differences, as they are seen through a blur.

    Parameters
    ----------
    left : (n, 6) array
    columns : list of (channel, (n,) values)
        In their typical sizes: none is more than `LOOSE` of it.
    blur : Blur
        Its noise is white.
    """
    explained, seen = np.zeros_like(left), blur.see(left)
    views = blur.see_columns(columns)
    for group in blur.alike:
        mine = [(c, v) for name, v in columns if (c := CHANNELS.index(name)) in group]
        if not mine:
            continue
        parts = [np.stack(views[c], axis=1) for c in group]
        normal = sum(part.T @ part for part in parts)
        match = sum(part.T @ seen[:, c] for part, c in zip(parts, group, strict=True))
        size = np.sqrt(np.diag(normal))
        size[size == 0.0] = 1.0
        normal = normal / np.outer(size, size)
        # What is much alike is fitted as one, and what is none of it by none.
        loose = np.square(seen[:, group]).mean() / np.square(LOOSE * size)
        ridge = np.diag(ALIKE + np.minimum(loose, 1.0 / ALIKE))
        found = linalg.solve(normal + ridge, match / size, assume_a="pos") / size
        for (c, values), much in zip(mine, found, strict=True):
            explained[:, c] += much * values
    return explained


def _away(time: FloatArray, reach: int, interval: float) -> IntArray:
    """Return the indices of points with so many neighbours on either side, and no gap."""
    steps = np.concatenate(([0], np.cumsum(np.diff(time) > 1.5 * interval)))
    seen = np.arange(reach, len(time) - reach)
    whole: BoolArray = steps[seen + reach] == steps[seen - reach]
    return seen[whole]


def _running(tap: FloatArray, seen: IntArray, n: int) -> sparse.csr_matrix:
    reach = len(tap) // 2
    column = seen[:, None] + np.arange(-reach, reach + 1)
    row = np.repeat(np.arange(len(seen)), len(tap))
    return sparse.csr_matrix((np.tile(tap, len(seen)), (row, column.ravel())), shape=(len(seen), n))
