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

from dataclasses import replace
from functools import partial

import numpy as np

from calib.effects.base import State
from calib.mismatch.reference.band import denoised, filtered, noise_of
from calib.mismatch.reference.captured import sensor_densities
from calib.mismatch.reference.colour import Colour
from calib.mismatch.reference.stilled import find_rests
from calib.recording import Recording
from calib.types import FloatArray

ABOUT = 0.5
"""s over which differences are averaged."""

FAR = 25.0
"""Power of differences, relative to that of the noise of both, beyond which they are none."""

ORDER = 6
"""Of differences: of what swings once in eight samples they have less than a hundredth."""


def witnessed(state: State, left: FloatArray, colours: list[Colour]) -> State:
    """Return a state with force and rate as truth and recording have them between them.

    The sensor's noise is white, the truth's is that of derivatives. So of the spectrum ``1 + a f² +
    b f⁴`` of the differences the first term counts as the sensor's, and the others as the truth's.

    Parameters
    ----------
    state : State
        The truth at the n points.
    left : (n, 6) array
        Recording minus model.
    colours : two of Colour
        Of the differences of accelerometer and gyroscope.
    """
    force, rate = (
        filtered(state.time, own, partial(_of_truth, colour))
        for own, colour in zip((left[:, :3], left[:, 3:]), colours, strict=True)
    )
    return replace(state, force=state.force + force, rate=state.rate + rate)


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
    width = max(1, round(ABOUT / interval))
    found = []
    for own, off, share, total in zip(
        (state.force, state.rate), (left[:, :3], left[:, 3:]), shares, both, strict=True
    ):
        # What is far more than noise is in the recording alone: an arm, or what neither resolves.
        power = np.convolve(np.square(off).mean(axis=1), np.full(width, 1.0 / width), mode="same")
        noisy = (power < FAR * total)[:, None]
        noise = float(np.sqrt(share * (1.0 - share) * total))
        found.append(denoised(own + noisy * share * off, noise))
    return replace(state, force=found[0], rate=found[1])


def white_noise(real: Recording, other: Recording) -> FloatArray:
    """Return the densities of the white noise of both triads of two recordings, (2, 2) SI/√Hz.

    By what changes at their rests; else by differences so high that little motion is in them.
    """
    found = []
    for each in (real, other):
        poses = find_rests(each)
        rests = np.stack((poses.start, poses.stop), axis=1)
        found.append(sensor_densities(each, rests))
    known = [own for own in found if own is not None]
    if len(known) == len(found):
        return np.array(known)
    noise = [noise_of(each, order=ORDER) for each in (real, other)]
    return np.array(noise) * np.sqrt([[2.0 * real.interval], [2.0 * other.interval]])


def _of_truth(colour: Colour, frequency: FloatArray) -> FloatArray:
    """Return the truth's share of the variance of differences at (n,) frequencies, Hz."""
    return np.asarray(1.0 - 1.0 / colour.at(frequency))
