"""Counts of logs that keep so many significant digits: they grow with the size of a value.

A log with three digits (``%.3g``) steps by 0.001 below 1, by 0.01 up to 10, and by 0.1 above. Its
smallest step says nothing of the larger values: these stay where they are for longer, and leave it
by ten or a hundred of those.
"""

from __future__ import annotations

import numpy as np

from calib.gravity import STANDARD_GRAVITY
from calib.types import FloatArray

MOST = 5
"""Digits, at most, that are looked for: more are finer than any sensor's noise."""

UNITS = (1.0, STANDARD_GRAVITY, STANDARD_GRAVITY / 1000.0, np.pi / 180.0)
"""Units in which a log may have been written, in those of its values."""

FEWEST = 50
"""Different values that tell how many digits there are."""

SAMPLE, WHOLE = 5000, 1e-6
"""Values that are looked at first; and how near a whole number of counts is one."""


def counts_at(values: FloatArray, step: FloatArray) -> FloatArray:
    """Return the count at each of (n, k) values, and at those beside it, (n, k).

    It is ``step`` (k,), the smallest one, but in logs of so many significant digits.
    """
    out = np.broadcast_to(step, values.shape)
    for c, channel in enumerate(values.T):
        own = _counts(channel)
        if own is not None and (own > 1.5 * step[c]).any():
            padded = np.pad(np.maximum(own, step[c]), 1, mode="edge")
            out = out.copy() if not out.flags.writeable else out
            out[:, c] = np.maximum(np.maximum(padded[:-2], padded[2:]), padded[1:-1])
    return out


def _counts(channel: FloatArray) -> FloatArray | None:
    """Return the count at each value (n,) of a channel that keeps so many digits, or None."""
    some = channel[:: max(len(channel) // SAMPLE, 1)]
    if len(np.unique(some)) < FEWEST:
        return None
    for unit in UNITS:
        for digits in range(2, MOST + 1):
            if _fits(some / unit, digits) and _fits(channel / unit, digits):
                return unit * _decimal(channel / unit, digits)
            if not _fits(some / unit, MOST):
                break
    return None


def _decimal(values: FloatArray, digits: int) -> FloatArray:
    """Return the place of the last of so many digits of each value; 0 of zero."""
    size = np.abs(values)
    # A value that is 1 but for rounding has the place of 1.
    place = np.floor(np.log10(np.where(size > 0, size, 1.0)) + 1e-12)
    return np.asarray(np.where(size > 0, np.power(10.0, place - (digits - 1)), 0.0))


def _fits(values: FloatArray, digits: int) -> bool:
    """Return whether values have no more than so many digits."""
    place = _decimal(values, digits)
    count = values / np.where(place > 0, place, 1.0)
    return bool((np.abs(count - np.rint(count)) < WHOLE).all())
