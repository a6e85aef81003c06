"""Moments at which samples are too few for a motion.

Where a turn begins at a constant pace, or a hand strikes, a motion has a corner: the spline through
its samples rounds that off, as a low-pass of the sensor would, for some samples about it. What
trembles faster than every third sample is followed nowhere.
"""

from __future__ import annotations

import numpy as np
from scipy.special import binom

from calib.mismatch.reference.truths import LONG_STEP
from calib.recording import Recording
from calib.stillness import runs
from calib.types import BoolArray, FloatArray

ORDER = 24
"""Of the differences that show what a spline does not follow, relative to the fastest signal that
samples can have. Of a sinusoid at a quarter of the rate they leave 2e-4, as much as the spline errs
by; of a slower one, less than any noise. About a corner the spline errs by three times as much."""

FEWEST = 2 * ORDER
"""Samples that show how large they are."""

SPREAD = 5
"""Samples over which differences are taken together: they pass through zero."""

FOLLOWED = 0.1
"""Size of the differences, in standard deviations of the noise, up to which a spline follows: it
errs by a third of one then."""

LONG, SHARE = FEWEST, 0.02
"""Samples of a run that corners do not make, not even two, and the share of the samples in such
runs from which on it is no exception."""

JUMP = 25.0
"""Power of the differences, relative to that of noise, from which on a recording jumped: a step of
fifty times its noise. Noise alone never has as much."""

ALIKE = 0.1
"""Share of a jump's power, seen through a low-pass, that two that saw the same one do not share."""

SELDOM = 0.05
"""Share of the samples about jumps from which on they are how a body moves, and no exception."""

MOVES, HALF = 0.5, 0.5
"""rad/s from which on a motion is one, and the share of it that must be followed."""


_ALONE = binom(2 * ORDER, ORDER) / 4.0**ORDER
"""What the differences leave of white noise, of its variance."""


def unfollowed(recording: Recording, noise: FloatArray, own: FloatArray | None = None) -> BoolArray:
    """Return the samples (n,) about which a spline errs beside noise (2,) of both triads.

    The recording has noise of its ``own`` (2,), or none.
    """
    own = np.zeros(2) if own is None else own
    limits = 3.0 * (np.square(FOLLOWED * noise) + JUMP * _ALONE * np.square(own))
    each = zip((recording.accel, recording.gyro), limits, strict=True)
    return np.asarray(np.any([_differences(x) > limit for x, limit in each], axis=0))


def fast_power(signals: FloatArray, order: int) -> FloatArray:
    """Return the power of the differences of (n, 3) signals about each sample, (n,).

    It is relative to what such an order leaves of white noise: of that it is the variance.
    """
    return np.asarray(_differences(signals, order) * 4.0**order / binom(2 * order, order))


def _differences(signals: FloatArray, order: int = ORDER) -> FloatArray:
    """Return the power of the differences of (n, 3) signals about each sample, (n,)."""
    kernel = binom(order, np.arange(order + 1)) * np.resize([1.0, -1.0], order + 1) / 2.0**order
    square = np.zeros(len(signals))
    if len(signals) > order:
        inner = slice(order // 2, -(order // 2))
        for own in signals.T:
            square[inner] += np.square(np.convolve(own, kernel, mode="valid"))
    return np.convolve(square, np.full(SPREAD, 1.0 / SPREAD), mode="same")


def shared_jumps(
    recording: Recording, noise: FloatArray, kept: FloatArray, seen: FloatArray, reach: int
) -> BoolArray:
    """Return the samples (n,) near which a motion jumped between two samples, for both to see.

    A body is let go, or strikes: when between the samples it was neither tells, and at most rates
    a jump in an uncertain moment is a pulse. What a sensor does alone (a step, a spike, lost
    samples) its reference does not show, nor what moves on in a gap of the sensor's own.

    Parameters
    ----------
    recording : Recording
        With noise (2,) of both triads.
    kept, seen : (n, 6) arrays
        What a low-pass leaves of it, and of its reference at its times.
    reach : int
        Samples over which the low-pass spreads a jump.
    """
    out = np.zeros(len(recording), bool)
    torn = np.diff(recording.time, prepend=recording.time[0]) > LONG_STEP * recording.interval
    torn = np.convolve(torn, np.ones(ORDER + 2 * SPREAD), mode="same") > 0
    for k, signals in enumerate((recording.accel, recording.gyro)):
        jumps = (_differences(signals) > JUMP * 3.0 * _ALONE * noise[k] ** 2) & ~torn
        first, last = runs(jumps)
        if (last - first > LONG).any():
            continue
        own, other = kept[:, 3 * k : 3 * k + 3], seen[:, 3 * k : 3 * k + 3]
        for a, b in zip(first, last, strict=True):
            about = slice(max(a - reach, 0), b + reach)
            shown = own[about] - own[about].mean(axis=0)
            left = (own - other)[about]
            left = left - left.mean(axis=0)
            out[about] |= np.square(left).sum() < ALIKE * np.square(shown).sum()
    return out


def is_common(unfollowed: BoolArray, rate: FloatArray) -> bool:
    """Whether samples (n,) that a spline does not follow are more than corners here and there.

    ``rate`` (n, 3) are their rates of rotation, of which most must be left.
    """
    first, last = runs(unfollowed)
    length = last - first
    moves = np.linalg.norm(rate - np.median(rate, axis=0), axis=1) > MOVES
    long = length[length > LONG].sum() > SHARE * len(unfollowed)
    return bool(long or unfollowed[moves].sum() > HALF * moves.sum())
