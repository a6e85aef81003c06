"""Where the rows of a grid stand: of each rest means and contrasts, of each turn closures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse

from calib.mismatch.noise.coupling import PARTS
from calib.mismatch.rows.grid import Grid
from calib.mismatch.rows.rows import Kind
from calib.types import FloatArray, IntArray

KNOWN = (slice(2, 5), slice(0, 5))
"""Closures of a turn that accelerometers, and gyroscopes, have a part in: of the attitude,
accelerometers know nothing."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Which rows a grid has, whatever the twin.

    Of each cell six means and twelve contrasts, and five closures of each turn.

    Parameters
    ----------
    number : int
        Of rows.
    rest, turns : (cells,), (k,) arrays of int
        Segments.
    still, cell : (p,) arrays of int
        Points at rest, and the cell of each.
    rows : (3, cells, 6) array of int
        Rows of each cell and channel: the mean, and two contrasts.
    weights : three (p,) arrays
        What points count in those.
    ends : (k, 5) array of int
        Rows of each turn.
    """

    number: int
    rest: IntArray
    turns: IntArray
    still: IntArray
    cell: IntArray
    rows: IntArray
    weights: tuple[FloatArray, FloatArray, FloatArray]
    ends: IntArray
    kind: IntArray
    channel: IntArray
    segment: IntArray
    places: tuple[tuple[IntArray, IntArray, IntArray], ...]
    """Of each channel's functional: the order of its values by rows, their points, and where each
    row begins."""

    @classmethod
    @lru_cache(maxsize=1)
    def of(cls, grid: Grid) -> Layout:
        """Return the layout of a grid."""
        rest, turns = np.flatnonzero(grid.is_rest), np.flatnonzero(~grid.is_rest)
        n_cell, n_turn = len(rest), len(turns)
        n_mean, n_close = 6 * n_cell, 5 * n_turn
        m = n_mean + n_close + 12 * n_cell
        at = np.arange(6 * n_cell).reshape(n_cell, 6)
        later = n_mean + n_close + 12 * np.arange(n_cell)[:, None] + np.arange(6)
        rows = np.stack((at, later, later + 6))
        ends = n_mean + np.arange(n_close).reshape(n_turn, 5)
        kind, segment = np.empty(m, np.int64), np.empty(m, np.int64)
        channel = np.full(m, -1, np.int64)
        kind[rows[0]], kind[rows[1:]] = Kind.MEAN, Kind.CONTRAST
        kind[ends] = [Kind.ATTITUDE] * 2 + [Kind.VELOCITY] * 3
        channel[rows] = np.arange(6)
        segment[rows], segment[ends] = rest[:, None], turns[:, None]
        still = np.flatnonzero(grid.pose >= 0)
        cell = (np.cumsum(grid.is_rest) - 1)[grid.segment[still]]
        points, spans = grid.turns
        row_of = ends[spans.turn].T
        places = []
        for c in range(6):
            known = row_of[KNOWN[c // 3]]
            row = np.concatenate((*rows[:, :, c][:, cell], *known))
            place = np.concatenate((*[still] * 3, *[points] * len(known)))
            order = np.argsort(row, kind="stable")
            begins = np.append(0, np.cumsum(np.bincount(row, minlength=m)))
            places.append((order, place[order], begins))
        weights = _cell_weights(grid.count[still], cell)
        return cls(
            m, rest, turns, still, cell, rows, weights, ends, kind, channel, segment, tuple(places)
        )

    def functional(self, c: int, turning: FloatArray, points: int) -> sparse.csr_matrix:
        """Return the rows as functionals of a channel's points; `turning` are those of turns."""
        order, place, begins = self.places[c]
        values = np.concatenate((*self.weights, *turning[KNOWN[c // 3]]))
        return sparse.csr_matrix((values[order], place, begins), shape=(self.number, points))


def _cell_weights(count: IntArray, cell: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weights of a mean and of two contrasts over the `PARTS`, all of one variance.

    Each point has its `count` of samples, and its `cell`.
    """
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    points = np.diff(first, append=len(cell))[cell]
    place = (np.arange(len(cell)) - first[cell] + 0.5) / points
    bins = np.searchsorted(PARTS, place)
    size = np.bincount(3 * cell + bins, count).reshape(-1, 3)
    share = (size / size.sum(axis=1, keepdims=True))[cell]
    mean = count / size.sum(axis=1)[cell]
    own = count / size[cell, bins]
    # Each bin against those after it; the squares over the shares add up to one.
    after = share[:, 1] + share[:, 2]
    early = np.where(bins == 0, 1.0, -share[np.arange(len(cell)), bins] / after)
    early *= np.sqrt(share[:, 0] * after)
    late = np.array([0.0, 1.0, -1.0])[bins]
    late *= np.sqrt(share[:, 1] * share[:, 2] / after)
    return mean, own * early, own * late
