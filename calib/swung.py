"""Rests in which a sensor swings, on a string or a pivot: they are one once that has died away.

A pendulum's specific force stays along its string. So its accelerometer is as still as on a bench,
however far it swings, and its gyroscope, whose rate has no mean, swings to and fro for half a
minute. A hand that trembles as fast moves what the accelerometer reads, by its tilt and by more.
"""

from __future__ import annotations

import numpy as np

from calib.pushed import contrasts, turned_back
from calib.stillness import TREMOR_RATE, Blocks, Units, moving_mean, spans_of, spill
from calib.types import FloatArray

WINDOW = 20
"""Blocks over which power is compared: a swing or more."""

SWING = TREMOR_RATE / 4
"""rad/s rms, up to which it may be a disturbance of the gyroscope as well, but where it dies away
as a swing does."""

QUARTILE, STANDS_OUT, LOUDER = 0.25, 7.0, 1.5
"""Share of the windows of a rest that tells how much it moves; times what that is in most rests,
from which on it may be a swing, and down to which that goes on."""

CALM = 3.0
"""Times what it is in most rests that the calmest window of a rest is at most, once it is still."""

SCALE, LARGER = 5, 2.0
"""Blocks in a mean of the force, half a swing; and by how much that moves more once it is turned
back by the rate, than it did."""


def without_swings(
    blocks: Blocks,
    off: FloatArray,
    segments: list[tuple[int, int]],
    *,
    least: int,
    units: Units,
) -> list[tuple[int, int]]:
    """Return what is left of rests when the swings in them are taken out.

    Parameters are those of `pushed.without_pushes`.
    """
    if units.rate is None or not segments:
        return segments
    loud = [_loudness(off[a:b]) for a, b in segments]
    usual = float(np.median([np.quantile(own, QUARTILE) for own in loud]))
    left: list[tuple[int, int]] = []
    for (a, b), own in zip(segments, loud, strict=True):
        swings = np.zeros(b - a, bool)
        if own.max() > STANDS_OUT * usual:
            calm = max(usual, min(float(own.min()), CALM * usual))
            width = b - a - len(own) + 1
            spill(swings, own > LOUDER * calm, width)
            force = contrasts(turned_back(blocks, off, a, b, units.rate), SCALE)
            for p, q in spans_of(swings):
                inside = own[p : q - width + 1]
                moves = np.square(force[max(p - SCALE, 0) : q - SCALE]).sum(axis=0)
                swings[p:q] = (
                    inside.max() > STANDS_OUT * usual
                    and (units.rate * inside.max() > SWING or (p == 0 and _fades(inside)))
                    and moves[1] > LARGER**2 * moves[0]
                )
        parts = [(a + p, a + q) for p, q in spans_of(~swings)]
        left += [(p, q) for p, q in parts if q - p >= least] if swings.any() else parts
    return left


def _loudness(off: FloatArray) -> FloatArray:
    """Return the root mean square of rates (n, 3) in windows, about the mean of each."""
    width = min(WINDOW, len(off))
    power = moving_mean(np.square(off).sum(axis=1), width)
    mean = np.square(moving_mean(off, width)).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(power - mean, 0.0)))


def _fades(loud: FloatArray) -> bool:
    """Return whether the power of what is so loud is, later on, less than half of it at first."""
    half = max(len(loud) // 2, 1)
    return bool(2.0 * np.square(loud[-half:]).mean() < np.square(loud[:half]).mean())
