"""Samples that came again, are missing, or are off course: how the recording was read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib import faults
from calib.measured import Measured
from calib.mismatch.findings.diagnosis import Finding, Unexplained
from calib.mismatch.findings.heldout import HeldOut
from calib.mismatch.rows.underway import GAP
from calib.mismatch.samples.found import SPIKES, Samples, fault_finding, intervals_of
from calib.mismatch.samples.losses import Loss
from calib.mismatch.samples.within import SEVERAL, densest
from calib.recording import CHANNELS, Recording
from calib.types import BoolArray, FloatArray, IntArray

CERTAIN = 0.1
"""Standard error of a number of samples below which it is no other: one in a hundred is off."""


def after_gaps(recording: Recording) -> BoolArray:
    """Return which samples some are missing before: the source counted them, or time did, (n,)."""
    assert recording.lost is not None
    out = np.asarray(recording.lost > 0)
    out[1:] |= np.diff(recording.time) > GAP * recording.interval
    return out


def read_again(recording: Recording, again: IntArray) -> Samples:
    """Return what a recording shows of which samples were read again throughout."""
    if not again.size:
        return Samples((), (), np.zeros(0, bool), fatal=False)
    share = again.size / len(recording)
    found = replace(
        repeated(recording, again),
        regime="time: throughout",
        sentence=f"The sensor was read faster than it measures: {share:.0%} of the samples are the "
        "one before, read again. They are left out of all that follows.",
    )
    return Samples((found,), (), np.zeros(0, bool), fatal=False)


def with_reading(seen: Samples, recording: Recording, read: Measured) -> Samples:
    """Return what the samples of a recording show, and what reading it had made of them."""
    return seen._replace(
        findings=(*read_again(recording, read.again).findings, *seen.findings),
        unexplained=(*off_course(read.recording, read.spikes), *seen.unexplained),
    )


def off_course(recording: Recording, spikes: IntArray) -> tuple[Unexplained, ...]:
    """Return what spikes (k, 3), as `Measured` has them, say of each channel.

    Each is at its moment; several are where they are dense.
    """
    out = []
    time = recording.time
    for c in np.unique(spikes[:, 2]).tolist():
        own = spikes[spikes[:, 2] == c]
        if len(own) < SEVERAL:
            samples = [np.arange(start, stop) for start, stop, _ in own.tolist()]
            where = intervals_of(time, np.concatenate(samples))
        else:
            where = (densest(time[own[:, 0]], (float(time[0]), float(time[-1]))),)
        out.append(Unexplained((CHANNELS[c],), where, SPIKES, faults.FALSE_ALARM))
    return tuple(out)


def repeated(recording: Recording, repeats: IntArray) -> Finding:
    """Return the finding of samples that came again."""
    values = {"count": -float(repeats.size), "moment": float(recording.time[repeats[0]])}
    where = intervals_of(recording.time, repeats)
    return fault_finding("dropped_samples", recording, CHANNELS, values, intervals=where)


def lost_samples(recording: Recording, loss: Loss, turn: FloatArray) -> Finding:
    """Return the finding of a loss that the closure of its own turn shows."""
    late, number = loss.spread
    spread = {"moment": float(np.hypot(recording.interval, late))}
    if number > CERTAIN:
        spread["count"] = number
    found = fault_finding(
        "dropped_samples",
        recording,
        CHANNELS,
        {"count": float(loss.number), "moment": loss.moment},
        intervals=((float(turn[0]), float(turn[1])),),
        spread=spread,
    )
    # Two of the turn's five equations find where and how many; the others prove it.
    gain = 2.5 * (loss.before**2 - loss.after**2)
    proof = HeldOut(
        loss.before, loss.after, 1.0, "1", "closure of this turn, in scatters of all turns", gain
    )
    return replace(found, held_out=proof, held_out_reason="")
