"""Turns that close so badly that no noise does it: something is there that has no name."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.rows.rows import SAMPLING, Rows
from calib.recording import CHANNELS
from calib.types import FloatArray

BEYOND = 5.0
"""Spreads of its level by which noise is more than any: a factor of 500 in size. Shocks, and a
clock of whole milliseconds, make turns of real logs err by up to fifty times what is expected."""

LEAST = {"attitude": 0.1, "velocity": 1.0}
"""rad and m/s by which turns are off then at least, however little a sensor's own noise is."""

CLOSES = {"attitude": CHANNELS, "velocity": CHANNELS[:3]}
"""What does not close where an angle, or a velocity, does not."""


def misclosed(rows: Rows, levels: FloatArray) -> tuple[Unexplained, ...]:
    """Return what the noise of closures would have to be that none is, as unexplained.

    Parameters
    ----------
    rows : Rows
    levels : (c,) array
        With all that was found in the mean.
    """
    out: dict[str, Unexplained] = {}
    whole = (float(rows.interval[0, 0]), float(rows.interval[-1, 1]))
    for c, level, expected in zip(rows.components, levels, expected_levels(rows), strict=True):
        closed = c.name.split(" ")[0]
        if c.name.endswith(SAMPLING):
            # Nor is that what samples do not resolve: of a rate an angle, of a force a velocity.
            closed = {"rate": "attitude", "force": "velocity"}.get(closed, closed)
        if closed not in CLOSES or not c.variance.size:
            continue
        beyond = float(np.log(level / expected)) / c.spread
        size = np.sqrt(level * np.median(c.variance))
        if beyond > BEYOND and size > LEAST[closed]:
            chance = float(ndtr(-beyond))
            if closed not in out or chance < out[closed].p_value:
                follows = f"motion: no sensor's noise leaves a turn's {closed} so far off"
                out[closed] = Unexplained(CLOSES[closed], (whole,), follows, chance)
    return tuple(out.values())
