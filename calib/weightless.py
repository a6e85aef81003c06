"""Stretches in which an accelerometer reads far less than gravity: nothing falls for so long.

A drop by 5 m lasts a second. Longer, another signal is on its channels, or none.
"""

from __future__ import annotations

import numpy as np

from calib.gravity import STANDARD_GRAVITY
from calib.stillness import runs
from calib.types import FloatArray

WINDOW = 0.5
"""s over which the length of the specific force is one: its median."""

LONG = 5.0
"""s that nothing falls for, and few rests in one pose last."""

LIGHT = 0.5
"""Of gravity: no accelerometer is off by as much, and what shakes it mostly reads more."""


def find_weightless(accel: FloatArray, interval: float) -> list[tuple[int, int]]:
    """Return ``(start, stop)`` of samples in which specific force (n, 3), m/s², is too small."""
    if interval <= 0:
        return []
    size = max(round(WINDOW / interval), 1)
    number = len(accel) // size
    length = np.linalg.norm(accel[: number * size], axis=1).reshape(number, size)
    start, stop = runs(np.median(length, axis=1) < LIGHT * STANDARD_GRAVITY)
    long = (stop - start) * size * interval >= LONG
    return list(zip((start[long] * size).tolist(), (stop[long] * size).tolist(), strict=True))
