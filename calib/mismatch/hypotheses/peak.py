"""Where a function of one size or moment is highest, near a place that is known to be high."""

from __future__ import annotations

from collections.abc import Callable

CLOSE = 0.02
"""Step that is too small to matter, relative to the first."""


def close_in(gain: Callable[[float], float], here: float, value: float, step: float) -> float:
    """Return the highest value that is met, stepping uphill from `here`, where it is `value`.

    Steps either way are a third where neither leads up, down to `CLOSE` of the first.
    """
    least = CLOSE * step
    while step > least:
        new, at = max((gain(x), x) for x in (here - step, here + step))
        if new > value:
            value, here = new, at
        else:
            step /= 3
    return value
