"""Knocks at the bench: for a moment several channels ring at once, and then they rest again.

That is motion, which all of them follow, and no disturbance of any.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from calib.poses import Poses
from calib.recording import Recording
from calib.types import BoolArray

PART = 16
"""Samples in which the power of a channel is looked at."""

FREEDOM = PART - 2
"""Of what is left of it beside a straight line."""

CHANCE = 1e-4
"""How often noise alone makes a part as loud on one channel."""

TOGETHER = 2
"""Channels that are loud at once, at least: one alone may be disturbed."""

QUIET = 0.2
"""Share of a rest that is quiet beside a knock; one without is like that throughout."""


def knocked(recording: Recording, poses: Poses) -> BoolArray:
    """Return which samples of rests are of a knock, (n,) bool.

    Parts of a rest, each without its straight line, by which a hand sways, are compared with the
    quiet ones of this rest: one in which noise is louder throughout, or which has a line, has none
    that stands out.
    """
    line = np.vander(np.linspace(-1.0, 1.0, PART), 2)
    ring = np.eye(PART) - line @ np.linalg.pinv(line)
    out = np.zeros(len(recording.time), bool)
    for a, b in zip(poses.start, poses.stop, strict=True):
        number = (b - a) // PART
        if number < 3:
            continue
        part = slice(a, a + number * PART)
        values = np.hstack((recording.accel[part], recording.gyro[part]))
        power = np.square(ring @ values.reshape(number, PART, 6)).sum(axis=1) / FREEDOM
        usual = np.quantile(power, QUIET, axis=0)
        ratio = np.divide(power, usual, out=np.ones_like(power), where=usual > 0)
        loud = fdtrc(FREEDOM, FREEDOM * number / 2, ratio) < CHANCE
        knock = loud.sum(axis=1) >= TOGETHER
        # It began, and fades, beside the parts that stand out.
        knock = np.convolve(knock, np.ones(3), mode="same") > 0
        if knock.mean() <= 1 - QUIET:
            out[part] = np.repeat(knock, PART)
            out[a + number * PART : b] = knock[-1]
    return out
