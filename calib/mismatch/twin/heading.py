"""Orientation through a recording: up is seen at every rest, heading is carried by the turns.

Heading at the first rest is not known and taken as it comes, so that east and north of the result
are rotated by it. Over fifty turns it drifts by a few degrees, which is good enough for what is
judged by it: the Earth's rotation, which few recordings show to better than a tenth.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.rows.closure import across, turned_frames
from calib.mismatch.rows.grid import Grid
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
    points, spans = grid.turns
    turned = turned_frames(spans, rate[points])
    stands = [_upright(across(up[0])[:, 0], up[0])]
    for end, above in zip(turned[spans.last], up[grid.after[turns]], strict=True):
        stands.append(_upright((stands[-1] @ end)[0], above))
    stood = np.stack(stands)
    # The turns join each rest to the next.
    out = stood[grid.pose]
    out[points] = stood[:-1][spans.turn] @ turned
    return out


def _upright(east: FloatArray, up: FloatArray) -> FloatArray:
    """Return ``mat_ns`` whose rows are east (made horizontal), north and up."""
    level = east - (east @ up) * up
    level /= np.sqrt(level @ level)
    (a, b, c), (x, y, z) = up, level
    # `np.cross` of two vectors takes longer than all the rest.
    return np.array((level, (b * z - c * y, c * x - a * z, a * y - b * x), up))
