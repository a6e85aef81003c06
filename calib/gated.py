"""Gyroscopes that are set to one value at rest: a dead band, a zero-rate update of their driver.

What is left of a bias, of drift and of noise is then nothing, and slow motion is lost with it. A
gyroscope whose counts are coarse reads one value at rest, too; but its counts are all it has, and
it leaves that value by one of them.
"""

from __future__ import annotations

import numpy as np

from calib.faults import FALSE_ALARM, resolution
from calib.lsb import refined
from calib.types import BoolArray, FloatArray

LEAST = 256
"""Samples at rest, and in motion, at least."""

MOST = 0.95
"""Share of them that have the one value."""

FINEST = 1.5e-4
"""rad/s of a count below which noise is seen at rest: twice that of quiet MEMS gyroscopes, 0.002
(°/s)/√Hz, in 5 Hz."""


def find_gated(values: FloatArray, moving: BoolArray) -> list[int]:
    """Return the channels that are set to one value at rest.

    Parameters
    ----------
    values : (n, 6) array
    moving : (n,) array of bool
        Where no rest is.
    """
    rest = ~moving
    if min(rest.sum(), moving.sum()) < LEAST or _without_noise(values[:, :3], rest):
        return []
    out = []
    for c in range(3, 6):
        found, count = np.unique(values[rest, c], return_counts=True)
        value = found[np.argmax(count)]
        off = values[:, c] != value
        if count.max() < MOST * rest.sum() or off[moving].mean() < 1.0 - MOST:
            continue
        own = values[:, c : c + 1]
        (lsb,) = refined(np.abs(np.diff(own, axis=0)), resolution(own)).tolist()
        if 0 < lsb < FINEST or _leaves_by_far(values[:, c], value, off, lsb):
            out.append(c)
    return out


def _without_noise(accel: FloatArray, rest: BoolArray) -> bool:
    """Whether accelerometers have no noise either, as simulated ones: neighbours are the same."""
    both = rest[1:] & rest[:-1]
    same = (accel[1:] == accel[:-1]).all(axis=1)
    return bool(same[both].mean() > MOST) if both.any() else True


def _leaves_by_far(channel: FloatArray, value: float, off: BoolArray, lsb: float) -> bool:
    """Whether a channel never leaves a value by little, though it goes on by little from there.

    A signal that passes is anywhere between the value and its next step when it is first seen.
    """
    first = np.flatnonzero(off[1:-1] & ~off[:-2] & off[2:]) + 1
    if not len(first):
        return False
    jump = np.abs(channel[first] - value)
    step = np.abs(channel[first + 1] - channel[first])
    gap = np.clip((jump.min() - lsb) / np.maximum(step, lsb), 0.0, 0.99)
    return bool(np.log1p(-gap).sum() + np.log(len(first)) < np.log(FALSE_ALARM))
