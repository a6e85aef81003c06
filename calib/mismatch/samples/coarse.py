"""Counts that are coarse beside the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib import faults
from calib.effects import get_effect
from calib.lsb import refined
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.noise.rounded import Rounding, look_at_counts
from calib.mismatch.samples.found import fault_finding
from calib.recording import CHANNELS, TRIADS, Recording
from calib.types import BoolArray, FloatArray

COARSE = 0.5
"""A count larger than the noise over this: rounding is no longer hidden by noise."""

SHOWS = {"accel": "means of its rests", "gyro": "its turns"}
"""What shows a triad whose counts are coarse."""

MANY = 100_000
"""Samples that are looked at for whether they step in counts."""


def find_coarse(
    recording: Recording, values: FloatArray, moving: BoolArray, step: FloatArray
) -> list[Finding]:
    """Rounding is coarse where most neighbours at rest are equal, and the others a count apart."""
    rest = np.flatnonzero(~moving)
    inside = np.diff(rest) == 1
    if not inside.any():
        return []
    change = np.abs(np.diff(values[rest], axis=0))[inside]
    # Without noise nothing changes at rest: there the counts show in motion alone.
    moved = np.abs(np.diff(values[:MANY], axis=0))
    # Finer than any part rounds are the decimals of a file without noise.
    finest = {s.name.split("_")[0]: s.low or 0.0 for s in get_effect("quantization").shape}
    out = []
    for first, triad in ((0, "accel"), (3, "gyro")):
        part, whole = change[:, first : first + 3], moved[:, first : first + 3]
        lsb = refined(whole, step[first : first + 3])
        count, grid = _counts(part, lsb)
        every = _counts(whole, lsb)[1]
        # Differences of white noise have twice its variance; rounding adds a twelfth of a count².
        # Coarse ones are no more than two counts apart: what is, is where rests begin and end.
        # Some rests may be shaken: what most blocks have counts.
        square = np.square(np.minimum(count, 2.0))
        block = max(min(faults.BLOCK, len(square)), 1)
        whole_blocks = square[: len(square) // block * block].reshape(-1, block, 3)
        typical = np.median(whole_blocks.mean(axis=1), axis=0)
        noise = np.sqrt(np.maximum(typical / 2 - 1 / 12, 0.0))
        coarse = (lsb > finest[triad]) & (noise < COARSE) & (grid.mean(axis=0) > 0.99)
        coarse &= every.mean(axis=0) > 0.99
        if coarse.any():
            names = tuple(CHANNELS[first + i] for i in np.flatnonzero(coarse))
            size = float(np.median(lsb[coarse]))
            found = {triad: 1.0, f"{triad}_lsb": size}
            out.append(fault_finding("quantization", recording, names, found))
    return out


def _counts(change: FloatArray, lsb: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return changes (n, 3) in counts of `lsb`, and which are whole ones."""
    count = np.rint(change / np.where(lsb > 0, lsb, 1.0))
    return count, np.asarray(np.abs(change - count * lsb) < 0.01 * lsb)


def coarse_channels(
    recording: Recording, rests: FloatArray, findings: Sequence[Finding]
) -> dict[int, Rounding]:
    """Return the channels whose counts were found to be coarse, with what that does to rests.

    These are (r, 2) intervals.
    """
    out = {}
    start = np.searchsorted(recording.time, rests[:, 0])
    stop = np.searchsorted(recording.time, rests[:, 1], side="right")
    for f in findings:
        if f.effect == "quantization":
            (lsb,) = (q.value for name, q in f.parameters.items() if name.endswith("_lsb"))
            for channel in f.channels:
                values = recording.channel(channel)
                parts = [values[a:b] for a, b in zip(start, stop, strict=True)]
                out[CHANNELS.index(channel)] = look_at_counts(parts, lsb)
    return out


def unhidden_triads(coarse: Mapping[int, Rounding], *, few_turns: bool) -> tuple[str, ...]:
    """Return the triads whose means at rest tell where between two counts they are.

    Of a gyroscope that does not turn they are all there is, and if its bias moves by many counts
    they tell of that.
    """
    out = []
    for triad in TRIADS:
        own = [r for c, r in coarse.items() if CHANNELS[c].startswith(triad) and not r.hidden]
        if triad == "gyro" and few_turns:
            own = [r for r in own if not r.swept]
        if own:
            out.append(triad)
    return tuple(out)
