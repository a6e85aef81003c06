"""Hypotheses one by one, and many of them as arrays, which are scored at once."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np
from scipy import sparse

from calib.types import BoolArray, FloatArray, IntArray

T = TypeVar("T", bound=Hashable)

GAIN = "gain in a window"
"""What multiplies a signal has columns of its own: all else in windows is the same on each part."""

GAIN_IN_TIME = "gain in time"
"""The same for a gain that changes for good, or is another one in each segment."""

GAINS = (GAIN, GAIN_IN_TIME)

MOVING = "bias that moves to another level"
"""What goes from one level to another in a while, and stays there."""

DELAY = "delay in a window"
"""What follows the slope of a signal: a bus or a filter that holds a channel up for a while."""

OWN_COLUMNS = {**dict.fromkeys(GAINS, GAIN), DELAY: DELAY}
"""Whose columns rivals have that do not have those of a part as it is."""

FLUCTUATING = "fluctuation in a window"
"""What jumps about, or swings; on three axes each may do so by itself, or have its share of one."""

SHARE = ("x", "y", "z")
"""What a shape has of each axis of a triad where these share one disturbance."""

MANY = 256
"""Candidates that are mixed at a time: what they make of columns stays near the processor."""


@dataclass(frozen=True, eq=False, slots=True)
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
    counted : bool
        Whether its coefficients are whole numbers.
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
    counted: bool = False

    @property
    def is_single(self) -> bool:
        """Whether it has one coefficient."""
        return self.mixing is None and (self.summed or len(self.index) == 1)

    @property
    def may_be_shared(self) -> bool:
        """Whether it has courses in time on three axes, which may be one that they share.

        Of what has its shares already there is one.
        """
        several = len(self.channels) > 1 and SHARE[0] not in self.shape
        return self.name == FLUCTUATING and several

    @property
    def group(self) -> str:
        """Candidates of one group are one answer: an effect, or a rival of one channel or triad."""
        where = self.channels[0] if len(self.channels) == 1 else self.channels[0].split(".")[0]
        return self.name if self.physical else f"{self.name} {where}"


@dataclass(frozen=True, eq=False)
class Alike:
    """Candidates ``which`` of one make, scored at once.

    Parameters
    ----------
    which : (n,) array of int
        Their numbers.
    columns : (u,) array of int
        All columns of the stack that they use.
    index : (n, k) array of int
        The columns of each, as numbers within `columns`.
    mixing : (n, k, r) array, or None
        As `Candidate.mixing`; None where each column has a coefficient.
    present : (n,) array of bool
    """

    which: IntArray
    columns: IntArray
    index: IntArray
    mixing: FloatArray | None
    present: BoolArray

    @cached_property
    def parts(self) -> list[tuple[int, int, list[tuple[int, int]]]]:
        """At most `MANY` of them at a time, and those of these that have the same columns."""
        fresh = np.append(True, (self.index[1:] != self.index[:-1]).any(axis=1))
        out = []
        for first in range(0, len(fresh), MANY):
            last = min(first + MANY, len(fresh))
            begins = first + np.flatnonzero(fresh[first:last])
            ends = np.unique([first, *begins.tolist(), last]).tolist()
            out.append((first, last, list(pairwise(ends))))
        return out

    def chosen(self, own: BoolArray) -> Alike:
        """Return those that are marked in `own`, (n,) bool."""
        if own.all():
            return self
        mixing = None if self.mixing is None else self.mixing[own]
        columns, index = np.unique(self.index[own], return_inverse=True)
        index = index.reshape(-1, self.index.shape[1])
        return Alike(self.which[own], self.columns[columns], index, mixing, self.present[own])


@dataclass(frozen=True, eq=False)
class Sums:
    """Candidates ``which`` of one column: sums of columns, weighed by ``pick``, sparse (n, u)."""

    which: IntArray
    columns: IntArray
    pick: sparse.csr_matrix

    def chosen(self, own: BoolArray) -> Sums:
        """Return those that are marked in `own`, (n,) bool."""
        if own.all():
            return self
        pick = self.pick[own]
        used = pick.getnnz(axis=0) > 0
        return Sums(self.which[own], self.columns[used], pick[:, used])


@dataclass(frozen=True, eq=False)
class Courses:
    """Candidates ``which`` of one course in time, of which each axis has a size of its own.

    Parameters
    ----------
    which : (n,) array of int
    columns : (axes u,) array of int
        Those of one axis after those of the other.
    axes : int
    pick : (n, u) array
        What counts how much on any of them.
    """

    which: IntArray
    columns: IntArray
    axes: int
    pick: FloatArray

    def chosen(self, own: BoolArray) -> Courses:
        """Return those that are marked in `own`, (n,) bool."""
        if own.all():
            return self
        pick = self.pick[own]
        used = pick.any(axis=0)
        columns = self.columns.reshape(self.axes, -1)[:, used].ravel()
        return Courses(self.which[own], columns, self.axes, pick[:, used])


Make = Alike | Sums | Courses


class Bank:
    """Candidates, one by one and as arrays.

    Parameters
    ----------
    candidates : sequence of Candidate
    """

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self._candidates = tuple(candidates)
        self._by, self._moved = 0, dict[int, Candidate]()
        self.weight = np.log(np.array([c.weight for c in candidates]))
        self.physical = np.array([c.physical for c in candidates], bool)
        self.sought = self.physical & ~np.array([c.counted for c in candidates], bool)
        self.shared = np.array([c.may_be_shared for c in candidates], bool)
        self.groups, self.group = _numbered(c.group for c in candidates)
        self.channels, self.channel = _numbered(c.channels for c in candidates)
        self._makes = list(_makes(self._candidates, self.group, self.channel))

    def moved(self, channels: tuple[str, ...], by: int) -> Bank:
        """Return the same on other channels, whose columns come `by` later.

        Only of candidates that all have the same channels. They are made when one is asked for.
        """
        out = copy(self)
        out._by, out._moved, out.channels = self._by + by, {}, [channels]
        _, first = np.unique(self.group, return_index=True)
        out.groups = [out[i].group for i in first.tolist()]
        out._makes = [replace(make, columns=make.columns + by) for make in self._makes]
        return out

    def __len__(self) -> int:
        return len(self._candidates)

    def __getitem__(self, i: int) -> Candidate:
        own = self._candidates[i]
        if not self._by:
            return own
        if i not in self._moved:
            self._moved[i] = replace(own, channels=self.channels[0], index=own.index + self._by)
        return self._moved[i]

    def __iter__(self) -> Iterator[Candidate]:
        return (self[i] for i in range(len(self)))

    def find(self, candidate: Candidate) -> int | None:
        """Return the number of a candidate that came from here."""
        known = self._moved.items() if self._by else enumerate(self._candidates)
        return next((i for i, c in known if c is candidate), None)

    def made(self, own: BoolArray) -> Iterator[Make]:
        """Yield the candidates that are marked in `own`, those of one make side by side."""
        for make in self._makes if own.any() else ():
            marked = own[make.which]
            if marked.any():
                yield make.chosen(marked)


def _numbered(values: Iterable[T]) -> tuple[list[T], IntArray]:
    """Return distinct values in the order of their coming, and the number of each one's value."""
    known: dict[T, int] = {}
    code = [known.setdefault(v, len(known)) for v in values]
    return list(known), np.array(code, np.int64)


def _makes(candidates: Sequence[Candidate], group: IntArray, channel: IntArray) -> Iterator[Make]:
    alike: dict[tuple[int, ...], list[int]] = {}
    joint: dict[tuple[int, str], dict[tuple[int, ...], list[int]]] = {}
    for i, c in enumerate(candidates):
        if c.summed or c.mixing is not None:
            same = joint.setdefault((int(channel[i]), OWN_COLUMNS.get(c.name, "")), {})
            single = (mixing := c.mixing) is None or mixing.shape[1] == 1
            size = () if mixing is None or single else (int(group[i]), *mixing.shape)
            same.setdefault(size, []).append(i)
        else:
            alike.setdefault((len(c.index),), []).append(i)
    for which in alike.values():
        own = [candidates[i] for i in which]
        columns, index = np.unique(np.stack([c.index for c in own]), return_inverse=True)
        present = np.array([c.present for c in own])
        yield Alike(np.array(which), columns, index.reshape(len(own), -1), None, present)
    for shapes in joint.values():
        # Those of the same channels share their columns, and the Gram matrix of these.
        every = [candidates[i].index for which in shapes.values() for i in which]
        columns = np.unique(np.concatenate(every))
        courses: list[Courses] = []
        for size, which in shapes.items():
            marked = [candidates[i].index for i in which]
            if not size:
                place = np.searchsorted(columns, np.concatenate(marked))
                begins = np.append(0, np.cumsum([len(index) for index in marked]))
                weights = np.concatenate([_weights(candidates[i]) for i in which])
                pick = sparse.csr_matrix((weights, place, begins), shape=(len(which), len(columns)))
                yield Sums(np.array(which), columns, pick)
                continue
            index = np.searchsorted(columns, np.stack(marked))
            mixing = np.stack([m for i in which if (m := candidates[i].mixing) is not None])
            axes = len(candidates[which[0]].channels)
            pick = _course(columns, axes, index, mixing) if axes > 1 else None
            if pick is not None:
                courses.append(Courses(np.array(which), columns, axes, pick))
                continue
            none = np.zeros(len(which), bool)
            yield Alike(np.array(which), columns, index, narrowed(mixing), none)
        if courses:
            whole = np.concatenate([same.pick for same in courses])
            numbers = np.concatenate([same.which for same in courses])
            yield replace(courses[0], which=numbers, pick=whole)


def _course(columns: IntArray, axes: int, index: IntArray, mixing: FloatArray) -> FloatArray | None:
    """Return what `Courses` pick, of mixings (n, k, r); None if they are no single courses."""
    n, k, r = mixing.shape
    if r != axes or k % axes or len(columns) % axes:
        return None
    apart = mixing.reshape(n, axes, -1, axes)
    course, first = apart[:, 0, :, 0], index[:, : k // axes]
    if not (apart == np.eye(axes)[:, None] * course[:, None, :, None]).all():
        return None
    later = len(columns) // axes * np.arange(axes)
    if not (index.reshape(n, axes, -1) == first[:, None] + later[:, None]).all():
        return None
    pick = np.zeros((n, len(columns) // axes))
    np.put_along_axis(pick, first, course, axis=1)
    return pick


def _weights(candidate: Candidate) -> FloatArray:
    """Return what counts how much in the one column of a candidate, (k,)."""
    mixing = candidate.mixing
    return np.ones(len(candidate.index)) if mixing is None else mixing[:, 0]


def narrowed(mixing: FloatArray) -> FloatArray:
    """Return (n, k, min(k, r)) combinations that are as probable as the (n, k, r) of `mixing`.

    Of more combinations than there are columns, with coefficients that are all alike, only the
    covariance ``M M'`` counts, of which the triangle of ``M' = Q R`` is a root: ``M M' = R' R``.
    """
    if mixing.shape[2] <= mixing.shape[1]:
        return mixing
    return np.swapaxes(np.linalg.qr(np.swapaxes(mixing, 1, 2), mode="r"), 1, 2)
