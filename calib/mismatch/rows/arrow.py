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

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import linalg, sparse

from calib.mismatch.rows.banded import Banded, Part, placed
from calib.types import BoolArray, FloatArray, IntArray

ROUNDED = (1e-13, 1e-11, 1e-9, 1e-7)
"""Shares of variances that may be noise of their own, so that a covariance has a Cholesky factor:
rounding leaves it with none where errors of hundreds of g are next to those of white noise."""

HALVED = 64
"""Rows of a triangle above which it is inverted by halves."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Rows of q channels that are alike in shape, and what the border feels of each.

    Parameters
    ----------
    rows : (q, n) array of int
    white : (q, n, n) array
    which : (q, k) array of int
        Components that act here.
    own, cross, far : (q, k, n, n), (q, k, t, n), (q, k, t, t) arrays
        Each component's covariance of the rows, of the drift in turns with them, and of that drift.
    responses : q sparse (b, t) matrices
        What the border feels of the drift in turns.
    response : sparse (b, q t) matrix
        All of these, side by side.
    """

    rows: IntArray
    white: FloatArray
    which: IntArray
    own: FloatArray
    cross: FloatArray
    far: FloatArray
    responses: tuple[sparse.csr_matrix, ...]
    response: sparse.csr_matrix


class Known(NamedTuple):
    """Factored blocks: lower triangles (q, n, n) and their inverses, and what rows tell of turns.

    ``told`` is (q, n, t); rows and responses are as in `Blocks`.
    """

    rows: IntArray
    lower: FloatArray
    inverse: FloatArray
    told: FloatArray
    responses: tuple[sparse.csr_matrix, ...]
    response: sparse.csr_matrix

    def chosen(self, place: IntArray) -> Known | None:
        """Return those blocks of which `place` says where their rows are, None if there is none."""
        rows = place[self.rows]
        own = np.flatnonzero((rows >= 0).any(axis=1))
        if len(own) == len(rows):
            return self._replace(rows=rows)
        if not len(own):
            return None
        some = tuple(self.responses[i] for i in own)
        beside = some[0] if len(some) == 1 else sparse.hstack(some, format="csr")
        return Known(rows[own], self.lower[own], self.inverse[own], self.told[own], some, beside)


@dataclass(frozen=True, eq=False)
class Factor:
    """The lower Cholesky factor L of the covariance: ``blocks``, and the border's own.

    ``inverse`` is that of the border's triangle ``lower``, so that solving is a product.
    """

    blocks: tuple[Known, ...]
    border: IntArray
    lower: FloatArray
    inverse: FloatArray

    @classmethod
    def unit(cls, n: int) -> Factor:
        """Return the factor of n rows of independent noise of one."""
        return cls((), np.arange(n), np.eye(n), np.eye(n))

    def solve(self, values: FloatArray) -> FloatArray:
        """Return ``L^-1 values`` for (n, ...) values."""
        columns = values if values.ndim > 1 else values[:, None]
        out, rest = np.empty(columns.shape), columns[self.border]
        for known in self.blocks:
            white = known.inverse @ columns[known.rows]
            out[known.rows] = white
            if known.response.nnz:
                told = np.swapaxes(known.told, 1, 2) @ white
                rest -= known.response @ told.reshape(known.response.shape[1], rest.shape[1])
        out[self.border] = _times(self.inverse, rest)
        return out.reshape(values.shape)

    def solve_transposed(self, values: FloatArray) -> FloatArray:
        """Return ``L'^-1 values`` for (n, ...) values."""
        columns = values if values.ndim > 1 else values[:, None]
        out = np.empty(columns.shape)
        last = _times(self.inverse, columns[self.border], transposed=True)
        out[self.border] = last
        for known in self.blocks:
            own = columns[known.rows]
            if known.response.nnz:
                felt = known.response.T @ last
                own -= known.told @ felt.reshape(len(own), known.told.shape[2], last.shape[1])
            out[known.rows] = np.swapaxes(known.inverse, 1, 2) @ own
        return out.reshape(values.shape)

    def restricted(self, rows: IntArray) -> Factor:
        """Return what solves for values that are zero but on some rows, of which it takes those.

        They are those of the border and of whole blocks, in their order.
        """
        place = np.full(len(self.border) + sum(known.rows.size for known in self.blocks), -1)
        place[rows] = np.arange(len(rows))
        some = (known.chosen(place) for known in self.blocks)
        blocks = tuple(known for known in some if known is not None)
        border = place[self.border]
        found = np.concatenate((border, *(known.rows.ravel() for known in blocks)))
        if (found < 0).any() or len(found) != len(rows):
            raise ValueError("`rows` must be the border and whole blocks")
        return Factor(blocks, border, self.lower, self.inverse)

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of the covariance."""
        parts = [self.lower, *(lower for known in self.blocks for lower in known.lower)]
        return 2.0 * float(sum(np.log(np.diag(lower)).sum() for lower in parts))

    def dense(self) -> FloatArray:
        """Return the whole triangle."""
        n = len(self.border) + sum(known.rows.size for known in self.blocks)
        out = np.zeros((n, n))
        out[np.ix_(self.border, self.border)] = self.lower
        for known in self.blocks:
            for rows, lower, told, response in zip(
                known.rows, known.lower, known.told, known.responses, strict=True
            ):
                out[np.ix_(rows, rows)] = lower
                out[np.ix_(self.border, rows)] = response @ told.T
        return out


@dataclass(frozen=True, eq=False)
class Arrow:
    """The covariance of dense rows for any levels of its components."""

    blocks: tuple[Blocks, ...]
    border: IntArray
    white: FloatArray
    alone: Banded
    """Components that act on the border only."""
    number: int
    """Of components."""
    _last: dict[bytes, Factor] = field(default_factory=dict)

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
        inner = white[np.ix_(border, border)]
        return cls(_side_by_side(blocks), border, inner, alone, len(components))

    def factorise(self, levels: FloatArray) -> Factor:
        """Return the factor of the covariance at some levels; the last one is kept."""
        key = levels.tobytes()
        if key not in self._last:
            self._last.clear()
            self._last[key] = self._factorised(levels)
        return self._last[key]

    def _factorised(self, levels: FloatArray) -> Factor:
        blocks, last = [], self.white.copy()
        for block in self.blocks:
            own, cross, far = (
                (levels[block.which][:, None] @ _flat(part)).reshape(len(part), *part.shape[2:])
                for part in (block.own, block.cross, block.far)
            )
            lower = np.asarray(np.linalg.cholesky(block.white + own), np.float64)
            inverse = np.stack([_inverse(one) for one in lower])
            told = inverse @ np.swapaxes(cross, 1, 2)
            blocks.append(Known(block.rows, lower, inverse, told, block.responses, block.response))
            if block.response.nnz:
                far -= np.swapaxes(told, 1, 2) @ told
                felt = np.empty((*far.shape[:2], len(last)))
                for one, r, left in zip(felt, block.responses, far, strict=True):
                    one[:] = (r @ left).T  # sparse products want rows one after the other
                last += block.response @ felt.reshape(-1, len(last))
        self.alone.add_to(last, levels)
        lower = _factor(last)
        return Factor(tuple(blocks), self.border, lower, _inverse(lower))

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
        half, py = factor.solve_transposed(mean), factor.solve_transposed(left)
        trace, pull = np.zeros(self.number), np.zeros((len(py), self.number))
        inverse = factor.inverse
        for block, known in zip(self.blocks, factor.blocks, strict=True):
            q, t = len(block.rows), block.far.shape[-1]
            felt = block.response.T
            seen = (felt @ inverse.T).reshape(q, t, len(self.border))
            inner = seen @ np.swapaxes(seen, 1, 2)
            whole = known.inverse
            told = np.swapaxes(known.told, 1, 2) @ whole
            here = half[block.rows]
            there = (felt @ half[self.border]).reshape(q, t, half.shape[1])
            here_too, there_too = np.swapaxes(here, 1, 2), np.swapaxes(there, 1, 2)
            beyond = inner @ told
            own = np.swapaxes(whole, 1, 2) @ whole - here @ here_too
            own += np.swapaxes(told, 1, 2) @ beyond
            cross = -beyond - there @ here_too
            both = _flat(block.own) @ own.reshape(q, -1, 1)
            both += 2.0 * _flat(block.cross) @ cross.reshape(q, -1, 1)
            both += _flat(block.far) @ (inner - there @ there_too).reshape(q, -1, 1)
            # One component may act on several channels.
            np.add.at(trace, block.which, both[:, :, 0])
            y = py[block.rows][:, None, :, None]
            y_far = (felt @ py[self.border]).reshape(q, 1, t, 1)
            near = block.own @ y + np.swapaxes(block.cross, 2, 3) @ y_far
            pull[block.rows[:, None], block.which[:, :, None]] = near[..., 0]
            drift = np.zeros((q, t, self.number))
            drift[np.arange(q)[:, None, None], np.arange(t), block.which[:, :, None]] = (
                block.cross @ y + block.far @ y_far
            )[..., 0]
            pull[self.border] += block.response @ drift.reshape(q * t, self.number)
        alone = self.alone
        trace[alone.which] += alone.traces(inverse) - alone.traces(half[self.border].T)
        pull[np.ix_(self.border, alone.which)] += alone.times(py[self.border]).T
        return py, trace, pull


def _side_by_side(blocks: Sequence[Blocks]) -> tuple[Blocks, ...]:
    """Return single blocks, those that are alike in shape together."""
    alike: dict[tuple[int, ...], list[Blocks]] = {}
    for block in blocks:
        alike.setdefault(block.cross.shape, []).append(block)
    return tuple(
        Blocks(
            rows=np.concatenate([block.rows for block in some]),
            white=np.concatenate([block.white for block in some]),
            which=np.concatenate([block.which for block in some]),
            own=np.concatenate([block.own for block in some]),
            cross=np.concatenate([block.cross for block in some]),
            far=np.concatenate([block.far for block in some]),
            responses=tuple(block.response for block in some),
            response=sparse.hstack([block.response for block in some], format="csr"),
        )
        for some in alike.values()
    )


def _block(
    white: FloatArray,
    rows: IntArray,
    border: IntArray,
    components: Sequence[Part],
    which: IntArray,
    single: BoolArray,
) -> Blocks:
    near = [placed(components[i], rows).toarray() for i in which]
    far = [placed(components[i], border) for i in which if single[i]]
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
    return Blocks(
        rows=rows[None],
        white=white[np.ix_(rows, rows)][None],
        which=which[None],
        own=own[None],
        cross=cross[None],
        far=there[None],
        responses=(response,),
        response=response,
    )


def _flat(parts: FloatArray) -> FloatArray:
    """Return each of the (q, k) matrices as a row: a product with them is then one of a matrix."""
    return parts.reshape(*parts.shape[:2], int(np.prod(parts.shape[2:])))


def _factor(matrix: FloatArray) -> FloatArray:
    """Return the Cholesky factor of a covariance; where rounding has spoilt it, of one near it."""
    for share in ROUNDED:
        try:
            # The transpose is in Fortran's order, as LAPACK wants it.
            return np.asarray(linalg.cholesky(matrix.T, lower=True, check_finite=False))
        except linalg.LinAlgError:
            matrix = matrix + share * np.diag(np.diag(matrix))
    return np.asarray(linalg.cholesky(matrix.T, lower=True, check_finite=False))


def _inverse(lower: FloatArray) -> FloatArray:
    """Return the inverse of a lower triangle, of a large one by those of its halves.

    ``[[A, 0], [C, B]]`` has ``[[A^-1, 0], [-B^-1 C A^-1, B^-1]]``: products are several times
    faster than LAPACK's inversion of triangles.
    """
    n = len(lower)
    if not n:
        return lower
    if n <= HALVED:
        return np.asarray(linalg.lapack.dtrtri(lower, lower=1)[0])
    half, out = n // 2, np.zeros((n, n))
    first = out[:half, :half] = _inverse(lower[:half, :half])
    last = out[half:, half:] = _inverse(lower[half:, half:])
    out[half:, :half] = -(last @ (lower[half:, :half] @ first))
    return out


def times_inverse(values: FloatArray, lower: FloatArray) -> FloatArray:
    """Return ``values L'^-1`` for (n, k) values.

    Where n is many times k, a product with the inverse is twice as fast as solving.
    """
    if not values.size:
        return values
    return np.asarray(linalg.blas.dtrmm(1.0, _inverse(lower), values.T, lower=1).T)


def _times(inverse: FloatArray, values: FloatArray, *, transposed: bool = False) -> FloatArray:
    """Return a lower triangle, or its transpose, times (n, k) values, in the place of these."""
    if not inverse.size or values.shape[1] == 1:
        return np.asarray((inverse.T if transposed else inverse) @ values)
    # Rows that lie one after the other are columns of the transpose: BLAS copies nothing.
    return np.asarray(
        linalg.blas.dtrmm(
            1.0, inverse.T, values.T, side=1, lower=0, trans_a=int(transposed), overwrite_b=1
        ).T
    )
