"""What a sensor sampled, of a recording that was read more often than that.

Who reads a register faster than the sensor measures has some samples again, right after they were
new. All six channels together: such rows say nothing, and are left out. Of one triad, which
measures less often than the other: its samples are held in between, which makes steps of its
course and delays it; so its own samples are followed by cubics instead.

It shows where a triad steps by several counts, be it by noise: between two such steps chance seldom
leaves all three axes as they were, and what is read again comes all along.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib import faults
from calib.effects.resampling import resample
from calib.recording import TRIADS, Recording
from calib.repeats import by_chance
from calib.stillness import runs
from calib.timing import FEWEST, even_times
from calib.types import BoolArray, FloatArray, IntArray

HELD = "held"
"""Key of a note: the triad whose samples come again until there is a new one."""

LEAST = 0.01
"""Share of samples that come again from which on it is looked at: one that is repeated now and then
is a fault of that moment."""

LIVELY = 4.0
"""Counts that some axis steps by, before and after what is looked at."""

THROUGHOUT = 0.5
"""Share of the parts, of `faults.BLOCK` steps each, in which a sample comes again, at least."""

FEW = 4
"""Parts below which what comes again may be one mishap, or two."""

BEYOND = 2.0
"""Times as many come again as by chance, at least."""

NOW_AND_THEN = 2.0
"""Times a sample comes again where only some do, at most. Those of a sensor that is read several
times as often as it measures nearly all do; where coarse counts show no noise, so do those of
rests, between the last step of one turn and the first one of the next."""


def read_once(recording: Recording) -> tuple[Recording, IntArray]:
    """Return a recording as its sensors sampled, and which samples of it were read again.

    It is the same one, without any, unless sensors were read more often than they measure.
    """
    values = faults.values_of(recording)
    again = np.stack([find_rereads(values[:, :3]), find_rereads(values[:, 3:])], axis=1)
    if not again.any() or (~again).sum(axis=0).min() < FEWEST:
        return recording, np.zeros(0, np.int64)
    whole: BoolArray = np.asarray(again.all(axis=1))
    keep = np.flatnonzero(~whole)
    fresh: BoolArray = np.logical_not(again[keep])
    out = recording.select(keep)
    even = None if out.clock == "invalid" else even_times(out.time, out.gyro, out.lost)
    time = out.time if even is None else even
    accel, gyro = (
        signal if own.all() else _followed(time, signal, own)
        for signal, own in zip((out.accel, out.gyro), fresh.T, strict=True)
    )
    held = [name for name, own in zip(TRIADS.values(), fresh.T, strict=True) if not own.all()]
    notes = {**out.notes, HELD: " and ".join(held)} if held else out.notes
    return replace(out, accel=accel, gyro=gyro, notes=notes), np.flatnonzero(whole)


def find_rereads(values: FloatArray) -> BoolArray:
    """Return which samples (n, 3) of a triad are the one before, read again: (n,).

    None of them, unless that happens throughout.
    """
    out = np.zeros(len(values), bool)
    if len(values) <= faults.BLOCK:
        return out
    change = np.abs(np.diff(values, axis=0))
    counts = (change / np.maximum(faults.resolution(values), 1e-300)).max(axis=1)
    same: BoolArray = counts == 0.0
    if same.mean() < LEAST:
        return out
    # Between two steps of several counts lie samples that come again, and nothing that is slow.
    step = np.flatnonzero(~same)
    lively = (counts[step[:-1]] > LIVELY) & (counts[step[1:]] > LIVELY)
    at, between = step[:-1][lively], np.diff(step)[lively] - 1
    at, between = at[between < faults.BLOCK], between[between < faults.BLOCK]
    parts = faults.block_sums(between[:, None] > 0)
    if len(at) < FEW * faults.BLOCK or (parts > 0).mean() < THROUGHOUT:
        return out
    often = between > 0
    if np.median(between[often]) > NOW_AND_THEN and often.mean() < THROUGHOUT:
        return out
    count = int(between.sum())
    number = np.bincount(at // faults.BLOCK, between + 1, -(-len(same) // faults.BLOCK))
    chance = float(number @ by_chance(values, 1))
    if count < max(BEYOND * chance, LEAST * number.sum()):
        return out
    out[1:] = same
    start, stop = runs(same)
    still = stop - start >= faults.BLOCK  # or stuck
    for begin, end in zip(start[still].tolist(), stop[still].tolist(), strict=True):
        out[begin + 1 : end + 1] = False
    return out


def _followed(time: FloatArray, signal: FloatArray, own: BoolArray) -> FloatArray:
    """Return (n, 3) signals along cubics through their own samples.

    What is before the first of them, or after the last, is left as it is.
    """
    at, values = time[own], signal[own]
    even = even_times(at, values)
    at = at if even is None else even
    out = resample(at, values, time)
    outside = (time < at[0]) | (time > at[-1])
    out[outside] = signal[outside]
    return out
