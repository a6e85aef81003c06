"""When samples were taken, where their stamps are not even.

A sensor may be read late, or its samples may be stamped late or rounded to milliseconds. In the
first case signals follow the stamps, in the second they do not: what looks like noise in time then
is in every integral. Motion tells which: of what each sample is off from its neighbours, the share
that goes with its stamp, times its slope, is the share of the stamps that is true.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.faults import ROBUST, find_gaps
from calib.recording import Recording
from calib.types import FloatArray, IntArray

HALF = 32
"""Samples on either side that say when a sample was due."""

MOVING = 2.0
"""Slope of a channel, relative to its noise, from which it moves."""

ODDS = 20.0
"""How much more likely the samples must be without the scatter than with it, to correct stamps."""

SLIGHT = 0.1
"""Share of the scatter that counts as none: as much is what noise makes of the estimate."""

EVEN = 1e-4
"""Scatter, in intervals, below which stamps are even: rounding to microseconds leaves less."""

OUTLYING = 3.0
"""Times the noise, off both with and without the scatter, from which a sample counts less."""

_AROUND = np.array([-1, 8, -28, 56, 0, 56, -28, 8, -1]) / 70
"""Weights of the polynomial through the four samples on either side: a hand trembles with up to
14 Hz, of which a cubic at 100 Hz misses more than a millisecond's scatter makes."""

_REACH = len(_AROUND) // 2


def with_even_stamps(recording: Recording) -> Recording:
    """Return the recording with that part of its stamps' scatter left out that is no motion's."""
    time = recording.time
    if len(time) < 2 * HALF:
        return recording
    ends = np.concatenate(([0], find_gaps(recording).at, [len(time)]))
    due = _due(time, ends)
    off = time - due
    if off.std() < EVEN * recording.interval:
        return recording
    true, error = _true_share(recording, off, ends)
    # Two parabolas, one about 0 and one about 1.
    if 0.5 - true < np.log(ODDS) * error**2:
        return recording
    mended = due + (true if true > SLIGHT else 0.0) * off
    return replace(recording, time=mended) if (np.diff(mended) > 0).all() else recording


def _due(time: FloatArray, ends: IntArray) -> FloatArray:
    """Return the mean of the stamps about each sample, as many on either side, and no gap."""
    at = np.arange(len(time))
    length = np.diff(ends)
    half = np.minimum(at - np.repeat(ends[:-1], length), np.repeat(ends[1:], length) - 1 - at)
    half = np.minimum(half, HALF)
    # Seconds of an epoch would leave too few digits for a sum.
    total = np.append(0.0, np.cumsum(time - time[0]))
    return np.asarray(time[0] + (total[at + half + 1] - total[at - half]) / (2 * half + 1))


def _true_share(recording: Recording, off: FloatArray, ends: IntArray) -> tuple[float, float]:
    """Return the share of what stamps are `off` that signals follow, and its standard error."""
    step = recording.interval
    whole = np.ones(len(off), bool)
    for k in range(-_REACH, _REACH):
        whole[np.clip(ends + k, 0, len(off) - 1)] = False
    own = slice(_REACH, -_REACH)
    late = off[own] - _around(off)
    cross = power = 0.0
    about = np.zeros(3)
    for values in (*recording.accel.T, *recording.gyro.T):
        aside = values[own] - _around(values)
        slope = np.gradient(values, step)[own]
        noise = ROBUST * float(np.median(np.abs(aside))) + 1e-300
        moves = whole[own] & (np.abs(slope) * step > MOVING * noise)
        expected, found = (slope * late)[moves] / noise, aside[moves] / noise
        # What neither explains is motion between samples.
        weight = 1.0 / (1.0 + np.minimum(found**2, (found - expected) ** 2) / OUTLYING**2)
        power += float(weight @ expected**2)
        cross += float(weight @ (expected * found))
        squares = np.square(weight * expected)
        about += squares @ np.stack((found**2, -2 * expected * found, expected**2), axis=1)
    if power == 0.0:
        return 1.0, 1.0
    true = cross / power
    # What is left is the noise of each: interpolation errs more where it turns faster.
    left = float(about @ true ** np.arange(3))
    return true, float(np.sqrt(max(left, 0.0))) / power


def _around(values: FloatArray) -> FloatArray:
    """Return what (n,) values are going by those on either side, (n - 2 `_REACH`,)."""
    return np.convolve(values, _AROUND, mode="valid")
