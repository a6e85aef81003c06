"""A recording against its own digital twin: no reference but gravity, and rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.calibration import parameter_unit
from calib.effects import get_effect, shape_of
from calib.effects.base import PRESENCE, State, Term
from calib.mismatch.noise.handheld import held_by_hand, noise_of_held
from calib.mismatch.noise.leaning import leaning
from calib.mismatch.noise.rounded import Rounding
from calib.mismatch.noise.sensornoise import LEANING, sample_noise
from calib.mismatch.rows.grid import Grid
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.rows.unequal import how_it_leans
from calib.mismatch.twin.residuals import build_rows
from calib.mismatch.twin.twin import Twin
from calib.mismatch.twin.twinfit import FEW, PART, fit_twin, start_twin
from calib.model import SensorModel
from calib.types import BoolArray, FloatArray

LONG = 4.0
"""Times the median cell, above which no contrast within a cell is looked at. Its noise is taken as
white, times a factor that the cells share. But what drift adds to it does not fall with time: in a
cell of four times the length it is twice what that factor allows for, and in a night all there is.
The mean of such a cell stays, and with it what temperature and time do from cell to cell."""

LEAST = 1e-3
"""Of a count: how well the mean of a rest is known at best."""


class SelfProblem:
    """Rows of a recording against its twin under a model whose baseline is fitted to it."""

    reference = False
    moves_signals = False
    late = 0.0

    def __init__(
        self,
        grid: Grid,
        model: SensorModel | None,
        *,
        gravity: float,
        full_gyro: bool,
        spread: float | None = None,
    ) -> None:
        self.grid = grid
        self.full_gyro = full_gyro
        self.noise = sample_noise(grid)
        self.spread = spread
        self.leans = how_it_leans(grid, self.noise, least=LEANING)
        if grid.density is None:
            self.leans = self.leans._replace(held=None)
        if self.leans.held is not None and self.leans.size is not None and self.leans.held.any():
            if grid.lapped is not None:
                # How a hand has turned a sensor in a rest is told from one end of it to the other.
                grid = grid.lapped.plain
                self.noise = sample_noise(grid)
            held = held_by_hand(grid, self.leans.held, self.leans.size)
            self.grid = grid = replace(grid, held=held)
            self.noise = noise_of_held(grid, self.noise)
        start = start_twin(grid, model, gravity=gravity, full_gyro=full_gyro)
        self.twin: Twin = fit_twin(grid, start, self.noise)
        self.given = () if model is None else model.terms
        self.further: tuple[str, ...] = ()
        """Parameters of the given model's further terms that the last rows are fitted with."""
        self.drop: BoolArray | None = None
        self.jolted: FloatArray | None = None
        """By how much more than is expected samples miss of each segment, as a factor."""
        self.coarse: Mapping[int, Rounding] = {}
        """Channels whose counts are coarse: at rest they stick to one, so that the
        bias of a gyro that is seen there is not that of turns, and means are off in each pose."""
        self.leaning = 1.0
        """Share of the variance expected of a lean that is expected here (`leaning.lean_share`)."""
        self.restless = False
        """Whether the gyroscope is judged by its turns alone."""
        self._last: tuple[Twin, FloatArray, Rows] | None = None
        """The last twin, noise, and rows of these."""
        self._judged: tuple[tuple[object, ...], bool, Rows] | None = None
        """What the last rows were made of, whether `restless`, and these, before `leaning`."""

    def rounded(self, coarse: Mapping[int, Rounding], *, restless: bool) -> None:
        """Take channels as rounded to coarse counts, and a gyroscope as ``restless``.

        Where the signal moves on by a count and more from sample to sample, rounding is noise of a
        twelfth of a count² on top of that before. Counts that do not change at rest show none.
        """
        if self.grid.held is not None and any(c >= 3 for c in coarse):
            # Rates that stick to a count do not tell how a hand sways.
            self.grid, self.leans = replace(self.grid, held=None), self.leans._replace(held=None)
            self.noise = sample_noise(self.grid)
            self.twin = fit_twin(self.grid, self.twin, self.noise, drop=self.drop)
        self.coarse, self.restless = coarse, restless
        turns = self.grid.pose < 0
        self.noise = self.noise.copy()
        for c, rounding in coarse.items():
            least = np.full(len(turns), rounding.sigma**2)
            least[turns] += rounding.lsb**2 / 12
            self.noise[:, c] = np.maximum(self.noise[:, c], least / self.grid.count)

    def leave_out(self, segments: list[int]) -> None:
        """Leave segments out of the rows and of the twin's fit."""
        if segments:
            drop = np.zeros(len(self.grid.first), bool) if self.drop is None else self.drop
            drop[segments] = True
            self.drop = drop
            self.twin = fit_twin(self.grid, self.twin, self.noise, drop=drop)

    def rows(self) -> Rows:
        """Return recording minus twin; the given model's own terms are fitted along with it.

        The last rows are kept, and with them what was found of them.
        """
        made_of = self.twin, self.noise, self.drop, self.coarse, self.jolted
        last = self._judged
        if (
            last is None
            or last[1] != self.restless
            or any(a is not b for a, b in zip(made_of, last[0], strict=True))
        ):
            self._judged = last = made_of, self.restless, self._judging()
        return leaning(last[2], self.leaning)

    def _judging(self) -> Rows:
        """Return the rows where a lean is as it is expected to be."""
        rows = self._built()
        further = {
            f"{term.effect}.{name}": rows.column(signals)
            for term in self.given
            for name, signals in get_effect(term.effect).columns(rows.state, shape_of(term)).items()
        }
        self.further = tuple(further)
        known = list(further.values())
        known += [rows.functional[c] @ ~self._slow(rows.state, c) for c in self.coarse if c >= 3]
        if known:
            rows = replace(rows, nuisance=np.column_stack((rows.nuisance, *known)))
        if self.coarse:
            rows = replace(
                rows,
                residual=rows.residual - self._rounded_by(rows),
                white=rows.white + self._rounding(rows),
            )
        out = self._drifting(rows)
        if self.drop is not None:
            out |= self.drop[rows.segment]
        if self.restless:
            out |= rows.channel >= 3
        # At the edge of a count a drift seems several times as large, and elsewhere nothing.
        stuck = [c for c, rounding in self.coarse.items() if not rounding.hidden]
        out |= (rows.kind == Kind.CONTRAST) & np.isin(rows.channel, stuck)
        rows = rows if self.jolted is None else rows.jolted(self.jolted)
        rows = replace(rows, prior=self._prior(rows.nuisance.shape[1]))
        return rows.without(out) if out.any() else rows

    def _built(self) -> Rows:
        """Return the rows of the twin as it stands; a search begins where it was looked at."""
        last = self._last
        if last is None or last[0] is not self.twin or last[1] is not self.noise:
            rows = build_rows(
                self.grid, self.twin, self.noise, spread=self.spread, leans=self.leans
            )
            self._last = last = self.twin, self.noise, rows
        return last[2]

    def _prior(self, nuisances: int) -> FloatArray:
        """Return how far baseline and nuisances are from what is expected, and may be, (p + q, 2).

        Scale factors and angles are those of a part; the rest only the rows tell, and of few poses
        nothing else either.
        """
        if self.grid.n_poses < FEW:
            return np.zeros((0, 2))
        names = self.twin.names
        out = np.tile([0.0, np.inf], (len(names) + nuisances, 1))
        for k, (name, off) in enumerate(zip(names, self.twin.unexpected(), strict=True)):
            if ".bias." not in name:
                out[k] = off, PART
        return out

    def _slow(self, state: State, channel: int) -> BoolArray:
        """Return the points at which a gyroscope's axis turns by no more than rounds to nothing."""
        rate = state.rate[:, channel - 3]
        return np.asarray((self.grid.pose >= 0) | (np.abs(rate) <= 0.5 * self.coarse[channel].lsb))

    def _rounded_by(self, rows: Rows) -> FloatArray:
        """Return what rounding to coarse counts is expected to add to the rows, (m,).

        What a mean at rest errs by, a gyroscope also errs by while a turn begins and ends slowly.
        """
        rest = self.grid.is_rest
        segment = self.grid.segment
        middle = self.grid.interval.mean(axis=1)[segment]
        late = np.where(self.grid.time > middle, 1, -1)
        beside = np.clip(segment + np.where(rest[segment], 0, late), 0, len(rest) - 1)
        out = np.zeros(len(rows.residual))
        for c, rounding in self.coarse.items():
            error = np.zeros(len(rest))
            error[rest] = rounding.error
            stays = self._slow(rows.state, c) if c >= 3 else self.grid.pose >= 0
            out += rows.functional[c] @ (error[beside] * stays)
        return out

    def _rounding(self, rows: Rows) -> FloatArray:
        """Return the covariance of dense rows that rounding to coarse counts makes, (n, n).

        An accelerometer that sticks to a count in the slow parts of a turn is off in each axis by
        that all along, at most. A gyroscope is off there by what it is off at rest.
        """
        dense = slice(0, rows.n_dense)
        means = rows.kind[dense] == Kind.MEAN
        out = np.zeros((rows.n_dense, rows.n_dense))
        cell = np.cumsum(self.grid.is_rest) - 1
        for c, rounding in self.coarse.items():
            own = np.flatnonzero(means & (rows.channel[dense] == c))
            pose, place, residual = rows.block[own], cell[rows.segment[own]], rows.residual[own]
            high, low = np.full((2, self.grid.n_poses), -np.inf)
            np.maximum.at(high, pose, residual)
            np.maximum.at(low, pose, -residual)
            # A signal that moves over counts within a pose is anywhere between them.
            moves = (high + low)[pose] >= rounding.lsb / 4
            alike = np.equal.outer(pose, pose) & ~np.logical_or.outer(moves, moves)
            alone = np.sqrt(rounding.variance[place])
            out[np.ix_(own, own)] += rounding.covariance[np.ix_(place, place)]
            out[np.ix_(own, own)] += np.outer(alone, alone) * (alike | np.eye(len(own), dtype=bool))
            # What never leaves a count has no noise that is seen, but is not known to the last bit.
            out[own, own] += np.square(LEAST * rounding.lsb)
            if c >= 3:
                ends = rows.ends
                felt = (rows.functional[c] @ self._slow(rows.state, c))[ends]
                each = rounding.variance.mean() * felt[:, :, None] * felt[:, None]
                out[ends[:, :, None], ends[:, None]] += each
        turns = np.flatnonzero(rows.kind[dense] == Kind.VELOCITY)
        lasts = np.ptp(rows.interval, axis=1)[rows.segment[turns]]
        stuck = [r.lsb for c, r in self.coarse.items() if c < 3 and not r.hidden]
        out[turns, turns] += np.square(max(stuck, default=0.0) * lasts) / 12.0
        return out

    def _drifting(self, rows: Rows) -> BoolArray:
        """Return the contrasts within cells that are much longer than most, (m,) bool."""
        length = np.ptp(rows.interval, axis=1)
        long = rows.is_rest & (length > LONG * np.median(length[rows.is_rest]))
        return np.asarray(long[rows.segment] & (rows.kind == Kind.CONTRAST))

    def shown(self, sigma: FloatArray) -> dict[str, int]:
        """Return which coefficients of a fit are the given model's further terms, by name.

        Those that the recording shows, by the standard errors (p,) of all coefficients.
        """
        first = len(self.twin.names) + 2 * self.grid.n_poses
        return {
            name: first + k
            for k, name in enumerate(self.further)
            if sigma[first + k] > 0 and parameter_unit(name) != PRESENCE
        }

    def move(
        self, baseline: Mapping[str, float], nuisance: FloatArray, terms: tuple[Term, ...]
    ) -> None:
        """Move the twin."""
        twin = self.twin.moved(baseline, nuisance[: 2 * self.grid.n_poses].reshape(-1, 2))
        self.twin = replace(twin, model=replace(twin.model, terms=(*self.given, *terms)))

    def as_linearised(self, rows: Rows) -> Rows:
        """Return the rows where the twin stands now: each of its motions is linearised anew."""
        return self.rows()

    def place(self) -> object:
        """Return where the twin stands."""
        return self.twin

    def go_back(self, place: object) -> None:
        """Let the twin stand where it stood."""
        assert isinstance(place, Twin)
        self.twin = place
