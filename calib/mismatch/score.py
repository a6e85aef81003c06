"""Evidence for what was left out: closed-form Bayes factors that are e-values.

A hypothesis adds columns ``Z`` (whitened, with all that is fitted projected out, in units of their
typical size) with coefficients drawn from ``N(0, s²)``, s running over `SCALES`. Against the
residual y alone its Bayes factor is

    log B(s) = -1/2 log det(I + s² Z'Z) + 1/2 y'Z (I/s² + Z'Z)^-1 Z'y.

Averaged over scales, places and shapes with weights that sum to one it has expectation at most one
where nothing was left out, so that P(B > 100) < 1 %: the price of all looks is in the weights.

References
----------
.. [1] Vovk, Wang, "E-values: calibration, combination and applications", Ann. Statist. 49, 2021.
.. [2] Liang et al., "Mixtures of g priors for Bayesian variable selection", JASA 103, 2008.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse
from scipy.special import log_ndtr

from calib.mismatch.noise import Whitener
from calib.types import FloatArray, IntArray

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

_LOST = 1e-8

PART = 256
"""Columns that are worked on at a time: whitening and summing need copies."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One hypothesis, as columns of a `Stack`, and its prior weight.

    Parameters
    ----------
    name : str
        An effect's slug; for a rival that is no physics, what the residual follows.
    index : array of int
        Which columns of the stack.
    summed : bool
        Whether those columns make one (a window) or have a coefficient each.
    mixing : (len(index), k) array, optional
        The k columns of the hypothesis as combinations of those of the stack.
    weight : float
        Prior probability; all candidates together sum to at most one.
    physical : bool
        False for rivals.
    parameters : tuple of str
        Names of the coefficients; empty for rivals.
    shape : mapping
        Shape parameters (time constants, moments).
    channels : tuple of str
    interval : (start, stop) or None, s
        Of a window.
    present : bool
        Whether its one coefficient is 1 by nature, and only its shape is unknown.
    """

    name: str
    index: IntArray
    weight: float
    physical: bool
    channels: tuple[str, ...]
    summed: bool = False
    parameters: tuple[str, ...] = ()
    shape: Mapping[str, float] = field(default_factory=dict)
    interval: tuple[float, float] | None = None
    mixing: FloatArray | None = None
    present: bool = False

    @property
    def is_single(self) -> bool:
        """Whether it has one coefficient."""
        return self.mixing is None and (self.summed or len(self.index) == 1)

    @property
    def group(self) -> str:
        """Candidates of one group are one answer: an effect, or a rival of one channel or triad."""
        where = self.channels[0] if len(self.channels) == 1 else self.channels[0].split(".")[0]
        return self.name if self.physical else f"{self.name} {where}"


class Stack:
    """Columns that candidates share, so that whitening them is one product."""

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._parts: list[FloatArray] = []
        self._count = 0
        self.candidates: list[Candidate] = []
        self._groups: tuple[list[str], IntArray] = ([], np.zeros(0, np.int64))

    def groups(self) -> tuple[list[str], IntArray]:
        """Return the names of the groups, and which of them each candidate belongs to."""
        if len(self._groups[1]) != len(self.candidates):
            known: dict[str, int] = {}
            code = [known.setdefault(c.group, len(known)) for c in self.candidates]
            self._groups = list(known), np.array(code)
        return self._groups

    def add(self, columns: FloatArray) -> IntArray:
        """Add (m, k) columns and return their indices."""
        self._parts.append(columns)
        first = self._count
        self._count += columns.shape[1]
        return np.arange(first, self._count)

    @property
    def columns(self) -> FloatArray:
        """All columns, (m, k)."""
        if not self._parts:
            return np.zeros((self._rows, 0))
        if len(self._parts) > 1:
            # One part after the other, so that they are not in memory twice.
            whole, at = np.empty((self._count, self._rows)).T, 0
            while self._parts:
                part = self._parts.pop(0)
                whole[:, at : at + part.shape[1]] = part
                at += part.shape[1]
            self._parts = [whole]
        return self._parts[0]

    def of(self, candidate: Candidate) -> FloatArray:
        """Return the (m, k) columns of one candidate."""
        own = self.columns[:, candidate.index]
        if candidate.mixing is not None:
            return np.asarray(own @ candidate.mixing)
        return own.sum(axis=1, keepdims=True) if candidate.summed else own

    def log_bayes_factors(
        self, whitener: Whitener, y: FloatArray, *, which: list[int] | None = None
    ) -> FloatArray:
        """Return log B of every candidate, averaged over `SCALES`.

        Parameters
        ----------
        whitener : Whitener
            With all that is fitted projected out. A column that keeps less than 1e-8 of its power
            there cannot be told from what is fitted, and counts as nothing.
        y : (m,) array
            Whitened projected residual.
        which : list of int, optional
            The candidates to score; the others get -inf.
        """
        which = list(range(len(self.candidates))) if which is None else which
        used = np.unique(np.concatenate([self.candidates[i].index for i in which]))
        place = np.zeros(self._count, np.int64)
        place[used] = np.arange(len(used))
        projected, total = np.empty((len(used), self._rows)).T, np.empty(len(used))
        for first in range(0, len(used), PART):
            part = slice(first, first + PART)
            white = whitener.whiten(self.columns[:, used[part]])
            total[part] = np.einsum("ij,ij->j", white, white)
            white -= whitener.basis @ (whitener.basis.T @ white)
            white[:, np.einsum("ij,ij->j", white, white) < _LOST * total[part]] = 0.0
            projected[:, part] = white
        match = y @ projected
        out = np.full(len(self.candidates), -np.inf)
        single = [i for i in which if self.candidates[i].is_single]
        if single:
            index = [place[self.candidates[i].index] for i in single]
            power, along = _singles(index, projected, match, total)
            strength = np.square(SCALES)[:, None] * power
            gain = 0.5 * np.square(along) / np.maximum(power, 1e-300) * strength / (1 + strength)
            out[single] = _average(gain - 0.5 * np.log1p(strength) + _LOG_SHARES[:, None])
            there = [k for k, i in enumerate(single) if self.candidates[i].present]
            out[[single[k] for k in there]] = _present(power[there], along[there])
        mixed: dict[tuple[str, ...], list[int]] = {}
        several: dict[int, list[int]] = {}
        for i in which:
            c = self.candidates[i]
            if c.mixing is not None:
                mixed.setdefault(c.channels, []).append(i)
            elif not c.is_single:
                several.setdefault(len(c.index), []).append(i)
        for items in several.values():
            index = [place[self.candidates[i].index] for i in items]
            grams = np.stack([projected[:, own].T @ projected[:, own] for own in index])
            out[items] = log_bayes_factors(grams, match[np.stack(index)])
        for items in mixed.values():
            # Those of one channel mix the same columns, and share their Gram matrix.
            out[items] = _mixed([self.candidates[i] for i in items], place, projected, match)
        return out

    def average(self, whitener: Whitener, y: FloatArray) -> float:
        """Return log B of all candidates as one, each as probable as any other."""
        return float(_average(self.log_bayes_factors(whitener, y))) - float(
            np.log(len(self.candidates))
        )


def _mixed(
    candidates: list[Candidate], place: IntArray, projected: FloatArray, match: FloatArray
) -> FloatArray:
    """Return log B of candidates that mix columns, those with alike mixings all at once."""
    used = np.unique(np.concatenate([place[c.index] for c in candidates]))
    gram = projected[:, used].T @ projected[:, used]
    match = match[used]
    alike: dict[tuple[int, ...], list[int]] = {}
    for i, c in enumerate(candidates):
        assert c.mixing is not None
        alike.setdefault(c.mixing.shape, []).append(i)
    out = np.empty(len(candidates))
    for items in alike.values():
        mixing = np.stack([np.asarray(candidates[i].mixing) for i in items])
        own = np.searchsorted(used, np.stack([place[candidates[i].index] for i in items]))
        if (own == own[0]).all():
            # All at once: a product with each alone would be one with a few columns.
            n, k, r = mixing.shape
            flat = np.swapaxes(mixing, 0, 1).reshape(k, n * r)
            inner = np.swapaxes((gram[np.ix_(own[0], own[0])] @ flat).reshape(k, n, r), 0, 1)
        else:
            inner = gram[own[:, :, None], own[:, None, :]] @ mixing
        out[items] = log_bayes_factors(
            np.swapaxes(mixing, 1, 2) @ inner, np.einsum("nk,nkr->nr", match[own], mixing)
        )
    return out


def _singles(
    index: list[IntArray], projected: FloatArray, match: FloatArray, total: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the power of each single (or summed) column, and its match with the residual."""
    column = np.repeat(np.arange(len(index)), [len(k) for k in index])
    pick = sparse.csc_matrix(
        (np.ones(len(column)), (np.concatenate(index), column)),
        shape=(projected.shape[1], len(index)),
    )
    power = np.empty(len(index))
    for first in range(0, len(index), PART):
        part = slice(first, first + PART)
        power[part] = np.square(pick[:, part].T @ projected.T).sum(axis=1)
    lost = power < _LOST * (pick.T @ total)
    power[lost] = 0.0
    return power, np.where(lost, 0.0, pick.T @ match)


def log_bayes_factor(columns: FloatArray, y: FloatArray) -> float:
    """Return log B of one hypothesis, its whitened projected columns given."""
    return float(log_bayes_factors((columns.T @ columns)[None], (y @ columns)[None])[0])


def _present(power: FloatArray, along: FloatArray) -> FloatArray:
    """Return log B of single columns with a positive coefficient from ``N(1, PRESENT²)``."""
    strength = PRESENT**2 * power
    more = along - power
    gain: FloatArray = along - 0.5 * power + 0.5 * PRESENT**2 * np.square(more) / (1 + strength)
    mean = 1.0 + PRESENT**2 * more / (1 + strength)
    positive = log_ndtr(mean * np.sqrt(1 + strength) / PRESENT) - log_ndtr(1.0 / PRESENT)
    return np.where(power > 0, gain - 0.5 * np.log1p(strength) + positive, 0.0)


def log_bayes_factors(gram: FloatArray, match: FloatArray) -> FloatArray:
    """Return log B of n hypotheses with Gram matrices (n, k, k) and matches (n, k)."""
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    along = np.square(np.einsum("nij,ni->nj", vectors, match))
    square = np.square(SCALES)[:, None, None]
    strength = square * values
    gain = 0.5 * (along * square / (1 + strength)).sum(axis=2)
    return _average(gain - 0.5 * np.log1p(strength).sum(axis=2) + _LOG_SHARES[:, None])


def _average(log_factors: FloatArray) -> FloatArray:
    """Return the logarithm of the sum over the first axis of factors that hold their shares."""
    top = log_factors.max(axis=0)
    mean: FloatArray = top + np.log(np.exp(log_factors - top).sum(axis=0))
    return mean
