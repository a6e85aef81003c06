"""The band that a recording and a noisy truth share.

The noise of a truth is in every regressor that is made of it: an effect that acts on high
frequencies (a low-pass, a delay) would be found in noise alone. So where the truth is noisy, both
sides go through the same low-pass, up to where they agree. Where they agree as far as the samples
reach there is motion that samples do not resolve: its derivative, and so the angular acceleration
that a lever arm feels, is not known. There the differences are blurred.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.special import binom

from calib.lsb import between_counts
from calib.mismatch.noise.hush import count_of, least_noise
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.corners import (
    MOVES,
    ORDER,
    SELDOM,
    is_common,
    shared_jumps,
    unfollowed,
)
from calib.mismatch.reference.filters import (
    FELT,
    NARROWEST,
    low_passed,
    places,
    smoothed,
)
from calib.mismatch.reference.floor import audible_beside
from calib.mismatch.reference.quieted import quieted
from calib.mismatch.reference.scatter import LOUD, QUIETEST
from calib.mismatch.reference.spectra import spectra_of
from calib.mismatch.reference.truths import (
    LONG_STEP,
    REACH,
    RecordingTruth,
)
from calib.recording import Recording
from calib.types import BoolArray, FloatArray

COHERENT = 0.5
"""Coherence of the rates of recording and reference below which a frequency is noise: half of its
power is not common."""

KEPT = 6.0
"""Samples kept for each period of the highest frequency that is compared."""

BLUR = 1.1
"""Sample intervals: passes 40 % at a fifth of the rate, up to where a spline through samples gives
derivatives, and 3 % at 0.4 of it."""

RESOLVED = 0.3
"""Of the slower rate: the highest frequency that both are limited to. A low-pass that is cut off at
half the rate while it still passes something rings."""

PART = 2.0
"""s: a turn by hand."""

QUIET = 0.1
"""Noise of a truth, relative to the recording's, up to which it counts as exact."""


STILL = 0.05
"""rad/s below which a motion is at rest; from `MOVES` on it moves."""

RESTS = 100
"""Slow samples at rest that tell how loud the noise is: 1 in 10."""

ENOUGH = 300
"""Samples of either kind that tell how loud the noise is: 1 in 20."""

LESS = 0.9
"""Noise of the differences where it moves, relative to that at rest, below which part of it is in
the motion. A simulation's own noise hides that; as loud as the recording's it leaves 0.7 to 0.8."""

HEARD = 0.3
"""Power of a truth's rates beside the recording's noise from which it shows in that."""

CLEARLY = 5.0
"""Log-likelihood by which a low-pass of the recording's must be ahead of noise of the truth's."""

KNOWN, SMOOTH = 0.8, 5
"""Share of the frequencies that the slower of both has, of which the spline knows, and how many of
a spectrum are taken together: each has an error of a tenth or two."""

BEYOND = 4.0
"""Cut-off of the first low-pass of a captured motion relative to that of what is compared, of which
it takes 2e-5. A rate is a product of orientations, and a force of one and an acceleration: the
noise of one times that of the other would be noise at any frequency."""


class Matched(NamedTuple):
    """A recording and its truth, limited to what both know.

    ``blur`` is the standard deviation (s) of the Gaussian through which differences are seen,
    ``band`` the frequency (Hz) up to which both passed `low_passed`, and ``forces`` that up to
    which forces agree, if it is lower; 0 is none. Where neither has
    noise, ``stuck`` is what rounding does (`calib.mismatch.reference.floor.Heard`). ``folded`` is
    the power (n, 2) of the motion beyond the band, of both triads: unlike samples fold unlike parts
    of it into the band. ``unknown`` (n,) are samples about corners that the truth does not follow.
    ``jumps`` of the motion are spoilt too: those of the recording as it was, before it was thinned.
    A truth that is ``exact`` has no noise, and was limited because its samples are too few. Where
    it is ``jerky`` jumps are how the body moves, and none is left out.
    """

    real: Recording
    truth: RecordingTruth
    spoilt: BoolArray
    blur: float = 0.0
    band: float = 0.0
    forces: float = 0.0
    stuck: tuple[sparse.csr_matrix, ...] = ()
    folded: FloatArray | None = None
    unknown: BoolArray | None = None
    jumps: BoolArray | None = None
    exact: bool = False
    jerky: bool = False

    @property
    def bands(self) -> tuple[float, float]:
        """Up to where forces and rates agree, Hz."""
        return self.forces or self.band, self.band

    @property
    def limited(self) -> bool:
        """Whether the truth has noise, or too few samples, that something was done about."""
        return self.blur > 0 or self.band > 0


def matched(
    real: Recording,
    truth: RecordingTruth,
    alignment: Alignment,
    mat: FloatArray,
    *,
    spoilt: BoolArray,
    forces: bool = False,
) -> Matched:
    """Return a recording and its truth in the band that both share.

    If the truth has little noise beside the recording, and samples enough for its motion, they come
    back as they are, but for what is nothing but noise in it (`quieted`). With ``forces`` the
    specific forces have a say in the band too.
    """
    heard = audible_beside(real, truth, alignment, mat, spoilt)
    if heard is not None:
        return Matched(heard.real, truth, heard.spoilt, stuck=heard.stuck)
    other = truth.recording
    noise = noise_beside_exact(real, truth, alignment, mat)
    if noise is not None:
        corners = unfollowed(other, noise)
        if truth.quat is None:
            white = np.repeat(noise, 3) * np.sqrt(2.0 * real.interval)
            most = np.repeat(fastest_noise(other), 3)
            truth = quieted(truth, white, len(real), most=most)
        if not is_common(corners, other.gyro):
            unknown = None
            if corners.any():
                about = np.convolve(corners, np.ones(2 * REACH + 1), mode="same")
                unknown = np.interp(alignment.times(real.time), other.time, about) > 0
            return Matched(real, truth, spoilt, unknown=unknown)
        resolved = RESOLVED / max(real.interval, other.interval)
        return _limited_beside(real, truth, alignment, resolved, spoilt)._replace(exact=True)
    bands = common_bands(real, truth, alignment, mat, forces=forces)
    if min(bands) == np.inf:
        blur = BLUR * max(real.interval, other.interval)
        return Matched(real, truth, spoilt, blur=blur)
    resolved = RESOLVED / max(real.interval, other.interval)
    felt, bandwidth = min(*bands, resolved), min(bands[1], resolved)
    kept = low_passed(real, bandwidth, forces=felt)
    seen = replace(truth, recording=low_passed(other, bandwidth, forces=felt))
    state = seen.state(np.clip(alignment.times(real.time), *truth.span))
    jumps = shared_jumps(
        real,
        noise_of(real),
        np.hstack((kept.accel, kept.gyro)),
        np.hstack((state.force @ mat.T, state.rate @ mat.T)),
        round(0.5 / felt / real.interval),
    )
    jerky = jumps.sum() >= SELDOM * len(jumps)
    if jerky:
        jumps = np.zeros(len(jumps), bool)
    common = _limited_beside(real, truth, alignment, bandwidth, spoilt | jumps)
    return common._replace(forces=felt if felt < bandwidth else 0.0, jumps=jumps, jerky=jerky)


def _limited_beside(
    real: Recording,
    truth: RecordingTruth,
    alignment: Alignment,
    bandwidth: float,
    spoilt: BoolArray,
) -> Matched:
    """Return what `limited` does, and what is beyond the band."""
    common = limited(real, truth, bandwidth, spoilt)
    power = beyond(truth.recording, common.truth.recording, bandwidth)
    at = alignment.times(common.real.time)
    folded = [np.interp(at, truth.recording.time, own) for own in power.T]
    return common._replace(folded=np.stack(folded, axis=1))


def beyond(whole: Recording, kept: Recording, bandwidth: float) -> FloatArray:
    """Return the power (n, 2) that a low-pass took from both triads, beside that of noise.

    It is the mean over a period of the cut-off; of noise rests have as much.
    """
    lost = np.hstack((whole.accel - kept.accel, whole.gyro - kept.gyro))
    power = np.square(lost).reshape(-1, 2, 3).sum(axis=2)
    width = round(1.0 / (bandwidth * whole.interval)) | 1
    window = np.full(width, 1.0 / width)
    mean = np.stack([np.convolve(own, window, mode="same") for own in power.T], axis=1)
    return np.asarray(np.maximum(mean - LOUD * np.quantile(mean, QUIETEST, axis=0), 0.0))


def noise_beside_exact(
    real: Recording, truth: RecordingTruth, alignment: Alignment, mat: FloatArray
) -> FloatArray | None:
    """Return the recording's noise (2,) if the truth has little beside it, else None.

    Where a motion never rests, what is fast in a truth may be motion: all of it, if the recording
    shows it as well, and if differences so high that no motion is in them are quiet.
    """
    other = truth.recording
    if truth.quat is not None and _sways(real, other):
        return None  # it was smoothed: what is left of its noise is slow
    noise = noise_of(real)
    if (noise_of(other) <= QUIET * noise).all():
        return noise
    noise = fastest_noise(real)
    if (fastest_noise(other) > QUIET * noise).any():
        return None
    return noise if _shows_all(real, truth, alignment, mat, float(noise[1])) else None


def _sways(real: Recording, other: Recording) -> bool:
    """Whether rates of a truth are restless at rest, below `NARROWEST`, beside a recording's noise.

    Not if either is at rest for too short a time.
    """
    levels = []
    for own in (real, other):
        step = max(1, round(0.25 / NARROWEST / own.interval))
        rate = thinned(low_passed(own, NARROWEST), step).gyro
        speed = np.linalg.norm(rate - _at_rest(rate, step * own.interval), axis=1)
        change = np.abs(np.diff(rate, n=2, axis=0))
        still = np.convolve(speed < STILL, np.ones(3), mode="valid") > 2.5
        if still.sum() < RESTS:
            return False
        levels.append(float(np.median(change[still])))
    return levels[1] > QUIET * levels[0]


def _shows_all(
    real: Recording, truth: RecordingTruth, alignment: Alignment, mat: FloatArray, noise: float
) -> bool:
    """Whether all that is fast in the rates of a truth, and beyond a noise, is in a recording too.

    Of the cross-spectrum with the recording, relative to the truth's own, noise of the truth's
    takes its share; so does a low-pass of the sensor, which leaves less in the recording.
    """
    at = alignment.times(real.time)
    rate = truth.state(np.clip(at, *truth.span)).rate @ mat.T
    sampling = 1.0 / real.interval
    # Through the usual windows slow motion would be seen at all frequencies, and in both.
    spectra = spectra_of(rate, real.gyro, sampling, _known(real, truth, at), "blackmanharris")
    if spectra is None:
        return False
    f, own, seen, both = spectra.frequency, spectra.one, spectra.other, spectra.cross
    white = 2.0 * noise**2 / sampling
    reached = KNOWN * 0.5 * min(sampling, 1.0 / truth.recording.interval)
    fast = (f > NARROWEST) & (f < reached)
    # Neighbours of that window are half of them independent, and so are half of its overlaps.
    number = 0.5 * spectra.number
    for k in range(3):
        heard = np.flatnonzero(fast & (own[:, k] > HEARD * white))
        groups = np.array_split(heard, max(1, len(heard) // SMOOTH))
        size = np.array([len(some) for some in groups])
        shown, power = (np.array([x[some, k].sum() for some in groups]) for x in (own, seen))
        shared = np.array([np.abs(both[some, k].sum()) for some in groups])
        if (shared < COHERENT * shown).any() and not _low_passed(
            shown, shared, power, white * size, number * size
        ):
            return False
    return True


def _low_passed(
    shown: FloatArray, shared: FloatArray, power: FloatArray, white: FloatArray, number: FloatArray
) -> bool:
    """Whether a sensor's low-pass, rather than noise of the truth's, takes what is not shared.

    Of motion m and noise n the truth has m + n, and the recording m: as much as is shared. Through
    a low-pass H it has ``|H|² m``, and ``H m`` is shared.

    Parameters
    ----------
    shown, shared, power, white : (k,) arrays
        Spectrum of the truth, the cross-spectrum's length, the recording's spectrum and that of its
        noise, by frequency.
    number : (k,) array
        How many independent ones they are the means of.
    """
    left = power - white
    # A length is never below zero: of nothing shared it is what chance makes of both.
    square = np.maximum(np.square(shared) - shown * power / number, 0.0)
    noisy = number * np.square((left - np.sqrt(square)) / power)
    filtered = number * np.square((left - square / shown) / power)
    return bool(0.5 * (noisy - filtered).sum() > CLEARLY)


def fastest_noise(recording: Recording) -> FloatArray:
    """Return the standard deviation of the white noise of both triads, (2,), whatever moves.

    By differences so high that they leave nothing slower than a quarter of the rate.
    """
    return noise_of(recording, order=ORDER)


def noise_of(recording: Recording, *, order: int = 2) -> FloatArray:
    """Return the standard deviation of the white noise of both triads, (2,), from quiet samples.

    By their differences of some order, whose variance is ``binom(2 order, order)`` times as large.
    What rounds to counts rounds as much of what moves, even if all it does at rest is stay.
    """
    out = []
    for values in (recording.accel, recording.gyro):
        change = np.abs(np.diff(values, n=order, axis=0))
        lsb = count_of(values)
        # A third of the samples, the quietest, are at rest if anything is.
        low = between_counts(change, lsb, 0.2) / 0.2533 / np.sqrt(binom(2 * order, order))
        out.append(float(np.maximum(low, lsb / np.sqrt(12.0)).mean()))
    return np.array(out)


def follows_noise(real: Recording, truth: RecordingTruth, alignment: Alignment) -> bool:
    """Whether a simulation has the recording's noise in its motion: it was estimated from it.

    At rest such a motion is still, and the differences hold all of the noise; where it moves they
    hold less. Those of any other simulation hold as much there, or more. Of the rests the quiet
    ones count: a bench that shakes is louder than the sensor.
    """
    at = alignment.times(real.time)
    state = truth.state(at)
    noise = np.abs(np.diff(real.accel - state.force, n=2, axis=0))
    turning = np.linalg.norm(state.rate - _at_rest(state.rate, real.interval), axis=1)[1:-1]
    known = truth.covers(at)[1:-1]
    moving, still = noise[known & (turning > MOVES)], noise[known & (turning < STILL)]
    if min(len(moving), len(still)) < ENOUGH:
        return False
    parts = np.array_split(still, max(1, int(len(still) * real.interval / PART)))
    # Beside a simulation that is still it steps in counts there, and where it moves in others.
    lsb = count_of(real.accel)
    quiet = np.quantile([between_counts(part, lsb, 0.5) for part in parts], 0.25, axis=0)
    if (quiet < least_noise(real.interval)[:3]).all():
        return False  # there is none to follow
    ratio = between_counts(moving, lsb, 0.5) / np.maximum(quiet, 1e-12)
    return bool(np.mean(ratio) < LESS)


def _at_rest(rate: FloatArray, interval: float) -> FloatArray:
    """Return the (n, 3) rates' median where they change least, (3,): a motion's own is none."""
    parts = np.array_split(rate, max(1, int(len(rate) * interval / PART)))
    steadiest = np.argsort([part.std(axis=0).sum() for part in parts])[: -(-len(parts) // 20)]
    return np.asarray(np.median(np.concatenate([parts[k] for k in steadiest]), axis=0))


def too_few(real: Recording, truth: RecordingTruth, alignment: Alignment, mat: FloatArray) -> bool:
    """Whether a truth has too few samples for its motion, beside both noises."""
    other = truth.recording
    exact = noise_beside_exact(real, truth, alignment, mat) is not None
    own = None if exact else fastest_noise(other)
    return is_common(unfollowed(other, noise_of(real), own), other.gyro)


def limited(real: Recording, truth: RecordingTruth, bandwidth: float, spoilt: BoolArray) -> Matched:
    """Return a recording and its truth through one low-pass, with as many samples as that needs.

    It is the signals in the sensors' own frames that pass: orientations and positions that had
    passed it would give other ones, as a turn makes products of them. So would rates of what an arm
    makes a sensor feel.
    """
    thin = max(1, int(1.0 / (KEPT * bandwidth * real.interval)))
    kept, wide = low_passed(real, bandwidth), widened(real, bandwidth, spoilt)
    return Matched(thinned(kept, thin), narrowed(truth, bandwidth), wide[::thin], band=bandwidth)


def narrowed(truth: RecordingTruth, bandwidth: float) -> RecordingTruth:
    """Return a truth through the low-pass of `limited`."""
    other = truth.recording
    gradient = truth.state(other.time).gradient.reshape(-1, 9)
    return replace(
        truth,
        recording=low_passed(other, bandwidth),
        spoilt=widened(other, bandwidth, truth.spoilt),
        gradient=smoothed(other.time, gradient, bandwidth).reshape(-1, 3, 3),
    )


def widened(recording: Recording, bandwidth: float, spoilt: BoolArray | None) -> BoolArray:
    """Return which samples of a low-pass to disbelieve: near spoilt ones, gaps, and the ends."""
    reach = int(np.ceil(FELT / bandwidth / recording.interval))
    at = places(recording.time, reach)
    bad = np.ones(at[-1] + 1 + 2 * reach, bool)
    bad[at + reach] = False if spoilt is None else spoilt
    # Of how many of its neighbours a sample has bad ones.
    count = np.concatenate(([0], np.cumsum(bad)))
    return np.asarray(count[at + 2 * reach + 1] > count[at])


def common_bands(
    real: Recording, truth: RecordingTruth, alignment: Alignment, mat: FloatArray, *, forces: bool
) -> tuple[float, float]:
    """Return the frequencies (Hz) up to which forces and rates agree, infinite where throughout.

    Derivatives of captured orientations and positions grow with frequency, and so does their noise:
    that of forces faster. Unless ``forces`` have a say, theirs is that of the rates. Of a recording
    whose samples show nothing above `NARROWEST` it is that. Where orientations were captured, rates
    agree up to the last frequency at which they do: between turns and tremor a hand hardly moves.
    """
    if truth.recording.interval < real.interval:
        # Its noise above what the recording resolves must not be folded down.
        narrow = low_passed(truth.recording, 0.4 / real.interval)
        truth = replace(truth, recording=narrow)
    at = alignment.times(real.time)
    state, known = truth.state(np.clip(at, *truth.span)), _known(real, truth, at)

    def band(measured: FloatArray, true: FloatArray, *, last: bool) -> float:
        spectra = spectra_of(measured, true @ mat.T, 1.0 / real.interval, known, "hann")
        if spectra is None:
            return np.inf
        fast, shared = spectra.frequency > NARROWEST, spectra.coherence().max(axis=1)
        if not fast.any():
            return NARROWEST
        if last:
            shared = np.maximum.accumulate(shared[::-1])[::-1]
        above = np.flatnonzero(fast & (shared < COHERENT))
        return max(float(spectra.frequency[above[0]]), NARROWEST) if len(above) else np.inf

    rates = band(real.gyro, state.rate, last=truth.quat is not None)
    return (band(real.accel, state.force, last=False) if forces else rates), rates


def _known(real: Recording, truth: RecordingTruth, at: FloatArray) -> BoolArray:
    """Return which samples the truth covers that follow the one before, (n,) bool."""
    follows = np.diff(real.time, prepend=real.time[0]) < LONG_STEP * real.interval
    return np.asarray(truth.covers(at) & follows)


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
