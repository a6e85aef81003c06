"""Candidates and the columns that they share: all of them are scored at once."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, combinations_with_replacement

import numpy as np

from calib.mismatch.hypotheses.candidates import Alike, Bank, Candidate, Courses, Make, Sums
from calib.mismatch.hypotheses.columns import LOST, Columns, Seen
from calib.mismatch.hypotheses.factors import (
    log_bayes_factors,
    most_told,
    present_factors,
    single_factors,
)
from calib.mismatch.hypotheses.shared import with_shared
from calib.mismatch.noise.noise import Whitener
from calib.types import BoolArray, FloatArray, IntArray

FEW = 10
"""Candidates of the same columns up to which each takes its own Gram matrix, all at once."""


class Stack:
    """Candidates, and the columns that they share, so that whitening them is one product."""

    def __init__(self, rows: int) -> None:
        self.columns = Columns(rows)
        self._banks: list[Bank] = []
        self._added: list[Candidate] = []
        self._rest = Bank(())

    def add(self, *candidates: Candidate) -> None:
        """Add candidates one by one."""
        self._added += candidates

    def extend(self, bank: Bank) -> None:
        """Add candidates that were sorted before; those that are added one by one come later."""
        if self._added:
            raise ValueError("`bank` must be added before single candidates")
        self._banks.append(bank)

    @property
    def banks(self) -> list[Bank]:
        """All candidates, in their order."""
        if len(self._rest) != len(self._added):
            self._rest = Bank(self._added)
        return [*self._banks, self._rest]

    def __len__(self) -> int:
        return sum(map(len, self._banks)) + len(self._added)

    def __getitem__(self, i: int) -> Candidate:
        for bank in self._banks:
            if i < len(bank):
                return bank[i]
            i -= len(bank)
        return self._added[i]

    def __iter__(self) -> Iterator[Candidate]:
        return chain(*self._banks, self._added)

    def index(self, candidate: Candidate) -> int:
        """Return the number of one of the candidates."""
        at = 0
        for bank in self.banks:
            if (i := bank.find(candidate)) is not None:
                return at + i
            at += len(bank)
        raise ValueError("`candidate` is none of these")

    @property
    def physics(self) -> dict[int, Candidate]:
        """Those that are physics, by their numbers."""
        at, out = 0, dict[int, Candidate]()
        for bank in self.banks:
            out.update((at + i, bank[i]) for i in np.flatnonzero(bank.physical).tolist())
            at += len(bank)
        return out

    @property
    def physical(self) -> BoolArray:
        """Which candidates are physics."""
        return np.concatenate([bank.physical for bank in self.banks])

    @property
    def sought(self) -> BoolArray:
        """Which are sought at sizes that would show: physics, but for what is counted."""
        return np.concatenate([bank.sought for bank in self.banks])

    @property
    def shared(self) -> BoolArray:
        """Which have a course in time on each axis of a triad, which may be one that they share."""
        return np.concatenate([bank.shared for bank in self.banks])

    @property
    def weight(self) -> FloatArray:
        """Logarithm of the prior probability of each candidate."""
        return np.concatenate([bank.weight for bank in self.banks])

    def groups(self) -> tuple[list[str], IntArray]:
        """Return the names of the groups, and which of them each candidate belongs to."""
        known: dict[str, int] = {}
        code = []
        for bank in self.banks:
            number = np.array([known.setdefault(g, len(known)) for g in bank.groups], np.int64)
            code.append(number[bank.group])
        return list(known), np.concatenate(code)

    def of_channels(self, channels: tuple[str, ...], *, physical: bool) -> BoolArray:
        """Return which candidates are those of some channels, and physics or not."""
        own = []
        for bank in self.banks:
            number = bank.channels.index(channels) if channels in bank.channels else -1
            own.append((bank.channel == number) & (bank.physical == physical))
        return np.concatenate(own)

    def of(self, candidate: Candidate) -> FloatArray:
        """Return the (m, k) columns of one candidate."""
        own = self.columns.take(candidate.index)
        if candidate.mixing is not None:
            return np.asarray(own @ candidate.mixing)
        return own.sum(axis=1, keepdims=True) if candidate.summed else own

    def log_bayes_factors(
        self,
        whitener: Whitener,
        y: FloatArray,
        *,
        which: BoolArray | None = None,
        least: float = -np.inf,
    ) -> FloatArray:
        """Return log B of every candidate, averaged over `SCALES`.

        Parameters
        ----------
        whitener : Whitener
            With all that is fitted projected out. A column that keeps less than 1e-8 of its power
            there cannot be told from what is fitted, and counts as nothing.
        y : (m,) array
            Whitened projected residual.
        which : array of bool, optional
            The candidates to score; the others get -inf.
        least : float, optional
            Log B that counts: those that combine columns with which none can reach it get -inf.
        """
        which = np.ones(len(self), bool) if which is None else which
        out = np.full(len(which), -np.inf)
        at, makes = 0, list[tuple[int, Make]]()
        for bank in self.banks:
            makes += [(at, make) for make in bank.made(which[at : at + len(bank)])]
            at += len(bank)
        used = np.unique(np.concatenate([make.columns for _, make in makes]))
        place = np.zeros(len(self.columns), np.int64)
        place[used] = np.arange(len(used))
        seen = self.columns.project(whitener, y, used)
        grams, vain = dict[bytes, FloatArray](), set[bytes]()
        # By the number of coefficients, many at once: a few cost as much in calls as in numbers.
        plain: dict[int, list[tuple[IntArray, IntArray, BoolArray]]] = {}
        joint: dict[int, list[tuple[IntArray, FloatArray, FloatArray]]] = {}
        sought, shared = self.sought, self.shared
        for at, make in makes:
            own, columns = at + make.which, place[make.columns]
            if isinstance(make, Alike) and make.mixing is None:
                index = columns[make.index]
                plain.setdefault(index.shape[1], []).append((own, index, make.present))
                continue
            if (key := columns.tobytes()) not in grams:
                grams[key] = seen.gram(columns)
                if least > 0 and most_told(grams[key], seen.match[columns]) < least:
                    vain.add(key)
            if key in vain:
                continue
            if isinstance(make, Sums):
                out[own] = _sums(make, grams[key], seen, columns)
                continue
            if isinstance(make, Courses):
                inner, along = _on_axes(make, grams[key], seen.match[columns])
            else:
                inner, along = _mixed(make, grams[key], seen.match[columns])
            joint.setdefault(along.shape[1], []).append((own, inner, along))
        for k, alike in plain.items():
            own, index, present = map(np.concatenate, zip(*alike, strict=True))
            if k == 1:
                out[own] = _alone(seen, index[:, 0], present, sought[own])
            else:
                joint.setdefault(k, []).append((own, seen.grams(index), seen.match[index]))
        for mixed in joint.values():
            own, inner, along = map(np.concatenate, zip(*mixed, strict=True))
            out[own] = log_bayes_factors(inner, along, sought[own])
            if (mine := shared[own]).any():
                out[own[mine]] = with_shared(out[own[mine]], inner[mine], along[mine])
        return out


def _alone(seen: Seen, column: IntArray, present: BoolArray, sought: BoolArray) -> FloatArray:
    """Return log B of candidates of one column each."""
    power, match = seen.power[column], seen.match[column]
    return np.where(present, present_factors(power, match), single_factors(power, match, sought))


def _sums(make: Sums, gram: FloatArray, seen: Seen, columns: IntArray) -> FloatArray:
    """Return log B of candidates that are sums of columns."""
    inner = make.pick @ gram
    power = np.einsum("nu,nu->n", make.pick.toarray(), inner)
    lost = power < LOST * (make.pick.power(2) @ seen.total[columns])
    along = make.pick @ seen.match[columns]
    none = np.zeros(len(power), bool)
    return single_factors(np.where(lost, 0.0, power), np.where(lost, 0.0, along), none)


def _mixed(make: Alike, gram: FloatArray, match: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Gram matrices and matches of candidates that mix columns, from those of these."""
    assert make.mixing is not None
    mixing, index = make.mixing, make.index
    n, k, r = mixing.shape
    inner, along = np.empty((n, r, r)), match[index][:, None] @ mixing
    for first, last, runs in make.parts:
        own, mine = index[first:last], mixing[first:last]
        if FEW * len(runs) > last - first:
            both = _within(gram, own) @ mine
        else:
            # Those with the same columns at once: a product with each would be one with a few.
            both = np.empty(mine.shape)
            for start, stop in runs:
                flat = mixing[start:stop].transpose(1, 0, 2).reshape(k, -1)
                found = _within(gram, index[start]) @ flat
                part = slice(start - first, stop - first)
                both[part] = found.reshape(k, stop - start, r).transpose(1, 0, 2)
        inner[first:last] = mine.transpose(0, 2, 1) @ both
    return inner, along[:, 0]


def _on_axes(make: Courses, gram: FloatArray, match: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what `_mixed` does, of candidates that have one course on several axes."""
    (n, u), axes = make.pick.shape, make.axes
    inner, parts = np.empty((n, axes, axes)), gram.reshape(axes, u, axes, u)
    for i, j in combinations_with_replacement(range(axes), 2):
        both = np.einsum("nu,nu->n", make.pick @ parts[i, :, j], make.pick)
        inner[:, i, j] = inner[:, j, i] = both
    return inner, make.pick @ match.reshape(axes, u).T


def _within(gram: FloatArray, index: IntArray) -> FloatArray:
    """Return the (..., k, k) parts of a Gram matrix that are those of (..., k) columns."""
    # By numbers in the flat matrix: by two of each element it takes three times as long.
    return gram.take(index[..., :, None] * len(gram) + index[..., None, :])
