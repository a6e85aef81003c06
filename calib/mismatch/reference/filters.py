"""Filters without delay, for signals at times that may be uneven or have gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.mismatch.reference.truths import DEGREE, LONG_STEP, is_uneven
from calib.recording import Recording
from calib.types import FloatArray, IntArray

NARROWEST = 5.0
"""Hz: hand motion reaches so far in any case."""

FELT = 2.0
"""Periods of the cut-off within which the low-pass still passes 0.2 % of a step."""

ABOUT = 31
"""Frequencies of a spectrum whose mean power is that of the one in their middle."""


def low_passed(recording: Recording, bandwidth: float, *, forces: float | None = None) -> Recording:
    """Return the recording through the low-pass of `smoothed`; its forces may have their own."""
    cutoff = np.repeat([bandwidth if forces is None else forces, bandwidth], 3)
    signals = smoothed(recording.time, np.hstack((recording.accel, recording.gyro)), cutoff)
    return replace(recording, accel=signals[:, :3], gyro=signals[:, 3:])


def smoothed(time: FloatArray, values: FloatArray, bandwidth: float | FloatArray) -> FloatArray:
    """Return (n, k) values at (n,) times through ``1 / (1 + (f / bandwidth)**8)``, all or each.

    That is a Butterworth low-pass of fourth order there and back, of the same response at any rate:
    a digital one is warped, and two sampled at unlike rates would differ by their filters. Gaps are
    bridged by straight lines.
    """
    cutoff = np.broadcast_to(bandwidth, (values.shape[1],))
    slowest = float(cutoff.min())
    return filtered(time, values, lambda f: 1.0 / (1.0 + (f[:, None] / cutoff) ** 8), slowest)


def filtered(
    time: FloatArray,
    values: FloatArray,
    response: Callable[[FloatArray], FloatArray],
    slowest: float = NARROWEST,
) -> FloatArray:
    """Return (n, k) values at (n,) times through a filter without delay.

    Parameters
    ----------
    time, values : (n,) and (n, k) arrays
    response : function
        Of frequencies (m,), Hz: (m,), or (m, k) where columns have their own.
    slowest : float, Hz
        What it changes lasts a few of its periods: longer gaps are cut to that, and all are bridged
        by straight lines.
    """
    interval = float(np.median(np.diff(time)))
    at = places(time, int(np.ceil(FELT / (slowest * interval))))
    if is_uneven(time):
        return _passed_uneven(time, at, values, lambda f: response(f / interval), interval)
    if at[-1] >= len(at):
        whole = np.arange(at[-1] + 1)
        values = np.stack([np.interp(whole, at, column) for column in values.T], axis=1)
    return _passed(values, lambda f: response(f / interval))[at]


def _passed_uneven(
    time: FloatArray,
    place: IntArray,
    values: FloatArray,
    response: Callable[[FloatArray], FloatArray],
    interval: float,
) -> FloatArray:
    """Return values at uneven times through a filter: by splines, at even ones in between.

    ``place`` (n,) are their places among even ones; gaps have as many as they tell.
    """
    from scipy.interpolate import make_interp_spline

    step = np.minimum(np.diff(time) / interval, np.diff(place) + LONG_STEP - 1.0)
    at = np.append(0.0, np.cumsum(step))
    first = np.flatnonzero(np.diff(place) > 1)
    # Gaps are bridged by straight lines.
    inside = [at[k] + np.arange(1, place[k + 1] - place[k]) for k in first.tolist()]
    bridge = np.concatenate([np.zeros(0), *inside])
    filled = np.stack([np.interp(bridge, at, column) for column in values.T], axis=1)
    order = np.argsort(known := np.append(at, bridge))
    even = np.arange(int(np.ceil(at[-1])) + 1)
    seen = make_interp_spline(known[order], np.vstack((values, filled))[order], k=DEGREE)
    out = _passed(seen(np.minimum(even, at[-1])), response)
    return np.asarray(make_interp_spline(even, out, k=DEGREE)(at))


def denoised(values: FloatArray, noise: float) -> FloatArray:
    """Return (n, k) even values without frequencies at which white noise is most of them.

    By Wiener's filter ``1 - N / P``, P their power about each frequency and N that of noise of this
    standard deviation.
    """
    floor = 2.0 * len(values) * noise**2

    def gain(spectrum: FloatArray) -> FloatArray:
        left = 1.0 - floor / np.maximum(_about(np.square(spectrum)), np.finfo(float).tiny)
        # What stands, and what is as slow as the whole of them, is no noise.
        left[:ABOUT] = 1.0
        return np.asarray(np.maximum(left, 0.0))

    return _weighed(values, gain)


def echoed(values: FloatArray, other: FloatArray) -> FloatArray:
    """Return (n, k) even values with as much of each frequency as others (n, k) have of it.

    That is the regression of the others on them, over the frequencies about each.
    """
    from scipy.fft import dct  # only comparisons need it

    theirs = dct(other, axis=0)

    def gain(spectrum: FloatArray) -> FloatArray:
        both, own = _about(spectrum * theirs), _about(np.square(spectrum))
        share = np.clip(both / np.maximum(own, np.finfo(float).tiny), 0.0, 1.0)
        share[:ABOUT] = 1.0
        return np.asarray(share)

    return _weighed(values, gain)


def _about(power: FloatArray) -> FloatArray:
    """Return the means of (n, k) powers over the frequencies about each."""
    width = min(ABOUT, len(power))
    window = np.full(width, 1.0 / width)
    return np.stack([np.convolve(own, window, mode="same") for own in power.T], axis=1)


def _passed(values: FloatArray, response: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return (n, k) values through a response to frequencies in cycles per sample."""
    frequency = np.arange(len(values)) / (2 * len(values))
    return _weighed(values, lambda _: response(frequency).reshape(len(frequency), -1))


def _weighed(values: FloatArray, gain: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return (n, k) values of which frequencies have a gain that their spectrum (n, k) says."""
    from scipy.fft import dct, idct  # only comparisons need them

    # Mirrored at both ends: there noise makes no step, and what moves does not jump.
    spectrum = dct(values, axis=0)
    return np.asarray(idct(spectrum * gain(spectrum), axis=0))


def places(time: FloatArray, most: int) -> IntArray:
    """Return the place of every sample among even ones, with at most so many in a gap.

    Where stamps scatter, a long step may be one that a short one follows.
    """
    step = np.diff(time)
    missing = np.round(step / np.median(step)) - 1 if len(step) else step
    if len(step) and is_uneven(time):
        missing[step < LONG_STEP * np.median(step)] = 0
    steps = 1 + np.clip(missing, 0, 2 * most).astype(np.int64)
    return np.concatenate((np.zeros(1, np.int64), np.cumsum(steps)))
