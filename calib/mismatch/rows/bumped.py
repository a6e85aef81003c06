"""Rests in which a sensor was bumped are two: it lies a little askew from that moment on.

Who reaches for something beside a sensor, or lets go of its cable, tilts it by a hundredth of a
degree or by one. That is no turn that anything finds, and its mean belongs to no attitude. But the
gyroscope sees it go, within a tenth of a second, and gravity stays where that brought it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib.bumps import tilted
from calib.faults import ROBUST
from calib.mismatch.rows.underway import is_torn
from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.types import FloatArray

QUICK = 0.15
"""s in which a bump is over, and again as long in which the bench may ring after it."""

STANDS_OUT = 8.0
"""Standard deviations of the angle in so short a time from which it may be one: by chance one in
10¹⁰ is beyond, and gravity must have turned as well."""

SHORTEST = 0.8
"""s of a rest, on either side."""

FEWEST = 16
"""Samples there."""


def parted(recording: Recording, poses: Poses) -> tuple[Poses, tuple[tuple[float, float], ...]]:
    """Return poses, in the order of time, with each that was bumped as those before and after it.

    Beside them when that was, s.

    Gravity must have turned as the gyroscope says. What steps without that is a bias, and what
    turns about the vertical changes no attitude that anybody sees.
    """
    if recording.interval <= 0 or recording.clock == "invalid":
        return poses, ()
    each = [
        _parts(recording, a, b)
        for a, b in zip(poses.start.tolist(), poses.stop.tolist(), strict=True)
    ]
    bumps = tuple(
        (float(recording.time[one[1] - 1]), float(recording.time[two[0]]))
        for parts in each
        for one, two in pairwise(parts)
    )
    if not bumps:
        return poses, ()
    spans = np.array([part for parts in each for part in parts], np.int64)
    return average_poses(recording, *spans.T), bumps


def _parts(recording: Recording, start: int, stop: int) -> list[tuple[int, int]]:
    """Return the samples ``[start, stop)`` of a rest, or those of its parts."""
    bump = _bump(recording, start, stop)
    if bump is None:
        return [(start, stop)]
    before, after = bump
    return [*_parts(recording, start, before), *_parts(recording, after, stop)]


def _bump(recording: Recording, start: int, stop: int) -> tuple[int, int] | None:
    """Return the samples in which a rest was bumped, or None."""
    step = recording.interval
    width = max(3, round(QUICK / step))
    least = max(FEWEST, round(SHORTEST / step))
    number = stop - start
    if number < 2 * least + 2 * width or is_torn(recording, start, stop):
        return None
    gyro = recording.gyro[start:stop]
    off = gyro - np.median(gyro, axis=0)
    run = np.concatenate((np.zeros((1, 3)), np.cumsum(off, axis=0)))
    angle = step * (run[width:] - run[:-width])
    within = slice(least, number - least - width + 1)
    noise = scatter(angle[::width])
    size = np.square(np.divide(angle, noise, out=np.zeros_like(angle), where=noise > 0)).sum(axis=1)
    at = least + int(np.argmax(size[within]))
    if size[at] < STANDS_OUT**2:
        return None
    first, last = max(at - width // 2, least), min(at + 2 * width, number - least)
    before, after = slice(start, start + first), slice(start + last, stop)
    return (before.stop, after.start) if tilted(recording, before, after) else None


def scatter(values: FloatArray) -> FloatArray:
    """Return the standard deviation of each column (n, k), from one value to the next.

    That of noise that may drift, and of which a few may be off.
    """
    change = np.abs(np.diff(values, axis=0))
    return np.asarray(np.median(change, axis=0) * ROBUST / np.sqrt(2.0))
