"""A truth whose noise counts as none, without it where it has nothing else.

Next to the recording's such noise is nothing in one sample, but it is the same in the differences
and in what effects make of the truth: a low-pass of a truth ``x + n`` takes n away, and with it
what the differences have of ``-n``. With N samples that explains ``N n²`` of their power: a
twentieth of the recording's noise is a low-pass of both triads in the forty thousand samples of two
minutes. Through Wiener's filter, ``1 - n² / (x² + n²)``, what a truth errs by has nothing in common
with what is left of it, nor with what a filter makes of that. Rests, turns and corners have unlike
spectra: so it is that of each octave at each time.

References
----------
.. [1] A. Papoulis, "Probability, Random Variables, and Stochastic Processes", 3rd ed., 1991, p. 175
   (the principle of orthogonality).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from calib.faults import values_of
from calib.mismatch.reference.filters import smoothed
from calib.mismatch.reference.truths import RecordingTruth
from calib.recording import Recording
from calib.types import FloatArray

SLOWEST = 2.0
"""Hz: what is slower has most of a motion, and a low-pass of a sensor leaves it."""

QUIET = 0.2
"""Share of the samples that are the quietest: they are at rest if anything is."""

QUIET_OF_NORMAL = 0.2533
"""Standard deviations within which that share of a normal variable's values are."""

PERIODS = 2
"""Of an octave's lower edge over which its power is averaged: four numbers that are independent."""

MOTION = 5.0
"""Power of an octave, relative to that of noise, from which on motion is in it: of noise alone the
mean of four squares is as much once in two thousand times."""


def quieted(
    truth: RecordingTruth, white: FloatArray, number: int, *, most: FloatArray
) -> RecordingTruth:
    """Return a truth without what is white noise in its signals.

    As it is if none of its channels has as much as all samples of a recording together would show.

    Parameters
    ----------
    truth : RecordingTruth
        Of signals that a sensor had, or was to have: the noise of derivatives is not white.
    white : (6,) array, SI/√Hz
        Density of the recording's noise.
    number : int
        Of its samples.
    most : (6,) array, SI
        Standard deviation of the truth's noise by its fastest differences, which a motion that
        never rests may leave: what is more is motion.
    """
    own = truth.recording
    edges = _octaves(own)
    share = _shares(own, edges)
    passed, octaves = [values_of(own)], list[FloatArray]()
    # White noise has no more at any frequency than where there is least.
    noise = np.square(most)
    for edge, part in zip(edges, share, strict=True):
        passed.append(smoothed(own.time, passed[0], edge))
        octaves.append(passed[-2] - passed[-1])
        quiet = np.quantile(np.abs(octaves[-1]), QUIET, axis=0) / QUIET_OF_NORMAL
        noise = np.minimum(noise, np.square(quiet) / part)
        noise[2.0 * own.interval * noise * number < 2.0 * np.square(white)] = 0.0
        if not noise.any():
            return truth
    kept = passed[-1]  # without octaves, all there is
    for octave, part, edge in zip(octaves, share, edges, strict=True):
        kept = kept + octave * _gain(octave, noise * part, round(PERIODS / edge / own.interval))
    return replace(truth, recording=replace(own, accel=kept[:, :3], gyro=kept[:, 3:]))


def _octaves(recording: Recording) -> FloatArray:
    """Return the lower edges of the octaves that samples have, Hz, the fastest first."""
    fastest = 0.25 / recording.interval
    number = 1 + int(np.floor(np.log2(fastest / SLOWEST)))
    return np.asarray(fastest / 2.0 ** np.arange(max(0, number)))


def _shares(recording: Recording, edges: FloatArray) -> FloatArray:
    """Return the shares of the power of white noise that octaves have, (k,)."""
    frequency = np.linspace(0.0, 0.5 / recording.interval, 4097)
    passed = [np.ones(4097), *(1.0 / (1.0 + (frequency / edge) ** 8) for edge in edges)]
    return np.array([np.square(a - b).mean() for a, b in pairwise(passed)])


def _gain(octave: FloatArray, noise: FloatArray, width: int) -> FloatArray:
    """Return how much of (n, k) values is motion beside noise of these variances (k,)."""
    window = np.full(width, 1.0 / width)
    power = np.stack([np.convolve(x, window, mode="same") for x in np.square(octave).T], axis=1)
    motion = power > MOTION * noise
    return np.where(motion, 1.0 - noise / np.where(motion, power, 1.0), 0.0)
