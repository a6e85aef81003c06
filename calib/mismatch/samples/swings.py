"""Lines in all rests as one signal: slow ones, and such as are faint in a periodogram of samples.

Mains that are sampled at nearly their own rate, a pump, a compressor: what swings once in a second
or in five is gone from the means of rests, and within each it is a wander like any other. But it
swings on through all of them. So all rests are seen as one signal, with nothing between them, whose
spectrum is as fine as the recording is long: what wanders is there at neighbouring frequencies, and
what swings stands out of them. So does a faster line of a tenth of a sample's noise, which hardly
stands out of periodograms of a second.

What both triads show, as gravity would have it, is motion of the sensor.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, fdtrc, logsumexp, softmax, spherical_jn

from calib.mismatch.findings.diagnosis import Interval, Unexplained
from calib.mismatch.hypotheses.ends import expected_overlap
from calib.mismatch.hypotheses.windows import windows
from calib.mismatch.samples.hand import HAND, SWING
from calib.mismatch.samples.knocks import knocked
from calib.mismatch.samples.power import CLAIM, LENGTH
from calib.mismatch.samples.spectrum import LINE, SHARE, coarse_at_rest
from calib.mismatch.samples.within import MARGIN
from calib.poses import Poses
from calib.read_once import HELD
from calib.recording import CHANNELS, TRIADS, Recording
from calib.types import BoolArray, FloatArray, IntArray

BLOCK = 6
"""Samples that are one here, where rests are long enough for periodograms of samples."""

BOTH_SIDES = 5
"""Bins of such a periodogram below which a line has too few neighbours there."""

LONGEST, SEVERAL = 20.0, 8
"""s of a rest, at most, and blocks, at least, that are one piece."""

FEWEST = 8
"""Pieces below which nothing is said, and of which the mean tells what all do alike."""

MOST = 1 << 18
"""Samples of which single ones are looked at, at most."""

SECTION = 1 << 15
"""Blocks of one spectrum, at most: of a longer recording it is the mean of several."""

WIDTHS = 4
"""Factor between widths in which power is summed: what swings at no steady pace is wider."""

SIDE, LEAST, APART = 24, 6, 2
"""Neighbours on either side that are compared, at most and at least, and how many are left out:
over these a line spreads."""

QUANTILES = 16
"""Lengths of pieces that stand for all of them."""

LOST, LOWEST = (0.3, 0.5), (0.6, 0.8)
"""Cycles in a piece below which its mean, or its straight line, takes nearly all of a line away,
and from which on one is looked for: of slower ones the means themselves tell."""

EFFICIENCY, SIDES = 2.0 / np.pi, 2
"""Of a median of many, relative to their mean; and of how many the larger is taken, which is at
least as certain a floor as one median of all: far out, noise stands out of it more seldom."""

BESIDE = 1.5
"""Times the highest frequency up to which a faster line spreads to it."""

FAINTEST = 0.003
"""Share of the noise power of samples that a line has which is reported: an amplitude of a twelfth
of a sample's noise."""

STEADY = 0.1
"""Hz over which a line spreads, at most, that is no tremor: those of hands are wider than 1 Hz."""

CHUNK, EVEN = 64, 256
"""Frequencies that have one median, and from which on: there these are a third of an octave."""

ALSO = 0.01
"""P-value below which another channel has the line of one."""


class _Signal(NamedTuple):
    """Means over blocks of samples at rest, without the mean of their piece of it.

    Or without its straight line, where a rest was cut into pieces.

    Parameters
    ----------
    at : (n,) array of int
        Their places in time, in blocks.
    piece : (n,) array of int
        Of which piece each is, from 0.
    values : (n, 6) array
    step : float, s
        Length of a block.
    length : (k,) array, s
        Of the pieces, as far as they are quiet.
    cut : (k,) array of bool
        Which are parts of a rest.
    interval : (k, 2) array, s
        When they begin and end.
    """

    at: IntArray
    piece: IntArray
    values: FloatArray
    step: float
    length: FloatArray
    cut: BoolArray
    interval: FloatArray


class _Line(NamedTuple):
    """What stands out at one frequency (Hz), over a width (Hz), on each channel, (6,).

    That is its power, the floor that it stands out of, as it was in a block, and how rarely noise
    alone stands out so far.
    """

    frequency: float
    width: float
    power: FloatArray
    floor: FloatArray
    chance: FloatArray


class _Scale(NamedTuple):
    """Power in parts of ``width`` bins from the first, its floor, and the p-values, (m, 6) each."""

    width: int
    power: FloatArray
    floor: FloatArray
    chance: FloatArray


def look_for_swings(
    recording: Recording, poses: Poses, known: Collection[str]
) -> list[Unexplained]:
    """Return slow and faint lines at rest, but not of channels of which more is `known`.

    One of several channels is one item.
    """
    coarse, _ = coarse_at_rest(recording, poses)
    unknown = [
        c
        for c, channel in enumerate(CHANNELS)
        if channel not in known
        and not coarse[c]
        and TRIADS[channel.split(".")[0]] not in recording.notes.get(HELD, "")
    ]
    # Periodograms of long rests have told what is faster, and is not faint.
    long = len(poses) and np.median(poses.stop - poses.start) >= LENGTH
    out = list[Unexplained]()
    for block, above in ((BLOCK, 0.0), (1, HAND[1])) if long else ((1, 0.0),):
        found = _look(recording, poses, unknown, block, above)
        out += found
        said = {channel for item in found for channel in item.channels}
        unknown = [c for c in unknown if CHANNELS[c] not in said]
    return out


def _look(
    recording: Recording, poses: Poses, channels: Sequence[int], block: int, above: float
) -> list[Unexplained]:
    """Return lines ``above`` a frequency in means over so many samples, on some channels."""
    signal = _at_rest(recording, poses, block)
    if signal is None:
        return []
    parts = [signal, *(_parts(signal) if block > 1 else ())]
    spectra = [_Spectrum(part, slow=block > 1, above=above) for part in parts]
    looks = sum(spectrum.looks for spectrum in spectra)
    gravity = float(np.linalg.norm(poses.accel, axis=1).mean())
    out = dict[float, Unexplained]()
    for c in channels:
        each = [
            (line, spectrum, part)
            for spectrum, part in zip(spectra, parts, strict=True)
            if (line := spectrum.most(c)) is not None
        ]
        if not each:
            continue
        line, spectrum, part = min(each, key=lambda one: float(one[0].chance[c]))
        if _moves(line, c, gravity):
            continue
        # What is as slow as a tremor, and too faint for the other triad, may be one; but no hand
        # keeps its pace for long.
        may_tremble = line.frequency <= HAND[1] and line.width > STEADY
        least = SHARE if may_tremble else FAINTEST * block
        p = float(line.chance[c]) * looks
        if p < CLAIM:
            where = _where(recording, signal, line, c)
            # All of its power in a part is where it is.
            power = line.power[c] / _share(part, where)
            if power < least * spectrum.noise[c]:
                continue
            item = Unexplained((CHANNELS[c],), (where,), f"{LINE}{line.frequency:.3g} Hz", p)
            same = [f for f in out if abs(f - line.frequency) <= APART * spectrum.resolution]
            at = same[0] if same else line.frequency
            out[at] = _both(out[at], item) if same else item
    return list(out.values())


def _both(one: Unexplained, other: Unexplained) -> Unexplained:
    """Return what is on the channels of two, as the more certain one has it."""
    (a, b), (c, d) = one.intervals[0], other.intervals[0]
    surer = min(one, other, key=lambda item: item.p_value)
    channels = (*one.channels, *other.channels)
    return replace(surer, channels=channels, intervals=((min(a, c), max(b, d)),))


def _at_rest(recording: Recording, poses: Poses, block: int) -> _Signal | None:
    """Return means over so many samples of rests as one signal, None of too few.

    Without what all rests do alike since they began: what settles does that.
    """
    interval = recording.interval
    step = interval * block
    margin = round(MARGIN / max(interval, 1e-9))
    quiet = ~knocked(recording, poses)
    pieces, began, cut = list[IntArray](), list[int](), list[bool]()
    for a, b in zip(poses.start.tolist(), poses.stop.tolist(), strict=True):
        own = a + margin + np.flatnonzero(quiet[a + margin : b - margin])
        number = int(np.ceil(len(own) * interval / LONGEST))
        parts = np.array_split(own, number) if number else []
        some = [part for part in parts if len(part) * interval >= SEVERAL * step]
        pieces += some
        began += [a] * len(some)
        cut += [number > 1] * len(some)
    if block == 1:
        # Of a day every so many rests tell enough of what is in all of them.
        each = slice(None, None, -(-sum(map(len, pieces)) // MOST) or 1)
        pieces, began, cut = pieces[each], began[each], cut[each]
    if len(pieces) < FEWEST:
        return None
    sample = np.concatenate(pieces)
    piece = np.repeat(np.arange(len(pieces)), [len(part) for part in pieces])
    place = ((recording.time[sample] - recording.time[0]) / step).astype(np.int64)
    at, first, count = np.unique(place, return_index=True, return_counts=True)
    every = np.hstack((recording.accel[sample], recording.gyro[sample]))
    values = np.add.reduceat(every, first) / count[:, None]
    piece = piece[first]
    begin = ((recording.time[began] - recording.time[0]) / step).astype(np.int64)
    values = values - _means(values, piece) - _slopes(values, piece, at, np.array(cut))
    values = values - _means(values, at - begin[piece], least=FEWEST)
    length = step * np.bincount(piece, minlength=len(pieces)).astype(np.float64)
    ends = np.array([recording.time[part[[0, -1]]] for part in pieces])
    return _Signal(at - at[0], piece, values, step, length, np.array(cut), ends)


def _parts(signal: _Signal) -> Iterator[_Signal]:
    """Yield halves and quarters of a signal, each half over the next: a line may be in one alone.

    Of a line in a quarter, a spectrum of the whole has a quarter of the height, in four bins.
    """
    number = len(signal.length)
    for parts in (2, 4):
        size = number // parts
        for first in range(0, number - size + 1, max(size // 2, 1)) if size >= FEWEST else ():
            own = slice(first, first + size)
            inside = slice(*np.searchsorted(signal.piece, [first, first + size]).tolist())
            at = signal.at[inside]
            yield signal._replace(
                at=at - at[0],
                piece=signal.piece[inside] - first,
                values=signal.values[inside],
                length=signal.length[own],
                cut=signal.cut[own],
                interval=signal.interval[own],
            )


def _means(values: FloatArray, which: IntArray, *, least: int = 1) -> FloatArray:
    """Return the mean of the (n, 6) values of its kind for each; 0 of kinds of fewer than least."""
    number = np.bincount(which)
    mean = np.stack([np.bincount(which, column) for column in values.T], axis=1)
    return np.asarray((mean * (number >= least)[:, None] / np.maximum(number, 1)[:, None])[which])


def _slopes(values: FloatArray, piece: IntArray, at: IntArray, cut: BoolArray) -> FloatArray:
    """Return what the (n, 6) values of pieces of ``cut`` rests rise by from their middles.

    A bias that drifts through such a rest would be a sawtooth, of the period of its pieces.
    """
    since = (at - _means(at[:, None].astype(np.float64), piece)[:, 0])[:, None]
    spread = _means(np.square(since), piece)
    slope = _means(since * values, piece) / np.maximum(spread, np.finfo(float).tiny)
    return np.where(cut[piece, None], slope * since, 0.0)


class _Spectrum:
    """The spectrum of a signal from one cycle in a rest on: white noise has the same everywhere.

    Parameters
    ----------
    signal : _Signal
    slow : bool
        Whether only those lines are looked for that no periodogram of samples tells.
    above : float, Hz
        From where on lines are looked for besides.
    """

    def __init__(self, signal: _Signal, *, slow: bool, above: float = 0.0) -> None:
        number = int(signal.at[-1]) + 1
        sections = -(-number // SECTION)
        size = -(-number // sections)
        power, part = np.zeros((size // 2 + 1, 6)), signal.at // size
        # Nothing is in those that a clock which is set has leapt over.
        known, count = np.unique(part, return_counts=True)
        for k in known.tolist():
            whole, own = np.zeros((size, 6)), part == k
            whole[signal.at[own] - k * size] = signal.values[own]
            power += np.square(np.abs(np.fft.rfft(whole, axis=0)))
        self._number = float(np.square(count).sum() / count.sum())
        # Independent values at one frequency: of sections, and of what is at rest in them.
        self._many = float(count.sum() / self._number)
        self._share = self._number / size
        self.resolution = 1.0 / (size * signal.step)
        frequency = self.resolution * np.arange(len(power))
        lost = np.zeros_like(frequency)
        for line in (False, True):
            own = signal.length[signal.cut == line]
            if len(own):
                typical = np.quantile(own, (np.arange(QUANTILES) + 0.5) / QUANTILES)
                taken = np.mean([_taken(frequency * t, line=line) for t in typical], axis=0)
                lost += taken * own.sum() / signal.length.sum()
        usual, kind = float(np.median(signal.length)), int(np.median(signal.cut))
        self._first = int(np.searchsorted(frequency, LOST[kind] / usual))
        power /= len(signal.at) * (1.0 - lost[:, None]).clip(1e-9)
        self._power = power[self._first : -1]
        self._lowest = max(LOWEST[kind] / usual, above)
        self._highest = BOTH_SIDES * BLOCK / (LENGTH * signal.step) if slow else np.inf
        self._scales = list(self._each())
        self.noise = np.median(self._power, axis=0)
        self.looks = float(sum(scale.chance.size for scale in self._scales))

    def _each(self) -> Iterator[_Scale]:
        width = 1
        while len(self._power) // width > 2 * (LEAST + APART):
            m = len(self._power) // width
            parts = self._power[: m * width].reshape(m, width, 6).mean(axis=1)
            floor, beside = _floors(parts)
            freedom = 2.0 * self._many * max(width * self._share, 1.0)
            low = chdtri(freedom, 0.5) / freedom
            floor = floor / low
            ratio = parts / np.where(floor > 0, floor, np.inf)
            inside = np.isfinite(floor[:, 0])
            scatter = np.median(np.abs(np.log(np.maximum(ratio[inside], 1e-12))), axis=0) / 0.6745
            own = np.minimum(freedom, 2.0 / np.maximum(np.square(scatter), 1e-9) + 2.0)
            of_floor = np.maximum(freedom * SIDES * beside * EFFICIENCY, 1.0)
            chance = fdtrc(own, of_floor[:, None], ratio)
            middle = self._middle(np.arange(m), width)
            beyond = (middle < self._lowest) | (middle > BESIDE * self._highest)
            chance[beyond | ~inside] = 1.0
            yield _Scale(width, parts, floor, chance)
            width *= WIDTHS

    def _middle(self, part: IntArray, width: int) -> FloatArray:
        bins = self._first + width * part + 0.5 * (width - 1)
        return np.asarray(bins * self.resolution)

    def most(self, channel: int) -> _Line | None:
        """Return what stands out most on one channel; None where nothing could."""
        if not self._scales:
            return None
        scale = min(self._scales, key=lambda s: float(s.chance[:, channel].min()))
        k = int(np.argmin(scale.chance[:, channel]))
        if not np.isfinite(scale.floor[k, channel]):
            return None
        # By its height: of lines that stand far out, all p-values are zero.
        found = np.flatnonzero(scale.chance[:, channel] <= scale.chance[k, channel])
        k = int(found[np.argmax(scale.power[found, channel])])
        near = slice(max(k - 1, 0), k + 2)
        over = (scale.power[near] - scale.floor[k]).sum(axis=0) * scale.width
        inside = self._power[k * scale.width : (k + 1) * scale.width, channel]
        at = self._first + k * scale.width + int(np.argmax(inside))
        frequency = at * self.resolution
        if frequency > self._highest:
            return None  # what is left of one that is faster
        power = 2.0 * np.maximum(over, 0.0) / self._number
        width = scale.width * self.resolution
        return _Line(frequency, width, power, scale.floor[k], scale.chance[k])


def _taken(cycles: FloatArray, *, line: bool) -> FloatArray:
    """Return the share of a line's power that a mean takes, by its cycles in the piece.

    That is ``j0(x)²`` with ``x = pi cycles``, and with a straight ``line`` ``3 j1(x)²`` besides, of
    spherical Bessel functions: what a wave of any phase has of Legendre polynomials.
    """
    x = np.pi * cycles
    return np.asarray(np.square(spherical_jn(0, x)) + 3.0 * line * np.square(spherical_jn(1, x)))


def _floors(parts: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the median of neighbours on the side where it is larger, (m, 6); of how many, (m,).

    Infinite where a side has too few. Where frequencies are a few per cent apart over more of them,
    these are as many as a chunk has.
    """
    near = _near_floors(parts[: EVEN + SIDE + APART])
    if len(parts) <= EVEN + SIDE + APART:
        return near
    out = _coarse_floors(parts)
    for whole, own in zip(out, near, strict=True):
        whole[:EVEN] = own[:EVEN]
    return out


def _near_floors(parts: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return what `_floors` does, of few frequencies."""
    m = len(parts)
    floor, number = np.full(parts.shape, np.inf), np.zeros(m, np.int64)
    side = min(SIDE, max((m - 2 * APART - 1) // 2, LEAST))
    reach = side + APART
    if m > 2 * reach:
        window = np.lib.stride_tricks.sliding_window_view(parts, side, axis=0)
        middle = np.median(window, axis=2)
        k = np.arange(reach, m - reach)
        floor[k] = np.maximum(middle[k - reach], middle[k + APART + 1])
        number[k] = side
        # One side is whole there, and known.
        for i in range(LEAST + APART, reach):
            floor[i] = np.maximum(np.median(parts[: i - APART], axis=0), middle[i + APART + 1])
            number[i] = i - APART
        for i in range(m - reach, m - LEAST - APART):
            floor[i] = np.maximum(middle[i - reach], np.median(parts[i + APART + 1 :], axis=0))
            number[i] = m - i - APART - 1
        return floor, number
    for i in range(LEAST + APART, m):
        below = parts[max(i - reach, 0) : i - APART]
        above = parts[i + APART + 1 : i + reach + 1]
        if min(len(below), len(above)) >= LEAST:
            floor[i] = np.maximum(np.median(below, axis=0), np.median(above, axis=0))
            number[i] = min(len(below), len(above))
    return floor, number


def _coarse_floors(parts: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return what `_floors` does, by medians of chunks: the largest of a value's own and beside."""
    chunks = len(parts) // CHUNK
    median = np.median(parts[: chunks * CHUNK].reshape(chunks, CHUNK, 6), axis=1)
    beside = np.pad(median, ((1, 1), (0, 0)), mode="edge")
    most = np.maximum(np.maximum(beside[:-2], beside[2:]), median)
    which = np.minimum(np.arange(len(parts)) // CHUNK, chunks - 1)
    return most[which], np.full(len(parts), CHUNK)


def _moves(line: _Line, channel: int, gravity: float) -> bool:
    """Whether the sensor itself swings: accelerometers show what gyroscopes' angle makes of g."""
    accel, gyro = line.power[:3].sum(), line.power[3:].sum()
    other = slice(3, 6) if channel < 3 else slice(0, 3)
    heavy = SWING * np.square(gravity / (2 * np.pi * line.frequency))
    return bool((line.chance[other] < ALSO).any() and accel > heavy * gyro)


def _share(signal: _Signal, where: Interval) -> float:
    """Return the share of a signal's length that is in an interval; 1 where none is."""
    middle = signal.interval.mean(axis=1)
    inside = (middle >= where[0]) & (middle <= where[1])
    return float(signal.length[inside].sum() / signal.length.sum()) or 1.0


def _where(recording: Recording, signal: _Signal, line: _Line, channel: int) -> Interval:
    """Return where a line is: throughout, or in the window that overlaps it most on average.

    Of its power in each piece the mean is one in and one out of the window; that it is throughout
    is as likely as that it is in any window.
    """
    turned = np.exp(-2j * np.pi * line.frequency * signal.step * signal.at)
    swing = signal.values[:, channel] * turned
    each = np.bincount(signal.piece, swing.real) + 1j * np.bincount(signal.piece, swing.imag)
    number = len(each)
    power = np.square(np.abs(each)) / (np.bincount(signal.piece) * line.floor[channel])
    total = np.append(0.0, np.cumsum(power))
    first, last = np.array([*windows(number), (0, number)]).T
    long, inside = last - first, total[last] - total[first]
    here = np.maximum(inside / long, 1.0)
    there = np.maximum((total[-1] - inside) / np.maximum(number - long, 1), 1.0)
    value = -long * np.log(here) - inside / here
    value -= (number - long) * np.log(there) + (total[-1] - inside) / there
    value[:-1] = np.where(here > there, value - np.log(len(value)), -np.inf)[:-1]
    if not value[-1] < logsumexp(value[:-1]):
        return float(recording.time[0]), float(recording.time[-1])
    begin, end = signal.interval[first[:-1], 0], signal.interval[last[:-1] - 1, 1]
    return expected_overlap(begin, end, softmax(value[:-1]))
