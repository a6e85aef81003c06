"""A recording as its sensors measured it: what reading, stamping and sending made of it undone."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib import faults
from calib.bumps import is_tilt
from calib.read_once import read_once
from calib.recording import Recording
from calib.timing import evened
from calib.types import FloatArray, IntArray


class Measured(NamedTuple):
    """A recording as its sensors measured it, and what was undone.

    Parameters
    ----------
    recording : Recording
        Each sample once, at even times if it was taken so, and in its course.
    stamps : (n,) array, s
        When these samples were stamped.
    again : (r,) array of int
        Samples of the recording as it was that had been read before.
    spikes : (k, 3) array of int
        Samples ``[start, stop)`` of the recording as it is, and channels, that were off course.
    """

    recording: Recording
    stamps: FloatArray
    again: IntArray
    spikes: IntArray


def measured(recording: Recording) -> Measured:
    """Return a recording as its sensors measured it."""
    once, again = read_once(recording)
    good, spikes = mended(once)
    return Measured(evened(good), good.time, again, spikes)


def mended(recording: Recording) -> tuple[Recording, IntArray]:
    """Return a recording without spikes, and the samples and channel of each, (k, 3)."""
    spikes = spikes_of(recording)
    return bridged(recording, spikes), spikes


def spikes_of(recording: Recording) -> IntArray:
    """Return the samples ``[start, stop)`` and channel of each spike, (k, 3).

    What tilts a sensor that is at rest is none.
    """
    values = faults.values_of(recording)
    found = faults.find_spikes(values, lsb=faults.resolution(values))
    kept = [f for f in found if f[2] < 3 or not is_tilt(recording, f[0], f[1])]
    return np.array(kept, np.int64).reshape(-1, 3)


def bridged(recording: Recording, spikes: IntArray) -> Recording:
    """Return a recording without its spikes (k, 3).

    A byte that is lost on the way makes one. In its place is the cubic through the two samples on
    either side.
    """
    if not len(spikes):
        return recording
    values = faults.values_of(recording)
    for start, stop, c in spikes.tolist():
        beside = np.array([start - 2, start - 1, stop, stop + 1])
        values[start:stop, c] = cubic(beside, values[beside, c], np.arange(start, stop))
    return replace(recording, accel=values[:, :3], gyro=values[:, 3:])


def cubic(at: IntArray, values: FloatArray, asked: IntArray) -> FloatArray:
    """Return the cubic through four (4,) values, where it is asked for (n,) (Lagrange)."""
    out = np.zeros(len(asked))
    for own, value in zip(at, values, strict=True):
        others = at[at != own]
        out += value * np.prod((asked[:, None] - others) / (own - others), axis=1)
    return out
