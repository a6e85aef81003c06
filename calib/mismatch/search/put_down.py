"""A first rest that settles as the others do: the sensor was put down as the recording began.

Before the first turn of a recording there is none that a settling could be counted from. What fades
in the first rest, where other rests settle, and as fast, has the same cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calib.mismatch.hypotheses.rivals import FADED, FROM_START
from calib.mismatch.search.accepted import Accepted
from calib.recording import CHANNELS

SETTLING = "accel_settling"

ACCEL = CHANNELS[:3]

ALIKE = 3.0
"""Ratio of the time constants up to which they are one: a settling is no plain exponential, and
when the sensor was put down is not known."""

WORDS = "The first rest settles too: a turn had ended just before the recording began."


def put_down(accepted: Sequence[Accepted]) -> Mapping[int, int]:
    """Return which accepted explanations are the first rest's part of a settling, and of which."""
    out: dict[int, int] = {}
    for k, own in enumerate(accepted):
        if own.candidate.name != SETTLING:
            continue
        for i, a in enumerate(accepted):
            c = a.candidate
            if c.name != FROM_START or c.interval is None or not set(c.channels) <= set(ACCEL):
                continue
            ratio = (c.interval[1] - c.interval[0]) / FADED / own.candidate.shape["tau"]
            if 1 / ALIKE <= ratio <= ALIKE:
                out[i] = k
    return out
