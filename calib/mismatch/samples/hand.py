"""What a hand does to samples at rest: both triads follow it, and so it is no disturbance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.rows.grid import REST_STEP
from calib.mismatch.rows.sway import follow, follows
from calib.mismatch.samples.power import CLAIM, LOUDER, above, frequencies
from calib.poses import Poses
from calib.recording import CHANNELS, Recording
from calib.types import BoolArray, FloatArray

HAND = (0.5, 14.0)
"""Hz that a hand sways and trembles at (physiological tremor: 4 to 12 Hz), and what a window
spreads."""

SEVERAL = 3
"""Bins from the lowest to the highest frequency of a motion from which it has more than one: a
window spreads one over three."""

SWING = 1 / 3
"""Share of the swing of gravity, as the gyroscopes' angle would have it, that accelerometers must
show for both to be one motion: about the vertical it makes none. A hand also moves it further."""

FEWEST = 4
"""Means of a quarter of a second of a rest that tell how gravity moves there."""


def trembling(power: FloatArray, interval: float, gravity: float) -> BoolArray:
    """Return the frequencies at which the sensor itself moves, held in a hand, (bins,).

    The gyroscopes stand above their floor there, and so do the accelerometers, by what the angle
    makes of gravity or more. That is motion, which both follow, and no disturbance of either. Of a
    hand that sways as well, one or both show the whole band alike: above what is faster than hands.
    """
    bins = len(power)
    frequency = frequencies(bins, interval)
    hand = (frequency >= HAND[0]) & (frequency <= HAND[1])
    faster = frequency > HAND[1]
    excess, seen = np.zeros((bins, 2)), np.zeros((bins, 2), bool)
    sways, sway = np.zeros((bins, 2), bool), np.zeros((bins, 2))
    axes = np.zeros(len(CHANNELS), bool)
    for c in range(len(CHANNELS)):
        own = power[:, power[:, :, c].all(axis=0), c]
        if own.shape[1] > power.shape[1] / 2:
            mean, floor, p = above(own)
            excess[:, c // 3] += np.maximum(mean - floor, 0.0)
            seen[:, c // 3] |= p < CLAIM
            axes[c] = (p[hand] < CLAIM).any()
            if faster.any():
                level = float(np.median(mean[faster]))
                sways[:, c // 3] |= mean > LOUDER * level
                sway[:, c // 3] += np.maximum(mean - level, 0.0)
    if min(axes[:3].sum(), axes[3:].sum()) > 1:
        # Several axes of both: the arm swings at one frequency, and the wrist at another.
        return hand
    heavy = SWING * np.square(gravity / (2 * np.pi * frequency))
    moves = hand & seen.all(axis=1) & (excess[:, 0] > heavy * excess[:, 1])
    at = np.flatnonzero(moves)
    held = hand & seen[:, 0] & sways[:, 1] & (excess[:, 0] > heavy * sway[:, 1])
    # And where the band is so wide that nothing in it stands out beside it.
    both = hand & sways.all(axis=1) & (sway[:, 0] > heavy * sway[:, 1])
    wide = [np.convolve(own, np.ones(SEVERAL + 1), mode="valid") > SEVERAL for own in (held, both)]
    if (len(at) and np.ptp(at) >= SEVERAL) or np.any(wide):
        # No single machine: a hand, which trembles at other frequencies about other axes.
        return hand
    # A window spreads each over its neighbours, and a hand has several.
    near = np.convolve(moves, np.ones(5), mode="same") > 0
    return np.asarray(hand & near)


def skirted(held: BoolArray, mean: FloatArray) -> BoolArray:
    """Return ``held`` and the frequencies beside it over which power falls away from it."""
    out = held.copy()
    for k in range(1, len(out)):
        out[k] |= out[k - 1] and mean[k] < mean[k - 1]
    for k in range(len(out) - 2, -1, -1):
        out[k] |= out[k + 1] and mean[k] < mean[k + 1]
    return out


def held_in_hand(items: Sequence[Unexplained], recording: Recording, poses: Poses) -> bool:
    """Return whether gravity moves as the gyroscopes say in the rests of items, taken together."""
    seen = wanted = 0.0
    size = max(round(REST_STEP / recording.interval), 1)
    spans = [span for item in items for span in item.intervals]
    for (a, b), start, stop in zip(poses.interval, poses.start, poses.stop, strict=True):
        number = (stop - start) // size
        if number < FEWEST or not any(a < end and b > begin for begin, end in spans):
            continue
        own = slice(start, start + number * size)
        time, force, rate = (
            values[own].reshape(number, size, -1).mean(axis=1)
            for values in (recording.time, recording.accel, recording.gyro)
        )
        noise = np.diff(recording.accel[own], axis=0).std(axis=0) / np.sqrt(2.0 * size)
        moved, should = follow(time[:, 0], force, rate - rate.mean(axis=0), noise)
        seen += moved * should
        wanted += should**2
    path = float(np.sqrt(wanted))
    return follows(seen / max(path, 1e-9), path)
