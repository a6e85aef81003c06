"""Evidence for what was left out: closed-form Bayes factors that are e-values.

A hypothesis adds columns ``Z`` (whitened, with all that is fitted projected out, in units of their
typical size) with coefficients drawn from ``N(0, s²)``, s running over `SCALES`. Against the
residual y alone its Bayes factor is

    log B(s) = -1/2 log det(I + s² Z'Z) + 1/2 y'Z (I/s² + Z'Z)^-1 Z'y.

Averaged over scales, places and shapes with weights that sum to one it has expectation at most one
where nothing was left out, so that P(B > 100) < 1 %: the price of all looks is in the weights.

Of an effect most of the weight is on sizes that would show, and not by far. Smaller ones explain
nothing, and larger ones need no weight; both would cost those between them what they hold. Which
these are, columns and noise say, so that the expectation is the same. What is counted (samples that
are lost) comes whole.

References
----------
.. [1] Vovk, Wang, "E-values: calibration, combination and applications", Ann. Statist. 49, 2021.
.. [2] Liang et al., "Mixtures of g priors for Bayesian variable selection", JASA 103, 2008.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
from scipy.linalg import lapack
from scipy.special import log_ndtr

from calib.mismatch.hypotheses.candidates import Alike, Bank, Candidate, Sums
from calib.mismatch.hypotheses.columns import LOST, Columns, Seen
from calib.mismatch.noise.noise import Whitener
from calib.types import BoolArray, FloatArray, IntArray

PRESENT = 0.6
"""How far from 1 the coefficient of what is there or not may be: neighbouring cut-off frequencies
on the grid differ by a factor of 2, and what a low-pass takes away goes with their inverse or its
square."""

LARGE = 30.0
"""Size relative to the typical one beyond which a number is hardly physical."""

SCALES = np.append(np.geomspace(0.01, 3.0, 8), [10.0, LARGE, 100.0, 300.0])
"""Sizes that are tried, relative to the typical one; the last for what is far beyond typical. A
part may be broken, and what is typical is known to a power of ten: the shape must speak then."""

SHARES = np.append(np.full(8, 0.1175), [0.02, 0.02, 0.01, 0.01])
"""How probable each of them is."""

_LOG_SHARES = np.log(SHARES)

SHOWN = (2.0, 2000.0)
"""Mean powers, in units of the noise, between which a scale is one that would show, not by far."""

FAINT = 0.1
"""How much of its share any other scale of an effect keeps."""

NOTHING = 1e-290
"""Square of a length that rounding leaves of none, and that has no inverse."""

FEW = 4
"""Candidates of the same columns up to which each takes its own Gram matrix, all at once."""

ALL_AT_ONCE = 8
"""Columns of candidates up to which these are reduced side by side; of more, one by one."""


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
        self, whitener: Whitener, y: FloatArray, *, which: BoolArray | None = None
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
        """
        which = np.ones(len(self), bool) if which is None else which
        out = np.full(len(which), -np.inf)
        at, makes = 0, list[tuple[int, Alike | Sums]]()
        for bank in self.banks:
            makes += [(at, make) for make in bank.made(which[at : at + len(bank)])]
            at += len(bank)
        used = np.unique(np.concatenate([make.columns for _, make in makes]))
        place = np.zeros(len(self.columns), np.int64)
        place[used] = np.arange(len(used))
        seen = self.columns.project(whitener, y, used)
        grams: dict[bytes, FloatArray] = {}
        # By the number of coefficients, many at once: a few cost as much in calls as in numbers.
        plain: dict[int, list[tuple[IntArray, IntArray, BoolArray]]] = {}
        joint: dict[int, list[tuple[IntArray, FloatArray, FloatArray]]] = {}
        sought = self.sought
        for at, make in makes:
            own, columns = at + make.which, place[make.columns]
            if isinstance(make, Alike) and make.mixing is None:
                index = columns[make.index]
                plain.setdefault(index.shape[1], []).append((own, index, make.present))
                continue
            if (key := columns.tobytes()) not in grams:
                grams[key] = seen.gram(columns)
            if isinstance(make, Sums):
                out[own] = _sums(make, grams[key], seen, columns)
                continue
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
        return out


def _alone(seen: Seen, column: IntArray, present: BoolArray, sought: BoolArray) -> FloatArray:
    """Return log B of candidates of one column each."""
    power, match = seen.power[column], seen.match[column]
    return np.where(present, present_factors(power, match), _single(power, match, sought))


def _sums(make: Sums, gram: FloatArray, seen: Seen, columns: IntArray) -> FloatArray:
    """Return log B of candidates that are sums of columns."""
    inner = make.pick @ gram
    power = np.asarray(make.pick.multiply(inner).sum(axis=1)).ravel()
    lost = power < LOST * (make.pick.power(2) @ seen.total[columns])
    along = make.pick @ seen.match[columns]
    none = np.zeros(len(power), bool)
    return _single(np.where(lost, 0.0, power), np.where(lost, 0.0, along), none)


def _mixed(make: Alike, gram: FloatArray, match: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Gram matrices and matches of candidates that mix columns, from those of these."""
    assert make.mixing is not None
    mixing, index = make.mixing, make.index
    n, k, r = mixing.shape
    inner, along = np.empty((n, r, r)), match[index][:, None] @ mixing
    for first, last, runs in make.parts:
        own, mine = index[first:last], mixing[first:last]
        if FEW * len(runs) > last - first:
            both = gram[own[:, :, None], own[:, None]] @ mine
        else:
            # Those with the same columns at once: a product with each would be one with a few.
            both = np.empty(mine.shape)
            for start, stop in runs:
                flat = mixing[start:stop].transpose(1, 0, 2).reshape(k, -1)
                found = gram[index[start][:, None], index[start]] @ flat
                part = slice(start - first, stop - first)
                both[part] = found.reshape(k, stop - start, r).transpose(1, 0, 2)
        inner[first:last] = mine.transpose(0, 2, 1) @ both
    return inner, along[:, 0]


def _single(power: FloatArray, along: FloatArray, sought: BoolArray) -> FloatArray:
    """Return log B of single columns, from their power and their match with the residual."""
    strength = np.square(SCALES)[:, None] * power
    gain = 0.5 * np.square(along) / np.maximum(power, 1e-300) * strength / (1 + strength)
    return _average(gain - 0.5 * np.log1p(strength) + log_shares(power, sought))


def log_shares(power: FloatArray, sought: BoolArray) -> FloatArray:
    """Return the logarithms of the shares that n hypotheses give to the `SCALES`, (scales, n).

    Parameters
    ----------
    power : (n,) array
        Of their columns, whitened and projected, in the mean over the coefficients.
    sought : (n,) array of bool
        Those that are looked for at sizes that would show.
    """
    strength = np.square(SCALES)[:, None] * power
    shows = (strength > SHOWN[0]) & (strength < SHOWN[1])
    shares = SHARES[:, None] * np.where(shows | ~sought, 1.0, FAINT)
    return np.asarray(np.log(shares / shares.sum(axis=0)))


def log_bayes_factor(columns: FloatArray, y: FloatArray) -> float:
    """Return log B of one rival, its whitened projected columns given."""
    gram, match = columns.T @ columns, y @ columns
    return float(log_bayes_factors(gram[None], match[None], np.zeros(1, bool))[0])


def present_factors(power: FloatArray, along: FloatArray) -> FloatArray:
    """Return log B of single columns with a positive coefficient from ``N(1, PRESENT²)``."""
    strength = PRESENT**2 * power
    more = along - power
    gain: FloatArray = along - 0.5 * power + 0.5 * PRESENT**2 * np.square(more) / (1 + strength)
    mean = 1.0 + PRESENT**2 * more / (1 + strength)
    positive = log_ndtr(mean * np.sqrt(1 + strength) / PRESENT) - log_ndtr(1.0 / PRESENT)
    return np.where(power > 0, gain - 0.5 * np.log1p(strength) + positive, 0.0)


def log_bayes_factors(gram: FloatArray, match: FloatArray, sought: BoolArray) -> FloatArray:
    """Return log B of n hypotheses with Gram matrices (n, k, k) and matches (n, k).

    In a basis that begins with the match and has a tridiagonal Gram matrix T, only the corner of
    the inverse of ``I + s² T`` counts, which elimination from the other end gives with the
    determinant, for all scales at once.
    """
    diagonal, beside = _tridiagonal(gram, match)
    square = np.square(SCALES)[:, None]
    # What is left of a pivot is never below one: the rest is rounding.
    pivot = np.maximum(1.0 + square * diagonal[-1], 1.0)
    log_det = np.log(pivot)
    for d, b in zip(diagonal[-2::-1], beside[:0:-1], strict=True):
        pivot = np.maximum(1.0 + square * (d - square * (np.square(b) / pivot)), 1.0)
        log_det += np.log(pivot)
    gain = square * (np.square(beside[0]) / pivot)
    power = np.einsum("nkk->n", gram) / gram.shape[1]
    return _average(0.5 * (gain - log_det) + log_shares(power, sought))


def _tridiagonal(gram: FloatArray, match: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return n Gram matrices as tridiagonal ones: their diagonals and what is beside, (k, n) each.

    The first of what is beside is the length of the match, which lies along the first direction:
    Householder's reduction of a matrix that has the match as its first row leaves that row alone.
    """
    n, k = match.shape
    left = np.zeros((n, k + 1, k + 1))
    left[:, 0, 1:] = left[:, 1:, 0] = match
    left[:, 1:, 1:] = gram
    diagonal, beside = np.empty((k + 1, n)), np.empty((k, n))
    if k > ALL_AT_ONCE:
        for i, one in enumerate(left):
            _, diagonal[:, i], beside[:, i], _, _ = lapack.dsytrd(one.T, lower=1, overwrite_a=1)
        return diagonal[1:], beside
    for j in range(k):
        diagonal[j], first, left = left[:, 0, 0], left[:, 1:, 0], left[:, 1:, 1:]
        beside[j] = size = np.sqrt(np.einsum("ni,ni->n", first, first))
        if j < k - 1:
            mirror = first.copy()
            mirror[:, 0] += np.copysign(size, first[:, 0])
            square = np.einsum("ni,ni->n", mirror, mirror)
            mirror *= np.sqrt(2.0 / np.where(square > NOTHING, square, 1.0))[:, None]
            along = np.einsum("nij,nj->ni", left, mirror)
            along -= 0.5 * np.einsum("ni,ni->n", along, mirror)[:, None] * mirror
            change = mirror[:, :, None] * along[:, None, :]
            left -= change + np.swapaxes(change, 1, 2)
    diagonal[k] = left[:, 0, 0]
    return diagonal[1:], beside


def average_of_scales(log_factors: FloatArray) -> FloatArray:
    """Return log B over all `SCALES`, from its values (n, ...) at each."""
    shares = _LOG_SHARES.reshape(-1, *[1] * (log_factors.ndim - 1))
    return _average(log_factors + shares)


def _average(log_factors: FloatArray) -> FloatArray:
    """Return the logarithm of the sum over the first axis of factors that hold their shares."""
    top = log_factors.max(axis=0)
    mean: FloatArray = top + np.log(np.exp(log_factors - top).sum(axis=0))
    return mean
