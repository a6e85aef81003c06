"""Bumps: a sensor tilts within a tenth of a second, and gravity stays where that brought it.

Who reaches for something beside it, or lets go of its cable, tilts it by a hundredth of a degree or
by one. The gyroscope sees that as a pulse of few samples.
"""

from __future__ import annotations

import numpy as np

from calib.recording import Recording
from calib.types import FloatArray

PLAIN, CLEARLY = 16.0, 4.0
"""How much better a tilt explains how gravity changed than chance does: by chi-squared, and as a
ratio."""

UNSURE = 2.0
"""Factor within which few samples of a pulse tell its size."""

BESIDE = 1.0
"""s before and after a pulse over which gravity is compared."""

FEWEST, PARTS = 16, 8
"""Samples there, at least, and parts whose means tell how well theirs is known."""


def gravity_followed(change: FloatArray, predicted: FloatArray, error: FloatArray) -> bool:
    """Return whether specific force changed as predicted, up to a factor.

    Parameters
    ----------
    change, predicted : (3,) arrays, m/s²
    error : (3,) array, m/s²
        Standard deviations of the change.
    """
    if not (error > 0).all():
        return False
    seen, wanted = change / error, predicted / error
    factor = float(seen @ wanted) / max(float(wanted @ wanted), np.finfo(float).tiny)
    left = float(np.square(seen - factor * wanted).sum())
    moved = float(np.square(seen).sum())
    return 1 / UNSURE < factor < UNSURE and moved > PLAIN + left and moved > CLEARLY * left


def is_tilt(recording: Recording, start: int, stop: int) -> bool:
    """Return whether samples ``[start, stop)`` of a gyroscope are of a sensor that was tilted.

    It is at rest before, and after.
    """
    step = recording.interval
    if step <= 0 or recording.clock == "invalid":
        return False
    width = max(FEWEST, round(BESIDE / step))
    first, last = start - 2, stop + 2
    if first < FEWEST or last + FEWEST > len(recording):
        return False
    return tilted(recording, slice(max(first - width, 0), first), slice(last, last + width))


def tilted(recording: Recording, before: slice, after: slice) -> bool:
    """Return whether gravity turned between two rests as the gyroscope says that the sensor did."""
    rests = np.r_[before, after]
    turning = recording.gyro[before.stop : after.start] - recording.gyro[rests].mean(axis=0)
    angle = recording.interval * turning.sum(axis=0)
    early, late = recording.accel[before], recording.accel[after]
    change = late.mean(axis=0) - early.mean(axis=0)
    error = np.sqrt(_mean_variance(early) + _mean_variance(late))
    predicted = np.cross(recording.accel[rests].mean(axis=0), angle)
    return gravity_followed(change, predicted, error)


def _mean_variance(values: FloatArray) -> FloatArray:
    """Return the variance of the mean of (n, 3) values, as means of parts of them scatter."""
    width = len(values) // PARTS
    number = len(values) // width
    means = values[: number * width].reshape(number, width, 3).mean(axis=1)
    return np.asarray(np.square(np.diff(means, axis=0)).mean(axis=0) / (2.0 * number))
