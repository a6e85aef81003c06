"""The band that a recording and a noisy truth share.

The noise of a truth is in every regressor that is made of it: an effect that acts on high
frequencies (a low-pass, a delay) would be found in noise alone. So where the truth is noisy, rests
are made still, and both sides go through the same low-pass, up to where they agree. Where they
agree as far as the samples reach there is motion that samples do not resolve: its derivative, and
so the angular acceleration that a lever arm feels, is not known. There the differences are blurred.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import fft

from calib.mismatch.alignment import Alignment
from calib.mismatch.comparison import Truth
from calib.mismatch.truths import RecordingTruth
from calib.poses import Poses
from calib.recording import Recording
from calib.types import BoolArray, FloatArray

COHERENT = 0.5
"""Coherence of the rates of recording and reference below which a frequency is noise: half of its
power is not common."""

NARROWEST = 5.0
"""Hz: hand motion reaches so far in any case."""

KEPT = 6.0
"""Samples kept for each period of the highest frequency that is compared."""

BLUR = 1.1
"""Sample intervals: passes 40 % at a fifth of the rate, up to where a spline through samples gives
derivatives, and 3 % at 0.4 of it."""

QUIET = 0.1
"""Noise of a truth, relative to the recording's, up to which it counts as exact."""


class Matched(NamedTuple):
    """A recording and its truth, limited to what both know.

    ``blur`` is the standard deviation (s) of the Gaussian through which differences are seen,
    ``passed`` the share of white noise that a low-pass has left.
    """

    real: Recording
    truth: Truth
    spoilt: BoolArray
    limited: bool = False
    blur: float = 0.0
    passed: float = 1.0


def matched(
    real: Recording,
    other: Recording,
    poses: Poses,
    alignment: Alignment,
    mat: FloatArray,
    *,
    gravity: float,
    spoilt: BoolArray,
    other_spoilt: BoolArray | None = None,
) -> Matched:
    """Return a recording and another as its truth, in the band that both share.

    The recording comes back as it is if the other has little noise beside it.
    """
    plain = RecordingTruth(other, gravity, other_spoilt)
    if (noise_of(other) <= QUIET * noise_of(real)).all():
        return Matched(real, plain, spoilt)
    bandwidth = common_band(real, plain, alignment, mat, forces=False)
    other = stilled(other, poses)
    if bandwidth is None:
        blur = BLUR * max(real.interval, other.interval)
        truth = RecordingTruth(other, gravity, other_spoilt)
        return Matched(real, truth, spoilt, limited=True, blur=blur)
    if other_spoilt is not None:
        other_spoilt = widened(other_spoilt, bandwidth, other.interval)
    truth = RecordingTruth(low_passed(other, bandwidth), gravity, other_spoilt)
    return limited(real, truth, bandwidth, spoilt, low_passed)


def noise_of(recording: Recording) -> FloatArray:
    """Return the standard deviation of the white noise of both triads, (2,), from quiet samples."""
    out = []
    for values in (recording.accel, recording.gyro):
        second = np.abs(np.diff(values, n=2, axis=0))
        # A third of the samples, the quietest, are at rest if anything is.
        low = np.quantile(second, 0.2, axis=0) / 0.2533 / np.sqrt(6.0)
        out.append(float(low.mean()))
    return np.array(out)


def stilled(recording: Recording, poses: Poses) -> Recording:
    """Return the recording with every rest at its mean."""
    accel, gyro = recording.accel.copy(), recording.gyro.copy()
    for k in range(len(poses)):
        part = slice(int(poses.start[k]), int(poses.stop[k]))
        accel[part], gyro[part] = poses.accel[k], poses.gyro[k]
    return replace(recording, accel=accel, gyro=gyro)


def widened(spoilt: BoolArray, bandwidth: float, interval: float) -> BoolArray:
    """Return what a low-pass makes of spoilt samples: their neighbours are spoilt too."""
    reach = int(np.ceil(0.5 / bandwidth / interval))
    return np.asarray(np.convolve(spoilt, np.ones(2 * reach + 1), mode="same") > 0)


def limited(
    real: Recording,
    truth: Truth,
    bandwidth: float,
    spoilt: BoolArray,
    low_pass: Callable[[Recording, float], Recording],
) -> Matched:
    """Return a recording limited to the band of its truth, with as many samples as that needs.

    What the low-pass leaves of white noise is alike from sample to sample: of a Butterworth of
    fourth order, there and back, the noise bandwidth is 0.898 of the cut-off.
    """
    wide = widened(spoilt, bandwidth, real.interval)
    thin = max(1, int(1.0 / (KEPT * bandwidth * real.interval)))
    passed = min(1.0, 2.0 * 0.898 * bandwidth * thin * real.interval)
    kept = thinned(low_pass(real, bandwidth), thin)
    return Matched(kept, truth, wide[::thin], limited=True, passed=passed)


def common_band(
    real: Recording, truth: Truth, alignment: Alignment, mat: FloatArray, *, forces: bool
) -> float | None:
    """Return the frequency (Hz) up to which recording and truth agree, None if they do throughout.

    Derivatives of captured orientations and positions grow with frequency, and so does their
    noise. The lower of what the rates and what the specific forces allow holds for both.
    """
    from scipy.signal import coherence  # half a second to import

    at = alignment.times(real.time)
    state = truth.state(np.clip(at, *truth.span))
    rate = 1.0 / real.interval
    found = []
    for measured, true in ((real.gyro, state.rate), (real.accel, state.force))[
        : 2 if forces else 1
    ]:
        length = min(len(measured) // 8, round(2.0 * rate))
        if length < 16:
            continue
        f, each = coherence(measured, true @ mat.T, fs=rate, nperseg=length, axis=0)
        above = np.flatnonzero((f > NARROWEST) & (each.max(axis=1) < COHERENT))
        if len(above):
            found.append(float(f[above[0]]))
    return max(min(found), NARROWEST) if found else None


def low_passed(recording: Recording, bandwidth: float) -> Recording:
    """Return the recording through `zero_phase`."""
    cutoff = bandwidth * recording.interval
    return replace(
        recording,
        accel=zero_phase(recording.accel, cutoff),
        gyro=zero_phase(recording.gyro, cutoff),
    )


def low_passed_as_motion(recording: Recording, bandwidth: float) -> Recording:
    """Return the recording through the low-pass that `motion_from_reference` has, no delay."""
    from calib.simulation.recorded import low_pass  # half a second to import

    return replace(
        recording,
        accel=low_pass(recording.time, recording.accel, bandwidth),
        gyro=low_pass(recording.time, recording.gyro, bandwidth),
    )


def zero_phase(values: FloatArray, cutoff: float) -> FloatArray:
    """Return (n, k) values through ``1 / (1 + (f / cutoff)**8)``, f in cycles per sample.

    That is a Butterworth low-pass of fourth order there and back, of the same response at any rate:
    a digital one is warped, and two sampled at unlike rates would differ by their filters.
    """
    n = len(values)
    if cutoff >= 0.45 or n < 32:
        return np.array(values)
    pad = min(n - 1, int(8.0 / cutoff))
    before = 2 * values[0] - values[pad:0:-1]
    after = 2 * values[-1] - values[-2 : -pad - 2 : -1]
    spectrum = fft.rfft(np.concatenate((before, values, after)), axis=0)
    size = n + 2 * pad
    gain = 1.0 / (1.0 + (fft.rfftfreq(size) / cutoff) ** 8)
    out: FloatArray = fft.irfft(spectrum * gain[:, None], size, axis=0)[pad : pad + n]
    return out


def thinned(recording: Recording, step: int) -> Recording:
    """Return every `step`-th sample."""
    if step == 1:
        return recording
    temperature = recording.temperature
    return replace(
        recording,
        time=recording.time[::step],
        accel=recording.accel[::step],
        gyro=recording.gyro[::step],
        temperature=None if temperature is None else temperature[::step],
        lost=None,
    )
