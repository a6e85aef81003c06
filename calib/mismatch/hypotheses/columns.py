"""Columns that candidates share, on the rows that they touch.

What a rival does on one channel touches the rows of that channel at rest, and the turns: a third of
all rows. Whitening keeps it so, as the covariance is an arrow (`rows.arrow`). What is
fitted is projected out of products alone: with B its orthonormal basis, and W whitened columns,

    (W - B B'W)' (W - B B'W) = W'W - (B'W)' (B'W).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from calib.mismatch.noise.noise import Whitener
from calib.types import FloatArray, IntArray

LOST = 1e-8
"""Share of a column's power that what is fitted must leave, or it cannot be told from that."""

PART = 256
"""Columns that are worked on at a time: whitening needs copies."""


def run(index: IntArray) -> IntArray | slice:
    """Return numbers as a slice where they follow one another: taking that copies nothing."""
    if len(index) and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


class Columns:
    """Columns of m rows, in the order of their coming."""

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._supports: list[IntArray] = []
        self._parts: list[list[FloatArray]] = []
        self._support: list[int] = []
        self._place: list[int] = []

    def __len__(self) -> int:
        return len(self._support)

    def add(self, columns: FloatArray, rows: IntArray | None = None) -> IntArray:
        """Add (m, k) columns and return their numbers.

        ``rows`` are those that they can touch: all, or those of turns and of whole channels.
        """
        rows = np.arange(self._rows) if rows is None else rows
        known = (k for k, own in enumerate(self._supports) if np.array_equal(own, rows))
        k = next(known, len(self._supports))
        if k == len(self._supports):
            self._supports.append(rows)
            self._parts.append([])
        first, number = len(self), columns.shape[1]
        place = sum(part.shape[1] for part in self._parts[k])
        self._parts[k].append(columns if len(rows) == self._rows else columns[rows])
        self._support += [k] * number
        self._place += range(place, place + number)
        return np.arange(first, first + number)

    def take(self, index: IntArray) -> FloatArray:
        """Return some of the columns, (m, k)."""
        out = np.zeros((len(index), self._rows)).T
        support, place = self._found(index)
        for k in np.unique(support):
            own = np.flatnonzero(support == k)
            out[np.ix_(self._supports[k], own)] = self._whole(k)[:, place[own]]
        return out

    def project(self, whitener: Whitener, y: FloatArray, used: IntArray) -> Seen:
        """Return some of the columns as the whitener, and the residual y, see them."""
        support, place = self._found(used)
        slot = np.empty(len(used), np.int64)
        inner = np.empty((len(used), whitener.basis.shape[1])).T
        match, total, power = np.empty((3, len(used)))
        white: dict[int, FloatArray] = {}
        for k in np.unique(support).tolist():
            rows = self._supports[k]
            here = whitener if len(rows) == self._rows else whitener.restricted(rows)
            whole = self._whole(k)
            mine = np.flatnonzero(support == k)
            slot[mine] = np.arange(len(mine))
            white[k] = np.empty((len(rows), len(mine)))
            for first in range(0, len(mine), PART):
                part = slice(first, first + PART)
                own = mine[part]
                found = here.whiten(whole[:, run(place[own])])
                inner[:, own] = here.basis.T @ found
                total[own] = np.einsum("ij,ij->j", found, found)
                power[own] = total[own] - np.square(inner[:, own]).sum(axis=0)
                lost = power[own] < LOST * total[own]
                found[:, lost], inner[:, own[lost]], power[own[lost]] = 0.0, 0.0, 0.0
                match[own] = y[rows] @ found
                white[k][:, part] = found
        return Seen(self._supports, white, support, slot, inner, match, power, total)

    def _found(self, index: IntArray) -> tuple[IntArray, IntArray]:
        """Return the support of each column, and its place among the columns there."""
        which = index.tolist()
        return (
            np.array([self._support[i] for i in which], np.int64),
            np.array([self._place[i] for i in which], np.int64),
        )

    def _whole(self, k: int) -> FloatArray:
        """Return all columns on one support."""
        parts = self._parts[k]
        if len(parts) > 1:
            # One part after the other, so that they are not in memory twice.
            number, at = sum(part.shape[1] for part in parts), 0
            whole = np.empty((len(self._supports[k]), number))
            while parts:
                part = parts.pop(0)
                whole[:, at : at + part.shape[1]] = part
                at += part.shape[1]
            parts.append(whole)
        return parts[0]


@dataclass(frozen=True, eq=False)
class Seen:
    """Whitened columns (u of them), with what is fitted projected out.

    Parameters
    ----------
    supports : list of arrays of int
        Rows that columns touch.
    white : mapping of int to (rows, columns) arrays
        Whitened columns on each support.
    support, slot : (u,) arrays of int
        Where each column is.
    inner : (p, u) array
        Its part along the basis of what is fitted.
    match : (u,) array
        Its product with the residual.
    power, total : (u,) arrays
        Its squared length, and what that had been with all that is fitted in it.
    """

    supports: list[IntArray]
    white: dict[int, FloatArray]
    support: IntArray
    slot: IntArray
    inner: FloatArray
    match: FloatArray
    power: FloatArray
    total: FloatArray

    def grams(self, own: IntArray) -> FloatArray:
        """Return the products of each of n sets of k columns, (n, k, k), from their (n, k) numbers.

        Many at once where the first of each touch the same rows, the second of each, and so on;
        unless there are fewer of these than products to be made.
        """
        n, k = own.shape
        pairs = list(combinations_with_replacement(range(k), 2))
        out = np.empty((n, k, k))
        patterns, which = np.unique(self.support[own], axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns.tolist()):
            mine = np.flatnonzero(which.ravel() == number)
            if len(mine) < len(pairs):
                out[mine] = [self.gram(each) for each in own[mine]]
                continue
            white = [self.white[s][:, self.slot[own[mine, i]]] for i, s in enumerate(pattern)]
            inner = [self.inner[:, own[mine, i]] for i in range(k)]
            for i, j in pairs:
                first, second = self._shared(pattern[i], pattern[j])
                both = np.einsum("rn,rn->n", white[i][first], white[j][second])
                both -= np.einsum("rn,rn->n", inner[i], inner[j])
                out[mine, i, j] = out[mine, j, i] = both
        return out

    def _shared(self, one: int, other: int) -> tuple[IntArray | slice, IntArray | slice]:
        """Return where the rows of two supports that both have are in each."""
        if one == other:
            return slice(None), slice(None)
        _, first, second = np.intersect1d(
            self.supports[one], self.supports[other], assume_unique=True, return_indices=True
        )
        return run(first), run(second)

    def gram(self, own: IntArray) -> FloatArray:
        """Return the products of some columns with each other: on the rows that both touch."""
        inner, support = self.inner[:, run(own)], self.support[own]
        kinds = np.unique(support).tolist()
        if len(kinds) == 1:
            white = self.white[kinds[0]][:, run(self.slot[own])]
            return np.asarray(white.T @ white - inner.T @ inner)
        out = -np.asarray(inner.T @ inner)
        parts: list[tuple[IntArray, int, FloatArray]] = []
        for k in kinds:
            mine = np.flatnonzero(support == k)
            white = self.white[k][:, run(self.slot[own[mine]])]
            out[np.ix_(mine, mine)] += white.T @ white
            for others, there, known in parts:
                first, second = self._shared(k, there)
                both = white[first].T @ known[second]
                out[np.ix_(mine, others)] += both
                out[np.ix_(others, mine)] += both.T
            parts.append((mine, k, white))
        return out
