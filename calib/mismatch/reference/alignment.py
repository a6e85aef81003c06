"""Where one recording lies in the time of another, from the rotation that both saw.

The size of the angular rate needs no common frame, so it is what is correlated. Where clocks run
apart by more than a motion bears, a lively stretch is correlated with the reference stretched by
one share after the other. The offset of the best normalised correlation is refined by the same
correlation in parts of the recording: a line through the parts' offsets is the offset and the rate
of one clock against the other.

References
----------
.. [1] J. P. Lewis, "Fast normalized cross-correlation", Vision Interface, 1995, eq. (2): the energy
   under every lag from running sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.errors import NoCommonMotionError
from calib.mismatch.reference.stilled import BIASED
from calib.mismatch.reference.truths import near
from calib.types import BoolArray, FloatArray, IntArray

LEAST_CORRELATION = 0.5
"""Of the sizes of the rates: below it the two did not see the same motion. Noise and unlike motion
of some length reach 0.3."""

LEAST_OVERLAP = 5.0
"""s that the two must have in common."""

STEP = 0.01
"""s between the samples that are correlated (the recordings' own where they are slower)."""

MOVING = 0.05
"""rad/s: root-mean-square change of rate below which there is no motion to align by."""

RESTING = 0.2
"""Share of the samples near their median from which that is what a gyroscope shows at rest."""

PART, FEWEST = 20.0, 6
"""s of a part whose own offset is measured, where there are so many parts. Of fewer they are
shorter."""

REACH = 0.5
"""s by which a part's offset may differ from its neighbour's."""

LONGER, FASTER = 50.0, 10.0
"""Times by which one lasts longer, or turns faster, from which units are in doubt."""

CLEAR = 0.99
"""Correlation from which on clocks run alike: below, they may run apart, and what repeats itself
may match at another time."""

FASTEST = 0.1
"""Share by which one clock may be faster than the other: oscillators of the cheapest parts, or a
rate that a data sheet gives within so much."""

AGAIN, KNOWN = 2, 0.5
"""How often gaps are left out, at most, as the first time is off by what they hide; and the share
that must be left: a profile of corners has nothing between these."""

LIVELY = 120.0
"""s of the recording that are tried against a stretched reference."""

COARSE = 0.05
"""s between samples then; a stretch moves the ends of what is tried by twice that at most."""


@dataclass(frozen=True)
class Alignment:
    """``t_ref = t + offset + stretch * (t - middle)``."""

    offset: float
    stretch: float
    middle: float
    correlation: float = 1.0

    def times(self, time: FloatArray) -> FloatArray:
        """Return the reference's times at the recording's times."""
        return np.asarray(time + self.offset + self.stretch * (time - self.middle))

    def moments(self, time: FloatArray) -> FloatArray:
        """Return the recording's times at the reference's times."""
        early = time - self.offset + self.stretch * self.middle
        return np.asarray(early / (1.0 + self.stretch))

    def moved(self, offset: float, stretch: float) -> Alignment:
        """Return the alignment with both changed."""
        return Alignment(
            self.offset + offset, self.stretch + stretch, self.middle, self.correlation
        )


def align(
    time: FloatArray, rate: FloatArray, ref_time: FloatArray, ref_rate: FloatArray
) -> Alignment:
    """Find the reference's time at each of a recording's.

    What one of them lacks in a gap is then left out of the other as well, and the time found again:
    a gap may hide the fastest turn.

    Parameters
    ----------
    time, ref_time : (n,), (m,) arrays, s
    rate, ref_rate : (n, 3), (m, 3) arrays, rad/s
        In any two frames.

    Raises
    ------
    NoCommonMotionError
        If either is at rest all along, or they do not show the same motion.
    """
    found = _aligned(time, rate, ref_time, ref_rate)
    for _ in range(AGAIN):
        own = _outside_gaps(ref_time, found.times(time))
        other = _outside_gaps(time, found.moments(ref_time))
        if (own.all() and other.all()) or min(own.mean(), other.mean()) < KNOWN:
            break
        found = _aligned(time[own], rate[own], ref_time[other], ref_rate[other])
    return found


def _outside_gaps(known: FloatArray, time: FloatArray) -> BoolArray:
    """Return where times (n,) are in no gap of what is known, (n,) bool."""
    return np.asarray(near(known, time) | (time < known[0]) | (time > known[-1]))


def _aligned(
    time: FloatArray, rate: FloatArray, ref_time: FloatArray, ref_rate: FloatArray
) -> Alignment:
    step = max(STEP, _interval(time), _interval(ref_time))
    a, b = _even(time, rate, step), _even(ref_time, ref_rate, step)
    units = _units(a, b, step)
    for name, values, usual in (
        ("the recording", a, _steady(rate, BIASED)),
        ("the reference", b, _steady(ref_rate, MOVING)),
    ):
        if len(values) * step < LEAST_OVERLAP:
            raise NoCommonMotionError(
                f"{name} lasts {len(values) * step:.1f} s; at least {LEAST_OVERLAP:g} s of common "
                f"motion are needed to align the two in time{units}"
            )
        # A mean over a step is of half of one at either end.
        if usual and values[1:-1].std() < MOVING:
            raise NoCommonMotionError(
                f"{name} turns at one rate all along, {np.degrees(usual):.3g} dps, and the two "
                "cannot be aligned in time by that: let both begin before the spin-up and end "
                "after the spin-down"
            )
        if values.std() < MOVING:
            raise NoCommonMotionError(
                f"{name} does not turn (its rate changes by {np.degrees(values.std()):.2f} dps): "
                f"there is no motion to align the two in time by{units}"
            )
    least = round(LEAST_OVERLAP / step)
    match, faster = _best_lag(a, b, least), 0.0
    if match.value < CLEAR:
        share = _likeliest_share(a, b, step)
        stretched = _even(ref_time / (1.0 + share), ref_rate, step)
        other = _best_lag(a, stretched, least)
        if other.likelihood > match.likelihood:
            match, faster, b = other, share, stretched
    if match.value < LEAST_CORRELATION:
        raise NoCommonMotionError(
            "the two do not show the same motion: the correlation of their rates is "
            f"{max(match.value, 0.0):.2f} at best, expected at least {LEAST_CORRELATION:g}; check "
            f"that they belong together{units}"
        )
    lag = match.lag
    # a[k] = b[k + lag]
    offset = float(ref_time[0] / (1.0 + faster) - time[0]) + lag * step
    middle = 0.5 * float(time[0] + time[-1])
    found = _parts(a, b, lag, step)
    stretch = 0.0
    if len(found) >= 3:
        at, shift, weight = np.array(found).T
        design = np.stack((np.ones(len(at)), at + time[0] - middle), axis=1)
        for _ in range(5):
            root = np.sqrt(weight)
            line = np.linalg.lstsq(design * root[:, None], shift * root, rcond=None)[0]
            left = np.abs(shift - design @ line)
            weight = np.array(found)[:, 2] / (1 + np.square(left / max(np.median(left), 1e-4)))
        offset += float(line[0])
        stretch = float(line[1])
    elif found:
        offset += float(found[0][1])
    # By the clock that was made to run as the recording's.
    near = Alignment((1.0 + faster) * offset, (1.0 + faster) * stretch, middle, match.value)
    return near.moved(faster * middle, faster)


def _steady(rate: FloatArray, least: float) -> float:
    """Return how fast it usually turns, rad/s; 0 if that is less than ``least``."""
    usual = float(np.linalg.norm(np.median(rate, axis=0)))
    return usual if usual >= least else 0.0


def _units(a: FloatArray, b: FloatArray, step: float) -> str:
    """Return what to say of units where the two last, or turn, so differently; mostly nothing."""
    said = ""
    if len(a) and len(b) and not 1 / LONGER < len(b) / len(a) < LONGER:
        said += (
            f"; the recording lasts {len(a) * step:.3g} s and the reference {len(b) * step:.3g} s: "
            "check the unit of their times"
        )
    own, other = (float(v.std()) if len(v) else 0.0 for v in (a, b))
    if min(own, other) > 0 and not 1 / FASTER < other / own < FASTER:
        said += (
            f"; the rate of the reference changes by {other / own:.3g} times as much as that of "
            "the recording: check the unit of its angles or rates (1 rad is 57.3 degrees), and "
            "that of its times"
        )
    return said


def _interval(time: FloatArray) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def _even(time: FloatArray, rate: FloatArray, step: float) -> FloatArray:
    """Return the size of the rate on even times."""
    at = np.arange(time[0], time[-1], step)
    # What moves all along differs from its median, and by another one where it begins later. So
    # does a table that spins at one speed for long.
    usual = np.median(rate, axis=0)
    off = rate - usual
    at_rest = np.mean(np.abs(off).max(axis=1) < MOVING) > RESTING
    at_rest &= np.linalg.norm(usual) < BIASED
    size = np.linalg.norm(off if at_rest else rate, axis=1)
    sums = np.concatenate(([0.0], np.cumsum(0.5 * (size[1:] + size[:-1]) * np.diff(time))))
    # Means over a step about each time: no aliases where the recording is faster.
    edges = np.interp(np.append(at - 0.5 * step, at[-1:] + 0.5 * step), time, sums)
    out: FloatArray = np.diff(edges) / step
    return out


class _Match(NamedTuple):
    """At which lag, how well correlated, and how likely it is: a logarithm."""

    value: float
    lag: int
    likelihood: float


def _likeliest_share(a: FloatArray, b: FloatArray, step: float) -> float:
    """Return the share by which `b`, of ``step`` (s), is to be stretched to match `a` best."""
    thin = max(1, round(COARSE / step))
    a, b = (v[: len(v) // thin * thin].reshape(-1, thin).mean(axis=1) for v in (a, b))
    length = min(len(a), round(LIVELY / (thin * step)))
    power = np.convolve(np.square(a - np.median(a)), np.ones(length), mode="valid")
    start = int(np.argmax(power))
    piece, least = a[start : start + length], length // 2
    count = int(np.ceil(FASTEST * length / 4))
    shares = FASTEST * np.arange(-count, count + 1) / count
    at = np.arange(len(b))
    found = []
    for share in shares:
        stretched = np.interp(np.arange(0.0, len(b) / (1.0 + share)) * (1.0 + share), at, b)
        found.append(_best_lag(piece, stretched, least).likelihood)
    return float(shares[int(np.argmax(found))])


def _best_lag(a: FloatArray, b: FloatArray, least: int) -> _Match:
    """Return how ``a[k]`` matches ``b[k + lag]`` at the likeliest lag."""
    from scipy import fft  # only comparisons need it

    a, b = a - a.mean(), b - b.mean()
    size = fft.next_fast_len(len(a) + len(b))
    product = fft.irfft(np.conj(fft.rfft(a, size)) * fft.rfft(b, size), size)
    lag = np.arange(-(len(a) - 1), len(b))
    first, last = np.maximum(-lag, 0), np.minimum(len(a), len(b) - lag)
    count = np.maximum(last - first, 1)
    sum_a, square_a = (_within(a**k, first, last) for k in (1, 2))
    sum_b, square_b = (_within(b**k, first + lag, last + lag) for k in (1, 2))
    # About the means of the overlap itself: two that are at rest there are not alike for that.
    match = product[lag] - sum_a * sum_b / count
    energy = (square_a - sum_a**2 / count) * (square_b - sum_b**2 / count)
    least = min(least, len(a) // 2, len(b) // 2)
    # Short overlaps agree by chance, and so do stretches with little motion in either.
    floor = 0.02 * float(a @ a) * float(b @ b)
    usable = (last - first >= least) & (energy > floor)
    value = np.where(usable, match / np.sqrt(np.maximum(energy, floor)), -1.0)
    # Motion that repeats itself matches well in part: what counts is the likelihood of the whole.
    alike = np.clip(value, 0.0, 1.0 - 1e-9)
    likelihood = -0.5 * (last - first) * np.log1p(-np.square(alike))
    best = int(np.argmax(likelihood))
    return _Match(float(value[best]), int(lag[best]), float(likelihood[best]))


def _within(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    sums = np.concatenate(([0.0], np.cumsum(values)))
    return np.asarray(sums[last] - sums[first])


def _parts(a: FloatArray, b: FloatArray, lag: int, step: float) -> list[tuple[float, float, float]]:
    """Return (time, offset against `lag`, weight) of each part, outwards from the most lively.

    Each part is searched about its neighbour's offset, so that clocks may drift apart by far.
    """
    whole = min(len(a), len(b) - lag) - max(0, -lag)
    width = min(round(PART / step), max(whole // FEWEST, round(LEAST_OVERLAP / step)))
    reach = round(REACH / step)
    starts = np.arange(max(0, -lag), min(len(a), len(b) - lag) - width + 1, width)
    if not len(starts):
        return []
    power = np.array([a[s : s + width].var() for s in starts])
    seed = int(np.argmax(power))
    out: list[tuple[float, float, float]] = []
    for order in (range(seed, len(starts)), range(seed - 1, -1, -1)):
        here = 0.0 if not out else out[0][1]
        for k in order:
            if power[k] < 0.05 * power[seed]:
                continue
            found = _part(a, b, int(starts[k]), width, lag + round(here / step), reach)
            if found is None:
                continue
            here = (found - lag) * step
            out.append(((starts[k] + 0.5 * width) * step, here, float(power[k])))
    return out


def _part(
    a: FloatArray, b: FloatArray, start: int, width: int, lag: int, reach: int
) -> float | None:
    own = a[start : start + width]
    low, high = start + lag - reach, start + lag + reach + width
    if low < 0 or high > len(b):
        low, high = max(low, 0), min(high, len(b))
        if high - low < width + 3:
            return None
    windows = np.lib.stride_tricks.sliding_window_view(b[low:high], width)
    centred = own - own.mean()
    match = windows @ centred
    spread = np.sqrt(np.maximum(width * windows.var(axis=1) * (centred @ centred), 1e-300))
    value = match / spread
    k = int(np.argmax(value))
    if value[k] < LEAST_CORRELATION or not 0 < k < len(value) - 1:
        return None
    below, here, above = value[k - 1 : k + 2]
    bend = below - 2 * here + above
    fine = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return low + k + fine - start
