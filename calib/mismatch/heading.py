"""Orientation through a recording: up is seen at every rest, heading is carried by the turns.

Heading at the first rest is not known and taken as it comes, so that east and north of the result
are rotated by it. Over fifty turns it drifts by a few degrees, which is good enough for what is
judged by it: the Earth's rotation, which few recordings show to better than a tenth.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.closure import across
from calib.mismatch.grid import Grid
from calib.rotation import integrate_rate, mat_from_quat
from calib.types import FloatArray


def orient(grid: Grid, up: FloatArray, rate: FloatArray) -> FloatArray | None:
    """Return ``mat_ns`` (n, 3, 3) on the grid's points.

    Parameters
    ----------
    grid : Grid
    up : (k, 3) array
        Unit vector up in frame s at each rest.
    rate : (n, 3) array, rad/s
        Corrected.

    Returns
    -------
    (n, 3, 3) array, or None where two rests are not joined by a turn: heading is lost there.
    """
    turns = np.flatnonzero(~grid.is_rest)
    if not np.array_equal(grid.before[turns], np.arange(grid.n_poses - 1)):
        return None
    out = np.empty((len(grid.time), 3, 3))
    pose = grid.pose
    mat = _upright(across(up[0])[:, 0], up[0])
    out[pose == 0] = mat
    for s in turns:
        points = slice(int(grid.first[s]), int(grid.last[s]))
        after = int(grid.after[s])
        out[points] = mat @ mat_from_quat(integrate_rate(grid.time[points], rate[points]))
        mat = _upright(out[points.stop - 1, 0], up[after])
        out[pose == after] = mat
    return out


def _upright(east: FloatArray, up: FloatArray) -> FloatArray:
    """Return ``mat_ns`` whose rows are east (made horizontal), north and up."""
    level = east - (east @ up) * up
    level /= np.linalg.norm(level)
    return np.stack((level, np.cross(up, level), up))
