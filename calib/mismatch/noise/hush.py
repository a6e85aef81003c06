"""Recordings that are quieter than any sensor: they get the noise that the best one would have.

All that a diagnosis says is relative to noise. Without any, rounding in the last decimal and what
integration leaves between samples would be effects, and a rest in which a bench still rings by a
nanometre would be one that was shaken. No sensor is as quiet; a simulation may be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib import faults
from calib.lsb import refined
from calib.recording import CHANNELS, Recording
from calib.types import BoolArray, FloatArray

QUIETEST = np.array([5e-5] * 3 + [1.7e-6] * 3)
"""Noise density of each channel, SI/√Hz: 5 µg/√Hz and 0.0001 dps/√Hz, a tenth of what tactical
grade data sheets state (HG4930: 0.03 m/s/√h, 0.04 °/√h; ADIS16497: 0.09 °/√h)."""

WHOLE = 0.01
"""Of a count, that changes may differ by from whole ones."""

HUSHED = "noise added"
"""Key of a note: to which channels."""


def least_noise(interval: float) -> FloatArray:
    """Return the standard deviation of a sample of the quietest sensor, (6,)."""
    return np.asarray(QUIETEST / np.sqrt(2 * max(interval, 1e-9)))


def count_of(values: FloatArray) -> FloatArray:
    """Return the count of which all changes of a channel are multiples, (k,); 0 if there is none.

    Without noise the smallest change may be one of motion, and says nothing of counts.
    """
    if len(values) < 2:
        return np.zeros(values.shape[1])
    change, step = np.diff(values, axis=0), faults.resolution(values)
    # What rounding of the numbers themselves leaves is no count.
    counts = step > np.finfo(float).eps * np.abs(values).max(axis=0)
    step = np.where(counts, refined(np.abs(change), np.where(counts, step, 1.0)), 0.0)
    change /= np.where(step > 0, step, 1.0)
    whole = np.abs(change - np.rint(change)) < WHOLE
    return np.asarray(np.where(whole.mean(axis=0) > 0.99, step, 0.0))


def silent(values: FloatArray, interval: float) -> BoolArray:
    """Return which channels of (n, 6) values have less noise at rest than any sensor, (6,).

    A channel that counts more coarsely than that is silent for its counts, and one that is constant
    beside others with noise is stuck.
    """
    least = least_noise(interval)
    quiet = faults.noise_at_rest(values) < least
    if not quiet.any():
        return quiet
    quiet &= count_of(values) < least
    moves = np.ptp(values, axis=0) > 0
    return np.asarray(quiet & (moves | (quiet.all() and moves.any())))


def audible(recording: Recording) -> Recording:
    """Return the recording with the least noise that sensors have on channels that are silent.

    The same noise whenever it is the same recording; a note `HUSHED` then names the channels.
    """
    values = faults.values_of(recording)
    which = silent(values, recording.interval)
    if not which.any():
        return recording
    noise = least_noise(recording.interval) * which
    values = values + noise * np.random.default_rng(len(values)).standard_normal(values.shape)
    names = ", ".join(name for name, own in zip(CHANNELS, which, strict=True) if own)
    notes = {**recording.notes, HUSHED: names}
    return replace(recording, accel=values[:, :3], gyro=values[:, 3:], notes=notes)
