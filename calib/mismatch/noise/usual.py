"""Drift as it is usual: as much as that of the other channels lets one expect.

A disturbance that nobody fits raises the drift that is estimated of its channels, and hides in it.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.noise.noise import expected_levels, prior_precision
from calib.mismatch.noise.sensornoise import DRIFT
from calib.mismatch.rows.rows import Rows
from calib.types import FloatArray

RAISED = 1.5
"""How much higher the drift of a channel is than that of the others lets one expect, from which on
a disturbance may be what raises it."""


def usual_levels(rows: Rows, levels: FloatArray, channels: tuple[str, ...]) -> FloatArray | None:
    """Return levels with the drift of some channels no higher than the others' lets one expect.

    That is the mean of what the prior leaves of their logarithms beside the others' [1]_. None if
    they drift hardly more than that.

    References
    ----------
    .. [1] Rasmussen, Williams, "Gaussian Processes for Machine Learning", 2006, eq. (A.6).
    """
    own = np.array([c.group in DRIFT and c.name.split(" ")[0] in channels for c in rows.components])
    precision, expected = prior_precision(rows), expected_levels(rows)
    logs = np.log(levels / expected)
    told = -np.linalg.solve(precision[np.ix_(own, own)], precision[np.ix_(own, ~own)] @ logs[~own])
    out = levels.copy()
    out[own] = np.minimum(levels[own], expected[own] * np.exp(told))
    return out if (levels > RAISED * out).any() else None
