"""The motion between two witnesses of it: a truth with noise of its own, and the recording.

Both err. With the noise n of the truth the differences hold ``-n``, and so does whatever effects
make of its signals: these go together. A scale factor looks smaller than it is, by the power of
that noise relative to the motion's; of its second derivative ``d²n/dt²`` a truth that was not
smoothed looks sharpened. Weighed against each other by what either errs by, so that the variance is
least, the two leave an error that has nothing in common with their difference.

References
----------
.. [1] A. Papoulis, "Probability, Random Variables, and Stochastic Processes", 3rd ed., 1991, p. 175
   (the principle of orthogonality).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.effects.base import State
from calib.mismatch.noise.hush import least_noise
from calib.mismatch.reference.band import noise_of
from calib.mismatch.reference.captured import Known, sensor_densities
from calib.mismatch.reference.filters import denoised, echoed, filtered
from calib.mismatch.reference.stilled import find_rests
from calib.recording import Recording
from calib.rotation import mat_from_quat, quat_from_rotvec, skew
from calib.types import FloatArray

ABOUT = 0.5
"""s over which differences are averaged."""

SLOW = 0.3
"""Hz: turns by hand last a second or two, and what a gyroscope gets wrong in one is forgotten."""

FAR = 25.0
"""Power of differences, relative to that of the noise of both, beyond which they are none."""

QUIET = 0.25
"""Share of a recording that is quiet beside a truth, at least."""

ORDER = 6
"""Of differences: of what swings once in eight samples they have less than a hundredth."""


def witnessed(state: State, left: FloatArray, known: Known) -> State:
    """Return a state with force and rate as truth and recording have them between them.

    The sensor's noise is white. That of the truth is of derivatives, and of a frame that is off: by
    angles that the gyroscope tells better than the accelerometer, but for slow ones.

    Parameters
    ----------
    state : State
        The truth at the n points.
    left : (n, 6) array
        Recording minus model.
    known : Known
        Of the noise of both.
    """
    angle = known.angle**2
    rate = _between(
        state.time,
        state.rate,
        left[:, 3:],
        known.gyro,
        derived=lambda f: angle * np.square(2.0 * np.pi * f),
        across=lambda f: np.full(len(f), angle),
    )
    mat, force, off = state.mat_ns, state.force, left[:, :3]
    if state.mat_ns is not None:
        mat = _turned_by(state.time, state.mat_ns, rate - state.rate)
        force = np.asarray(np.einsum("nji,njk,nk->ni", mat, state.mat_ns, force), np.float64)
        off = off - (force - state.force)
    force = _between(
        state.time,
        force,
        off,
        known.accel,
        derived=lambda f: np.square(known.position * np.square(2.0 * np.pi * f)),
        across=lambda f: angle * _slow(f),
    )
    return replace(_with_rate(state, rate), force=force, mat_ns=mat)


def _with_rate(state: State, rate: FloatArray) -> State:
    """Return a state with another rate (n, 3), and what is made of that."""
    slope = state.derivative(rate - state.rate)
    known, gradient = state.angular_acceleration, state.known_gradient
    if known is not None:
        known = known + slope
    if gradient is not None:
        before, after = skew(state.rate), skew(rate)
        gradient = gradient + after @ after - before @ before + skew(slope)
    return replace(state, rate=rate, angular_acceleration=known, known_gradient=gradient)


def _between(
    time: FloatArray,
    signals: FloatArray,
    left: FloatArray,
    own: float,
    *,
    derived: Callable[[FloatArray], FloatArray],
    across: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Return (n, 3) signals with their share of what is left.

    The spectral density of their noise is what is ``derived``, and for what they have ``across``
    each axis in proportion.
    """
    square = np.square(signals).mean(axis=0)

    def share(frequency: FloatArray) -> FloatArray:
        noise = np.outer(across(frequency), square.sum() - square) + derived(frequency)[:, None]
        return np.asarray(noise / np.maximum(noise + own**2, np.finfo(float).tiny))

    return signals + filtered(time, _noisy(time, left), share)


def _noisy(time: FloatArray, left: FloatArray, usual: float | None = None) -> FloatArray:
    """Return what is left, (n, 3), where it is noise; 0 where it is far more than is ``usual``.

    That is in the recording alone, or in the truth: neither witnesses the other there. The usual
    power, where it is not known, is that of quiet parts.
    """
    width = max(1, round(ABOUT / float(np.median(np.diff(time)))))
    window = np.full(width, 1.0 / width)
    power = np.convolve(np.square(left).mean(axis=1), window, mode="same")
    limit = FAR * (float(np.quantile(power, QUIET)) if usual is None else usual)
    return np.where((power < limit)[:, None], left, 0.0)


def _turned_by(time: FloatArray, mat: FloatArray, rate: FloatArray) -> FloatArray:
    """Return (n, 3, 3) orientations with the angles that rates (n, 3) beside theirs make.

    Slow ones are left: those are where a gyroscope is no witness.
    """
    step = np.diff(time, prepend=time[0])[:, None]
    angle = np.cumsum(np.einsum("nij,nj->ni", mat, rate) * step, axis=0)
    angle = filtered(time, angle, lambda f: 1.0 - np.sqrt(_slow(f)), SLOW)
    return np.asarray(mat_from_quat(quat_from_rotvec(angle)) @ mat)


def _slow(frequency: FloatArray) -> FloatArray:
    """Return the share of the power of angles, (n,), that the gyroscope does not tell."""
    return np.asarray(np.square(1.0 / (1.0 + (frequency / SLOW) ** 4)))


def shared(state: State, measured: FloatArray) -> State:
    """Return a state with what of its force and rate a recording (n, 6) has as well.

    That is rough, but tells noise of a truth from motion before the differences do: of an axis that
    hardly turns a truth may have nothing else.
    """
    force, rate = echoed(state.force, measured[:, :3]), echoed(state.rate, measured[:, 3:])
    return replace(state, force=force, rate=rate)


def between(state: State, left: FloatArray, densities: FloatArray) -> State:
    """Return the same beside another sensor, whose noise is white as well.

    What both have for noise at a frequency is none of the motion's. Where effects are nearly alike
    (a swing in one plane: the square of its rate is nearly a force) the little that they differ by
    would be that noise.

    Parameters
    ----------
    state, left : State, (n, 6) array
        As `witnessed` has them.
    densities : (2, 2) array
        Of recording and truth, of accelerometer and gyroscope, as `white_noise` has them.
    """
    interval = float(np.median(np.diff(state.time)))
    white = np.square(densities) / (2.0 * interval)
    both = white.sum(axis=0)
    shares = white[1] / np.maximum(both, np.finfo(float).tiny)
    found = []
    for own, off, share, total in zip(
        (state.force, state.rate), (left[:, :3], left[:, 3:]), shares, both, strict=True
    ):
        noise = float(np.sqrt(share * (1.0 - share) * total))
        # What is far more is in the recording alone: an arm, or what neither resolves.
        found.append(denoised(own + share * _noisy(state.time, off, total), noise))
    return replace(state, force=found[0], rate=found[1])


def white_noise(real: Recording, other: Recording) -> FloatArray:
    """Return the densities of the white noise of both triads of two recordings, (2, 2) SI/√Hz.

    By what changes at their rests; else by what of either is too fast for most motion.
    """
    known = []
    for each in (real, other):
        poses = find_rests(each)
        known.append(sensor_densities(each, np.stack((poses.start, poses.stop), axis=1)))
    if None in known:
        known = [fast_densities(each) for each in (real, other)]
    return np.array(known)


def fast_densities(recording: Recording) -> tuple[float, float]:
    """Return the noise densities of both triads by differences so high that few motions have any.

    For what hardly ever rests. No sensor is without any.
    """
    noise = np.maximum(noise_of(recording, order=ORDER), least_noise(recording.interval)[::3])
    accel, gyro = noise * np.sqrt(2.0 * recording.interval)
    return float(accel), float(gyro)
