"""Unknown variances of rows: what they are, and those that are alike within one turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from calib.types import FloatArray, IntArray


class Part(Protocol):
    """One unknown variance, as `calib.mismatch.rows.rows.Component` has it."""

    @property
    def index(self) -> IntArray:
        """Dense rows that it acts on, (k,)."""
        ...

    @property
    def response(self) -> Any:
        """What each of them feels of the drift in each segment, sparse (k, s)."""
        ...

    @property
    def kernel(self) -> FloatArray:
        """Covariance of that drift for a level of one, (s, s)."""
        ...


@dataclass(frozen=True, eq=False)
class Banded:
    """Symmetric matrices that are zero but near their diagonals: what is alike in one turn.

    Parameters
    ----------
    which : (k,) array of int
        The numbers of the components that have them.
    bands : mapping of int to (k, n - d) array
        The elements d below the diagonal, ``M[i + d, i]``.
    """

    which: IntArray
    bands: Mapping[int, FloatArray]

    @classmethod
    def of(cls, which: IntArray, components: Sequence[Part], rows: IntArray) -> Banded:
        """Return the covariance of some rows for a level of one of each component."""
        bands: dict[int, FloatArray] = {}
        for k, c in enumerate(components):
            felt = placed(c, rows)
            found = (felt @ sparse.csr_matrix(c.kernel) @ felt.T).tocoo()
            for d in np.unique(found.row - found.col).tolist():
                own = found.row - found.col == d
                if d >= 0:
                    band = bands.setdefault(d, np.zeros((len(components), len(rows) - d)))
                    band[k, found.col[own]] = found.data[own]
        return cls(which, bands)

    def add_to(self, matrix: FloatArray, levels: FloatArray) -> None:
        """Add the sum of all, each times its level, to a matrix (n, n) in the order of C."""
        n, flat = len(matrix), matrix.reshape(-1)
        for d, band in self.bands.items():
            values = levels[self.which] @ band
            flat[d * n :: n + 1] += values
            if d:
                flat[d : (n - d) * n : n + 1] += values

    def traces(self, columns: FloatArray) -> FloatArray:
        """Return the traces of ``M C'C`` for the columns (m, n) of C, (k,)."""
        out = np.zeros(len(self.which))
        for d, band in self.bands.items():
            inner = np.einsum("in,in->n", columns[:, d:], columns[:, : band.shape[1]])
            out += (2.0 if d else 1.0) * (band @ inner)
        return out

    def times(self, values: FloatArray) -> FloatArray:
        """Return the products with values (n,), (k, n)."""
        out = np.zeros((len(self.which), len(values)))
        for d, band in self.bands.items():
            out[:, d:] += band * values[: band.shape[1]]
            if d:
                out[:, : band.shape[1]] += band * values[d:]
        return out


def placed(part: Part, rows: IntArray) -> sparse.csr_matrix:
    """Return the response of these rows, of which each is in its order, (len(rows), s)."""
    place = np.full(int(max(rows.max(initial=-1), part.index.max(initial=-1))) + 1, -1)
    place[rows] = np.arange(len(rows))
    found = part.response.tocoo()
    row = place[part.index[found.row]]
    own = row >= 0
    shape = (len(rows), found.shape[1])
    return sparse.csr_matrix((found.data[own], (row[own], found.col[own])), shape=shape)
