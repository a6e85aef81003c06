"""Whether the unit of a recording changed on the way.

Two logs joined, or a setting that was changed while a device ran, leave one part in another unit.
For the accelerometer gravity tells. A gyroscope has no such measure; but in another unit its noise
and its turns are larger by one and the same factor, and nothing that is done to a sensor does that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.gravity import STANDARD_GRAVITY as G
from calib.recording import Recording
from calib.types import FloatArray

BLOCK = 0.5
"""s over which noise and speed are judged."""

FEWEST = 20
"""Blocks of either part."""

GRAVITY = (4.0, 8.0, G, 1e3 / G, 1e3, *(2.0**power / G for power in range(11, 16)))
"""Ratios of units of force, counts and full scales."""

NEAR = 0.15
"""By how much, relative to 1, the median of |a| of one part may miss such a ratio to the other."""

CHANGES = (180.0 / np.pi, 1e3, 1e3 * 180.0 / np.pi)
"""Ratios of units of rate."""

LIKE = 2.5
"""Times by which noise and turns may differ from part to part, beside their unit."""

TURNS = 20.0
"""Times the noise, by which a part must turn to be compared."""

HAND = 2.0
"""rad/s: about as fast as a hand turns. The part that is nearer to it is in rad/s."""


class Switch(NamedTuple):
    """Seconds ``interval`` of a recording, in which ``measured = factor * true`` for one triad."""

    triad: str
    factor: float
    interval: tuple[float, float]


def unit_switches(recording: Recording) -> list[Switch]:
    """Return the part of a recording, of either triad, that is in another unit than the rest."""
    size = max(4, round(BLOCK / recording.interval)) if recording.interval else 0
    count = len(recording) // size if size else 0
    if count < 2 * FEWEST:
        return []
    accel, gyro = (
        v[: count * size].reshape(count, size, 3) for v in (recording.accel, recording.gyro)
    )
    out = []
    force = np.linalg.norm(accel.mean(axis=1), axis=1)
    at = _jump(force)
    parts = force[:at], force[at:]
    first, last = (float(np.median(v)) for v in parts)
    ratio = max(first, last) / max(min(first, last), 1e-12)
    # One axis alone in another unit makes |a| another one in each pose.
    even = all(np.diff(np.quantile(v, (0.25, 0.75)))[0] < NEAR * np.median(v) for v in parts)
    if even and any(abs(ratio / change - 1) < NEAR for change in GRAVITY):
        out.append(_switch("accel", recording, at * size, first / G, last / G, 1.0))
    noise = np.diff(gyro, axis=1).std(axis=1) / np.sqrt(2.0)
    at = _jump(noise.mean(axis=1))
    quiet = [np.quantile(part, 0.2, axis=0) for part in (noise[:at], noise[at:])]
    speed = np.linalg.norm((gyro - np.median(gyro, axis=(0, 1))).mean(axis=1), axis=1)
    fast = [float(np.quantile(part, 0.95)) for part in (speed[:at], speed[at:])]
    if all((q > 0).all() and f > TURNS * q.max() for q, f in zip(quiet, fast, strict=True)):
        ratios = np.append(quiet[1] / quiet[0], fast[1] / fast[0])
        for change in CHANGES:
            off = np.abs(np.abs(np.log(ratios)) - np.log(change))
            if (off < np.log(LIKE)).all() and len(set(np.sign(np.log(ratios)))) == 1:
                out.append(
                    _switch("gyro", recording, at * size, fast[0], fast[1], HAND, change=change)
                )
                break
    return out


def _jump(level: FloatArray) -> int:
    """Return before which block the logarithm of a level most likely jumps."""
    log = np.log(np.maximum(level, 1e-12))
    n = np.arange(1, len(log))
    sums = np.cumsum(log - log.mean())[:-1]
    score = np.square(sums) * len(log) / (n * (len(log) - n))
    score[: FEWEST - 1] = score[len(log) - FEWEST :] = 0.0
    return int(np.argmax(score)) + 1


def _switch(
    triad: str,
    recording: Recording,
    at: int,
    first: float,
    last: float,
    right: float,
    *,
    change: float | None = None,
) -> Switch:
    """Return the part whose size is farther from what is right, and its factor."""
    later = abs(np.log(last / right)) > abs(np.log(first / right))
    ratio = last / first if later else first / last
    if change is not None:
        ratio = change if ratio > 1 else 1.0 / change
    time = recording.time
    span = (time[at], time[-1]) if later else (time[0], time[at - 1])
    return Switch(triad, float(ratio), (float(span[0]), float(span[1])))
