"""Rows: what the diagnosis looks at, wherever the rows come from.

A row is a linear functional of the measured signals whose expectation the model predicts: a mean
at rest, the gravity direction after a turn, the velocity after a turn, or a windowed difference
from a reference. What a term adds to the signals, its ``column``, becomes a column of rows by the
same functional, so that every effect of the catalogue is judged in one place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from calib.effects import get_effect
from calib.effects.base import State
from calib.mismatch.rows.arrow import Arrow
from calib.mismatch.rows.closure import Ended, Spans, end_turns, turned_frames
from calib.mismatch.rows.lean import Lean
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray


class Kind(IntEnum):
    """What a row measures."""

    MEAN = 0  # mean of one channel over a cell of a rest, or over a window
    CONTRAST = 1  # change of one channel within a cell, orthogonal to MEAN
    ATTITUDE = 2  # gravity direction after a turn, rad
    VELOCITY = 3  # velocity after a turn, m/s


UNKNOWN = 2.5
"""Spread of the level of noise that nobody knows beforehand."""

SAMPLING = " by sampling"
"""How the names of components end of what samples do not resolve."""

_FOUND = ("arrow", "confined", "kept", "together", "turns")
"""What rows find out once, and not from their residual."""


@dataclass(frozen=True, eq=False)
class Component:
    """One unknown variance: ``level * matrix`` adds to the covariance of the dense rows.

    It acts on the k dense rows ``index``, through their ``response`` (k, s) to what happens in each
    of s segments, of which ``kernel`` (s, s) is the covariance: ``matrix`` is ``response @ kernel @
    response.T``. ``expected`` is the level that the prior is centred on, ``spread`` the standard
    deviation of its logarithm. Components of one ``group`` have similar levels.
    """

    name: str
    index: IntArray
    response: Any
    kernel: FloatArray
    expected: float
    spread: float = UNKNOWN
    group: str = ""

    @classmethod
    def alone(
        cls, name: str, index: IntArray, variance: FloatArray, *, expected: float, spread: float
    ) -> Component:
        """Return a component of errors that each row has by itself, their `variance` (k,)."""
        own = sparse.identity(len(index), format="csr")
        return cls(name, index, own, np.diag(variance), expected, spread)

    @property
    def matrix(self) -> FloatArray:
        """The covariance of the rows for a level of one, (k, k)."""
        return np.asarray(self.response @ (self.response @ self.kernel).T)

    @cached_property
    def variance(self) -> FloatArray:
        """Its diagonal."""
        felt = self.response.multiply(self.response @ self.kernel)
        return np.asarray(felt.sum(axis=1)).ravel()

    def without(self, keep: BoolArray) -> Component:
        """Return this for the dense rows in `keep`, (n_dense,) bool."""
        own = keep[self.index]
        place = np.cumsum(keep) - 1
        return replace(self, index=place[self.index[own]], response=self.response[own])


@dataclass(frozen=True, eq=False)
class ClosedTurns:
    """The turns between rests whose closures are rows.

    Parameters
    ----------
    index : (k, 5) array of int
        Rows of each turn: two of its attitude, three of its velocity.
    spans : Spans
    force, rate, frame : (n, 3), (n, 3), (n, 3, 3) arrays
        On the points of all turns; frames as `closure.turned_frames` has them.
    up_before, up_after : (k, 3) arrays
        Unit vectors up at the rests on either side.
    ended : Ended
        Where the turns end.
    """

    index: IntArray
    spans: Spans
    force: FloatArray
    rate: FloatArray
    frame: FloatArray
    up_before: FloatArray
    up_after: FloatArray
    ended: Ended


@dataclass(frozen=True, eq=False)
class Rows:
    """Residual rows with everything that judges them.

    The first ``n_dense`` rows have the covariance ``white + sum(level * component)``; the rest
    (contrasts within a rest) are independent, with variance ``white_diagonal``.

    Parameters
    ----------
    residual : (m,) array
        Measured minus modelled.
    baseline : (m, p) array
        Derivatives with respect to the baseline's parameters ``names``.
    nuisance : (m, q) array
        Derivatives with respect to what must be fitted but is not reported (attitudes).
    functional : six sparse (m, n) matrices
        One for each channel: the row is the sum over channels of ``functional[c] @ signal[c]``.
    state : State
        The true state on the n points.
    white : (n_dense, n_dense) array
    white_diagonal : (m - n_dense,) array
    components : tuple of Component
    kind, channel, segment : (m,) arrays of int
        ``channel`` is 0 to 5, or -1 for rows that combine channels; ``segment`` numbers the rest
        or turn that the row was measured in.
    block : (m,) array of int
        What is held out together.
    interval : (s, 2) array, s
        Of each segment.
    is_rest : (s,) array of bool
    aligned : tuple of str
        Parameters (``effect.name``) that `nuisance` fits: an alignment in time, a rotation.
    restless : (m,) array of bool
        Rows of segments where the truth itself errs with the motion; empty if it does nowhere.
    prior : (p + q, 2) array
        How far baseline and nuisances are from where they are expected, and how far they may be:
        infinitely, if only the rows tell. Empty where nothing else tells of any.
    plain : (m, p + q) array
        `baseline` and `nuisance` where no setup is felt (no lever arm); empty where none is.
    offset : (6,) array
        What each channel reads at zero input.
    lean : Lean, optional
        How the sensor may move at rest; None where the truth says how it moves.
    matrices : (2, 3, 3) array
        What the sensor's triads make of the state: nothing, or beside a truth ``I + S + M``.
    clustered : bool
        Whether what the rows of one segment err by may go together, as a truth's own noise does.
    unresolved : bool
        Whether a good part of what turns err by is what their samples do not resolve.
    aliased : bool
        Whether hands may tremble faster than samples resolve: what a single turn errs by then
        looks like anything.
    """

    residual: FloatArray
    baseline: FloatArray
    names: tuple[str, ...]
    nuisance: FloatArray
    functional: tuple[Any, ...]
    state: State
    point_segment: IntArray
    white: FloatArray
    white_diagonal: FloatArray
    components: tuple[Component, ...]
    kind: IntArray
    channel: IntArray
    segment: IntArray
    block: IntArray
    interval: FloatArray
    is_rest: BoolArray
    aligned: tuple[str, ...] = ()
    restless: BoolArray = field(default_factory=lambda: np.zeros(0, bool))
    prior: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    plain: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    offset: FloatArray = field(default_factory=lambda: np.zeros(len(CHANNELS)))
    lean: Lean | None = None
    matrices: FloatArray = field(default_factory=lambda: np.stack((np.eye(3), np.eye(3))))
    clustered: bool = False
    unresolved: bool = False
    aliased: bool = False

    @property
    def foreknown(self) -> FloatArray:
        """How far the first of what is fitted may be, (k,), where that tells beside the rows.

        It does for a recording by itself. Beside a truth the motion either shows a parameter, or
        not at all.
        """
        return np.zeros(0) if self.aligned else self.prior[: self.baseline.shape[1], 1]

    @property
    def n_dense(self) -> int:
        """How many rows have a dense covariance."""
        return len(self.white)

    @cached_property
    def arrow(self) -> Arrow:
        """The covariance of the dense rows, made for factoring."""
        channel = self.channel[: self.n_dense]
        return Arrow.of(
            self.white, np.where(channel < 0, -1, self.together[channel]), self.components
        )

    @cached_property
    def together(self) -> IntArray:
        """Of each channel, the first one that white noise leads to from it, (6,)."""
        own = 1.0 * (self.channel[: self.n_dense, None] == np.arange(len(CHANNELS)))
        direct = (own.T @ np.abs(self.white) @ own > 0) | np.eye(len(CHANNELS), dtype=bool)
        within = np.linalg.matrix_power(direct.astype(float), len(CHANNELS)) > 0
        return np.asarray(within.argmax(axis=1))

    def touched(self, channels: Sequence[int]) -> IntArray:
        """Return the rows on which columns of some channels may be once they are whitened.

        Those of turns and of the channels, and means of what errs together with these.
        """
        dense = self.channel[: self.n_dense]
        out = np.isin(self.channel, [-1, *channels])
        out[: self.n_dense] |= (dense >= 0) & np.isin(
            self.together[dense], self.together[list(channels)]
        )
        return np.flatnonzero(out)

    @cached_property
    def confined(self) -> bool:
        """Whether each row feels points of its own segment alone."""
        return all(
            np.array_equal(
                self.point_segment[f.indices], np.repeat(self.segment, np.diff(f.indptr))
            )
            for f in self.functional
        )

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What others have found of these rows, by name, to have it again."""
        return {}

    @property
    def ends(self) -> IntArray:
        """The rows of each turn, (k, 5): two of its attitude, three of its velocity."""
        return np.flatnonzero(self.kind >= Kind.ATTITUDE).reshape(-1, 5)

    @cached_property
    def turns(self) -> ClosedTurns:
        """The turns whose closures are among the rows."""
        index = self.ends
        start = np.searchsorted(self.point_segment, self.segment[index[:, 0]])
        stop = np.searchsorted(self.point_segment, self.segment[index[:, 0]], side="right")
        first = np.append(0, np.cumsum(stop - start))
        points = np.arange(first[-1]) + np.repeat(start - first[:-1], stop - start)
        state = self.state
        force, rate = state.force[points], state.rate[points]
        # At rest the state is exact: gravity in the poses on either side.
        up_before, up_after = (state.force[k] / state.gravity for k in (start - 1, stop))
        spans = Spans(state.time[points], first)
        frame = turned_frames(spans, rate)
        ended = end_turns(spans, force, frame)
        return ClosedTurns(index, spans, force, rate, frame, up_before, up_after, ended)

    def expected_variance(self) -> FloatArray:
        """Return the variance of each dense row, every component at the level expected of it."""
        return self.variance(np.array([c.expected for c in self.components]))

    def variance(self, levels: FloatArray) -> FloatArray:
        """Return the variance of each dense row at some levels."""
        out = np.diag(self.white).copy()
        for level, c in zip(levels, self.components, strict=True):
            out[c.index] += level * c.variance
        return out

    def missed(self, levels: FloatArray) -> FloatArray:
        """Return the part of the variance of each dense row that samples do not resolve."""
        out = np.zeros(self.n_dense)
        for level, c in zip(levels, self.components, strict=True):
            if c.name.endswith(SAMPLING):
                out[c.index] += level * c.variance
        return out

    def segment_at(self, moment: float) -> int:
        """Return the segment that a moment lies in, or behind; the first of one before it."""
        return max(int(np.searchsorted(self.interval[:, 0], moment, side="right")) - 1, 0)

    def column(self, signals: Mapping[str, FloatArray]) -> FloatArray:
        """Return the (m,) row column of what a term adds to the signals, by channel."""
        out = np.zeros(len(self.residual))
        for name, values in signals.items():
            out += self.functional[CHANNELS.index(name)] @ values
        return out

    def columns(self, channel: int, values: FloatArray) -> FloatArray:
        """Return the (m, k) row columns of (n, k) values on one channel."""
        out: FloatArray = self.functional[channel] @ values
        return out

    def with_residual(self, residual: FloatArray) -> Rows:
        """Return the rows with another residual: what was found of all else holds for these too."""
        out = replace(self, residual=residual)
        vars(out).update({name: vars(self)[name] for name in _FOUND if name in vars(self)})
        return out

    def without(self, drop: BoolArray) -> Rows:
        """Return the rows that are not marked in `drop`, (m,) bool."""
        keep = ~np.asarray(drop, bool)
        dense, rest = keep[: self.n_dense], keep[self.n_dense :]
        return replace(
            self,
            residual=self.residual[keep],
            baseline=self.baseline[keep],
            nuisance=self.nuisance[keep],
            functional=tuple(f[keep] for f in self.functional),
            white=self.white[np.ix_(dense, dense)],
            white_diagonal=self.white_diagonal[rest],
            components=tuple(c.without(dense) for c in self.components),
            kind=self.kind[keep],
            channel=self.channel[keep],
            segment=self.segment[keep],
            block=self.block[keep],
            restless=self.restless[keep] if self.restless.size else self.restless,
            plain=self.plain[keep] if self.plain.size else self.plain,
        )

    def jolted(self, factors: FloatArray) -> Rows:
        """Return the rows, `unresolved`, with a factor on what samples miss of each segment, (s,).

        It multiplies the variance.
        """
        size = np.sqrt(factors)
        own = (
            replace(c, response=sparse.diags(size[self.segment[c.index]]) @ c.response)
            if c.name.endswith(SAMPLING)
            else c
            for c in self.components
        )
        return replace(self, components=tuple(own), unresolved=True)

    def judging(self, slug: str) -> Rows:
        """Return the rows as they are without an effect, to judge what it is worth.

        Where a lever arm is all that an axis feels, a scale factor error is the same as a longer
        arm; but no scale factor of what is not felt is the arm. Nor does it carry another sensor's.
        """
        if not self.plain.size or get_effect(slug).kind != "setup":
            return self
        p = self.baseline.shape[1]
        return replace(self, baseline=self.plain[:, :p], nuisance=self.plain[:, p:])
