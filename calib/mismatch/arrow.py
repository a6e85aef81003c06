"""The covariance of the dense rows, factored as what it is: rests of six channels, and turns.

A row at rest is of one channel, and what one channel does at rest no other knows of. A turn's rows
are of all channels, but of a channel's drift they feel one number in each turn. So the covariance
is an arrow: a block for each channel, and a border, the turns::

    V_cc = W_cc + N K N'        V_bc = R_c K_t N'        V_bb = W_bb + sum over c of R_c K_tt R_c'

with N and R_c the response of rests and turns to the drift in each segment, and K its covariance.
With ``V_cc = L L'`` and ``T = L^-1 N K_t'`` what is left of the drift in turns once the rests are
known is ``K_tt - T'T``, and the border's factor is that of ``W_bb + R_c (K_tt - T'T) R_c'``. In the
order of the rows this is the Cholesky factor of the whole, but for zeros that nobody multiplies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import linalg, sparse

from calib.types import BoolArray, FloatArray, IntArray


class Part(Protocol):
    """One unknown variance, as `calib.mismatch.rows.Component` has it."""

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
class Block:
    """Rows of one channel, and what the border feels of it.

    Parameters
    ----------
    rows : (n,) array of int
    white : (n, n) array
    which : (k,) array of int
        Components that act here.
    own, cross, far : (k, n, n), (k, t, n), (k, t, t) arrays
        Each component's covariance of the rows, of the drift in turns with them, and of that drift.
    response : sparse (b, t) matrix
        What the border feels of the drift in turns.
    """

    rows: IntArray
    white: FloatArray
    which: IntArray
    own: FloatArray
    cross: FloatArray
    far: FloatArray
    response: sparse.csr_matrix


class Known(NamedTuple):
    """A factored block: lower triangle (n, n), and what its rows tell of the drift in turns."""

    rows: IntArray
    lower: FloatArray
    told: FloatArray
    response: sparse.csr_matrix


@dataclass(frozen=True, eq=False)
class Factor:
    """The lower Cholesky factor L of the covariance: ``blocks``, and the border's own."""

    blocks: tuple[Known, ...]
    border: IntArray
    lower: FloatArray

    @classmethod
    def unit(cls, n: int) -> Factor:
        """Return the factor of n rows of independent noise of one."""
        return cls((), np.arange(n), np.eye(n))

    def solve(self, values: FloatArray) -> FloatArray:
        """Return ``L^-1 values`` for (n, ...) values."""
        out = np.empty(values.shape, order="F")
        rest = values[self.border]
        for rows, lower, told, response in self.blocks:
            white = _solve(lower, values[rows])
            out[rows] = white
            if response.nnz:
                rest -= response @ (told.T @ white)
        out[self.border] = _solve(self.lower, rest)
        return out

    def solve_transposed(self, values: FloatArray) -> FloatArray:
        """Return ``L'^-1 values`` for (n, ...) values."""
        out = np.empty(values.shape, order="F")
        last = _solve(self.lower, values[self.border], transposed=True)
        out[self.border] = last
        for rows, lower, told, response in self.blocks:
            own = values[rows]
            if response.nnz:
                own = own - told @ (response.T @ last)
            out[rows] = _solve(lower, own, transposed=True)
        return out

    def restricted(self, rows: IntArray) -> Factor:
        """Return what solves for values that are zero but on some rows, of which it takes those.

        They are those of the border and of whole blocks, in their order.
        """
        place = np.full(len(self.border) + sum(len(b.rows) for b in self.blocks), -1)
        place[rows] = np.arange(len(rows))
        blocks = tuple(
            block._replace(rows=place[block.rows])
            for block in self.blocks
            if (place[block.rows] >= 0).any()
        )
        border = place[self.border]
        known = np.concatenate((border, *(block.rows for block in blocks)))
        if (known < 0).any() or len(known) != len(rows):
            raise ValueError("`rows` must be the border and whole blocks")
        return Factor(blocks, border, self.lower)

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of the covariance."""
        parts = [self.lower, *(block.lower for block in self.blocks)]
        return 2.0 * float(sum(np.log(np.diag(lower)).sum() for lower in parts))

    def dense(self) -> FloatArray:
        """Return the whole triangle."""
        n = len(self.border) + sum(len(block.rows) for block in self.blocks)
        out = np.zeros((n, n))
        out[np.ix_(self.border, self.border)] = self.lower
        for rows, lower, told, response in self.blocks:
            out[np.ix_(rows, rows)] = lower
            out[np.ix_(self.border, rows)] = response @ told.T
        return out


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
            felt = _placed(c, rows)
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


@dataclass(frozen=True, eq=False)
class Arrow:
    """The covariance of dense rows for any levels of its components."""

    blocks: tuple[Block, ...]
    border: IntArray
    white: FloatArray
    alone: Banded
    """Components that act on the border only."""
    number: int
    """Of components."""

    @classmethod
    def of(cls, white: FloatArray, channel: IntArray, components: Sequence[Part]) -> Arrow:
        """Sort the (n, n) white noise and components of rows, whose ``channel`` is -1 for turns."""
        border = np.flatnonzero(channel < 0)
        felt = [np.unique(channel[c.index]) for c in components]
        # What acts on several channels are errors that each row has by itself.
        single = np.array([(f >= 0).sum() == 1 for f in felt])
        apart = [i for i in range(len(components)) if not single[i] and -1 in felt[i]]
        alone = Banded.of(np.array(apart, np.int64), [components[i] for i in apart], border)
        blocks = []
        for k in np.unique(channel[channel >= 0]):
            which = np.flatnonzero([k in f for f in felt])
            rows = np.flatnonzero(channel == k)
            blocks.append(_block(white, rows, border, components, which, single))
        return cls(tuple(blocks), border, white[np.ix_(border, border)], alone, len(components))

    def factorise(self, levels: FloatArray) -> Factor:
        """Return the factor of the covariance at some levels."""
        known, last = [], self.white.copy()
        for block in self.blocks:
            own, cross, far = (
                (levels[block.which] @ _flat(part)).reshape(part.shape[1:])
                for part in (block.own, block.cross, block.far)
            )
            lower = _factor(block.white + own)
            told = _solve(lower, cross.T)
            known.append(Known(block.rows, lower, told, block.response))
            if block.response.nnz:
                far -= told.T @ told
                last += block.response @ (block.response @ far).T
        self.alone.add_to(last, levels)
        return Factor(tuple(known), self.border, _factor(last))

    def slopes(
        self, factor: Factor, mean: FloatArray, left: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the restricted likelihood needs to climb.

        With ``P = inv(V) - inv(V) X inv(X' inv(V) X) X' inv(V)``: P y, the traces of ``P V_i``, and
        the columns ``V_i P y`` of the k components for a level of one, (n,), (k,), (n, k).

        Parameters
        ----------
        mean, left : (n, p), (n,) arrays
            An orthonormal basis of the whitened mean, and what it leaves of the whitened y.
        """
        half = factor.solve_transposed(np.column_stack((mean, left)))
        half, py = half[:, :-1], half[:, -1]
        trace, pull = np.zeros(self.number), np.zeros((len(py), self.number))
        inverse = _inverse(factor.lower)
        for block, known in zip(self.blocks, factor.blocks, strict=True):
            felt = block.response.T
            seen = felt @ inverse.T
            inner = seen @ seen.T
            whole = _inverse(known.lower)
            told = known.told.T @ whole
            here, there = half[block.rows], felt @ half[self.border]
            own = whole.T @ whole + told.T @ inner @ told - here @ here.T
            cross = -inner @ told - there @ here.T
            trace[block.which] += (
                _flat(block.own) @ own.ravel()
                + 2.0 * _flat(block.cross) @ cross.ravel()
                + _flat(block.far) @ (inner - there @ there.T).ravel()
            )
            y, y_far = py[block.rows], felt @ py[self.border]
            pull[np.ix_(block.rows, block.which)] = (block.own @ y + y_far @ block.cross).T
            pull[np.ix_(self.border, block.which)] += (
                block.response @ (block.cross @ y + block.far @ y_far).T
            )
        alone = self.alone
        trace[alone.which] += alone.traces(inverse) - alone.traces(half[self.border].T)
        pull[np.ix_(self.border, alone.which)] += alone.times(py[self.border]).T
        return py, trace, pull


def _block(
    white: FloatArray,
    rows: IntArray,
    border: IntArray,
    components: Sequence[Part],
    which: IntArray,
    single: BoolArray,
) -> Block:
    near = [_placed(components[i], rows).toarray() for i in which]
    far = [_placed(components[i], border) for i in which if single[i]]
    response = sparse.csr_matrix((len(border), 0))
    turns = np.zeros(0, np.int64)
    if any(f.nnz for f in far):
        if any(f.shape != far[0].shape or (f != far[0]).nnz for f in far):
            raise ValueError("`components` of one channel must be felt alike in turns")
        turns = np.flatnonzero(far[0].getnnz(axis=0))
        response = far[0][:, turns].tocsr()
    n, t = len(rows), len(turns)
    own, cross, there = (np.zeros((len(which), *shape)) for shape in ((n, n), (t, n), (t, t)))
    for k, i in enumerate(which):
        kernel = components[i].kernel
        felt = kernel @ near[k].T
        own[k] = near[k] @ felt
        if single[i]:
            cross[k], there[k] = felt[turns], kernel[np.ix_(turns, turns)]
    return Block(rows, white[np.ix_(rows, rows)], which, own, cross, there, response)


def _placed(part: Part, rows: IntArray) -> sparse.csr_matrix:
    """Return the response of these rows, of which each is in its order, (len(rows), s)."""
    place = np.full(int(max(rows.max(initial=-1), part.index.max(initial=-1))) + 1, -1)
    place[rows] = np.arange(len(rows))
    found = part.response.tocoo()
    row = place[part.index[found.row]]
    own = row >= 0
    shape = (len(rows), found.shape[1])
    return sparse.csr_matrix((found.data[own], (row[own], found.col[own])), shape=shape)


def _flat(parts: FloatArray) -> FloatArray:
    """Return each of the k matrices as a row: a product with them is then one of a matrix."""
    return parts.reshape(len(parts), int(np.prod(parts.shape[1:])))


def _factor(matrix: FloatArray) -> FloatArray:
    # The transpose is in Fortran's order, so that LAPACK copies nothing.
    lower = linalg.cholesky(matrix.T, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(lower)


def _inverse(lower: FloatArray) -> FloatArray:
    if not len(lower):
        return lower
    return np.asarray(linalg.lapack.dtrtri(lower, lower=1)[0])


def _solve(lower: FloatArray, values: FloatArray, *, transposed: bool = False) -> FloatArray:
    """Return ``L^-1 values`` or ``L'^-1 values``, without the checks of SciPy's own."""
    if not lower.size:
        return values
    columns = values if values.ndim > 1 else values[:, None]
    found = linalg.blas.dtrsm(1.0, lower, columns, lower=1, trans_a=int(transposed))
    return np.asarray(found if values.ndim > 1 else found[:, 0])
