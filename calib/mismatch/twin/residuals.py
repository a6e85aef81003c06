"""Recording minus twin as rows, linearised at the twin; with the covariance that judges them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.special import chdtri

from calib.effects import get_effect
from calib.effects.base import State, TransformEffect
from calib.mismatch.noise.handheld import moved_by_hand
from calib.mismatch.noise.sampling import sampling_components
from calib.mismatch.noise.sensornoise import (
    DRIFT,
    SPREAD,
    DriftKernels,
    drift_components,
    lean_components,
    lean_of_turns,
)
from calib.mismatch.rows.closure import (
    Closures,
    across,
    close_turns,
    covariance_of_turns,
)
from calib.mismatch.rows.grid import Grid
from calib.mismatch.rows.held import HeldTurns
from calib.mismatch.rows.lean import Lean
from calib.mismatch.rows.rows import SAMPLING, UNKNOWN, Component, Kind, Rows
from calib.mismatch.rows.unequal import Leans
from calib.mismatch.twin.layout import Layout
from calib.mismatch.twin.twin import Twin, baseline_column, true_state
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

TREMBLING = 1 / 30
"""s between samples from which on a swing of a hand's tremor (8 to 12 Hz) has not 2.5 of them; nor
do they resolve how a bench rings. What that does to a turn then looks like anything else: it is by
sampling that turns do not close.

References
----------
.. [1] Elble, Koller, "Tremor", Baltimore 1990: physiologic tremor of the hand, 8 to 12 Hz.
"""

ROUNDED = 1e-9
"""Share of the variance of a closure below which one more direction of it is rounding."""

MEDIAN_OF_FIVE = float(chdtri(5.0, 0.5))
"""Of chi-squared with as many degrees of freedom as a turn has closures."""

MEANS = 1 / 3
"""Mean square of the share, from 0 to 1, of a sample interval over which samples are means."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Recording minus twin, and its derivatives, as `Rows` have them; without what noise does.

    ``names`` are the baseline's parameters, ``closed`` the closures of the turns, and ``turning``
    what measured signals at their points of either triad count in them, (5, n, 3). What ``held``
    turns feel of the rests beside them is taken out.
    """

    names: tuple[str, ...]
    residual: FloatArray
    nuisance: FloatArray
    functional: tuple[sparse.csr_matrix, ...]
    state: State
    layout: Layout
    closed: Closures
    turning: tuple[FloatArray, FloatArray]
    held: HeldTurns | None

    @cached_property
    def baseline(self) -> FloatArray:
        """Derivatives with respect to the baseline's parameters, (m, p)."""
        return _baseline(self.names, self.state, self.functional)


def linearise(grid: Grid, twin: Twin, *, headed: bool = False) -> Linear:
    """Return recording minus twin, linearised at the twin; its state with headings if so wanted.

    But turns are linearised where the rests beside them have the gyro's bias. In a day it walks by
    a tenth of a degree a second, and what an attitude that is off by ``d`` does to the velocity,
    ``g d²/2`` a second, is no longer linear in it.
    """
    state = true_state(grid, twin, headed=headed)
    measured = np.hstack((grid.accel, grid.gyro))
    # Terms and transforms that the model already holds are taken out of the measured signals.
    explained = _explained(grid, twin, state)
    model = twin.model
    predicted = np.hstack((model.accel.distort(state.force), model.gyro.distort(state.rate)))
    inverse = [np.asarray(np.linalg.inv(t.matrix)) for t in (model.accel, model.gyro)]
    layout = Layout.of(grid)
    rows, ends, cell = layout.rows, layout.ends, layout.cell
    residual = np.zeros(layout.number)
    nuisance = np.zeros((layout.number, 2 * grid.n_poses))
    left = (measured - explained - predicted)[layout.still]
    for row, weight in zip(rows, layout.weights, strict=True):
        for c in range(6):
            residual[row[:, c]] = np.bincount(cell, weight * left[:, c], len(row))
    tilt = twin.gravity * np.einsum("ij,kjl->kil", model.accel.matrix, across(twin.up))
    pose = grid.before[layout.rest]
    for j in (0, 1):
        nuisance[rows[0, :, :3], 2 * pose[:, None] + j] = tilt[pose, :, j]
    points, spans = grid.turns
    cell_of, turns = np.cumsum(grid.is_rest) - 1, layout.turns
    bias = residual[rows[0, :, 3:]]
    drift = (0.5 * (bias[cell_of[turns - 1]] + bias[cell_of[turns + 1]]))[spans.turn]
    rate = state.rate.copy()
    rate[points] -= drift @ inverse[1].T
    state = replace(state, rate=rate)
    before, after = grid.before[turns], grid.after[turns]
    closed = close_turns(
        spans,
        state.force[points],
        state.rate[points],
        twin.up[before],
        twin.up[after],
        gravity=twin.gravity,
    )
    turning = (closed.accel_weights @ inverse[0], closed.gyro_weights @ inverse[1])
    undone = np.add.reduceat(np.einsum("rni,ni->rn", turning[1], drift), spans.start, axis=1)
    residual[ends] = closed.residual + undone.T
    held = None
    if grid.held is not None:
        held = HeldTurns.of(grid, closed, twin.up, inverse[1], state.rate[points])
        residual[ends] -= held.turned
    for j in (0, 1):
        nuisance[ends, 2 * before[:, None] + j] += closed.before[:, :, j]
        nuisance[ends, 2 * after[:, None] + j] += closed.after[:, :, j]
    functional = tuple(
        layout.functional(c, turning[c // 3][:, :, c % 3], len(grid.time))
        for c in range(len(CHANNELS))
    )
    return Linear(twin.names, residual, nuisance, functional, state, layout, closed, turning, held)


def _baseline(
    names: tuple[str, ...], state: State, functional: tuple[sparse.csr_matrix, ...]
) -> FloatArray:
    """Return the derivatives of rows with respect to the baseline's parameters, (m, p)."""
    out = np.zeros((functional[0].shape[0], len(names)))
    for j, name in enumerate(names):
        for key, values in baseline_column(name, state).items():
            out[:, j] += functional[CHANNELS.index(key)] @ values
    return out


def build_rows(
    grid: Grid,
    twin: Twin,
    noise: FloatArray,
    *,
    spread: float | None = None,
    leans: Leans | None = None,
) -> Rows:
    """Return recording minus twin as rows, linearised at the twin.

    Parameters
    ----------
    grid, twin : Grid, Twin
    noise : (n, 6) array
        Variance of each point's mean on each channel, white part.
    spread : float, optional
        How uncertain the size of drift is beforehand, in place of `SPREAD`.
    leans : Leans, optional
        How poses lean unlike each other.
    """
    linear = linearise(grid, twin, headed=True)
    closed, layout = linear.closed, linear.layout
    points, spans = grid.turns
    by_force, by_rate = linear.turning
    of_turns = covariance_of_turns(by_force, noise[points][:, :3], spans)
    of_turns += covariance_of_turns(by_rate, noise[points][:, 3:], spans)
    if linear.held is not None and len(points):
        of_turns += linear.held.covariance(np.median(noise[points, 3:], axis=0))
    state = closing(grid, twin, linear, noise, of_turns)
    dense = int((layout.kind != Kind.CONTRAST).sum())
    signals = linear.state.force[points], linear.state.rate[points]
    each = np.zeros(layout.number)
    for c, f in enumerate(linear.functional):
        each += f.power(2) @ noise[:, c]
    white, diagonal = np.diag(each[:dense]), each[dense:]
    white[layout.ends[:, :, None], layout.ends[:, None]] = of_turns
    pieces = tuple(_in_segments(f, layout.segment, grid) for f in linear.functional)
    if linear.held is not None:
        felt = linear.held.responses(layout.ends, layout.number)
        none = [sparse.csr_matrix(felt[0].shape)] * 3
        both = zip(pieces, (*none, *felt), strict=True)
        pieces = tuple(sparse.hstack(pair, format="csr") for pair in both)
    components = _components(
        grid,
        pieces,
        layout.kind[:dense],
        layout.segment[:dense],
        white,
        noise,
        closed,
        SPREAD if spread is None else spread,
    )
    place, leans = grid.before[layout.rest], leans or Leans()
    lean = Lean.of(twin.up, grid.interval[layout.rest], place, twin.gravity, *leans)
    components += tuple(
        lean_components(lean, layout.rows[0], layout.rest, [p[:dense] for p in pieces])
    )
    if grid.held is not None:
        components += (moved_by_hand(grid, layout.rows[0, :, :3]),)
    if len(layout.turns):
        beside = np.stack((grid.before[layout.turns], grid.after[layout.turns]))
        parts = closed.before, closed.after
        components += (lean_of_turns(lean, layout.ends, beside, parts),)
    components += tuple(sampling_components(closed, *signals, noise[points], spans, layout.ends))
    blur = mean_over_interval(grid, linear.state)
    spilt = sum(f[:dense] @ blur[:, c] for c, f in enumerate(linear.functional))
    white += MEANS * np.outer(spilt, spilt)
    between = between_samples(grid)
    for own in (slice(0, 3), slice(3, 6)):
        channels = list(enumerate(linear.functional))[own]
        missed = sum(f[:dense] @ between[:, c] for c, f in channels)
        white += np.outer(missed, missed)
    return Rows(
        residual=linear.residual,
        baseline=_baseline(twin.names, state, linear.functional),
        names=twin.names,
        nuisance=linear.nuisance,
        functional=linear.functional,
        state=state,
        point_segment=grid.segment,
        white=white,
        white_diagonal=diagonal,
        components=components,
        kind=layout.kind,
        channel=layout.channel,
        segment=layout.segment,
        block=grid.before[layout.segment],
        interval=grid.interval,
        is_rest=grid.is_rest,
        offset=np.concatenate((twin.model.accel.bias, twin.model.gyro.bias)),
        lean=lean,
        aliased=is_aliased(grid),
    )


def closing(
    grid: Grid, twin: Twin, linear: Linear, noise: FloatArray, covariance: FloatArray
) -> State:
    """Return the state with turns that close: without what noise most likely is in its signals.

    Of the noise ``n`` in the signals of a turn its closures ``r = W n`` show five sums. Given these
    it is ``N W' (W N W')^-1 r``, N being its covariance. Columns that follow a signal would follow
    the very noise that is in the residual otherwise, and explain that, where there is hardly more:
    about an axis that a robot keeps still.

    Parameters
    ----------
    grid, twin, linear : Grid, Twin, Linear
    noise : (n, 6) array
        Variance of each point on each channel.
    covariance : (k, 5, 5) array
        What that makes of the closures of each turn.
    """
    points, spans = grid.turns
    if not len(points):
        return linear.state
    size = np.sqrt(np.einsum("kii->ki", covariance))
    scale = np.where(size > 0, size, 1.0)
    alike = covariance / (scale[:, :, None] * scale[:, None]) + ROUNDED * np.eye(size.shape[1])
    left = linear.residual[linear.layout.ends] / scale
    found = np.linalg.solve(alike, left[:, :, None])[:, :, 0]
    # As much more as they are off for other reasons, so much less of it is noise.
    found /= max(float(np.median((left * found).sum(axis=1))) / MEDIAN_OF_FIVE, 1.0)
    found = (found / scale)[spans.turn]
    state, model = linear.state, twin.model
    out = []
    for c, (values, triad) in enumerate(((state.force, model.accel), (state.rate, model.gyro))):
        likely = np.einsum("rni,nr->ni", linear.turning[c], found)
        likely *= noise[points][:, 3 * c : 3 * c + 3]
        closed = values.copy()
        closed[points] -= likely @ np.linalg.inv(triad.matrix).T
        out.append(closed)
    return replace(state, force=out[0], rate=out[1])


def is_aliased(grid: Grid) -> bool:
    """Whether hands may tremble faster than the samples of a grid resolve."""
    return _interval(grid) > TREMBLING


def _interval(grid: Grid) -> float:
    """Return the typical time between samples, s."""
    inside = np.diff(grid.segment) == 0
    return float(np.median(np.diff(grid.time)[inside] / grid.count[1:][inside]))


def _in_segments(functional: sparse.csr_matrix, segment: IntArray, grid: Grid) -> sparse.csr_matrix:
    """Return what each row feels of a constant in its segment: it feels nothing of others.

    Beside these, of each turn, of what is one in its second half and minus one in the first.
    """
    felt = np.diff(functional.indptr) > 0
    begins, whole = np.append(0, np.cumsum(felt)), len(grid.first)
    own = segment[felt]
    shape = (len(segment), whole)
    total = (functional @ np.ones(functional.shape[1]))[felt]
    constant = sparse.csr_matrix((total, own, begins), shape=shape)
    late = np.where(grid.time < grid.interval.mean(axis=1)[grid.segment], -1.0, 1.0)
    late[grid.pose >= 0] = 0.0
    changing = sparse.csr_matrix(((functional @ late)[felt], own, begins), shape=shape)
    turns = changing[:, ~grid.is_rest]
    turns.eliminate_zeros()
    return sparse.hstack((constant, turns), format="csr")


def mean_over_interval(grid: Grid, state: State) -> FloatArray:
    """Return what a mean over the sample interval adds to the signals in turns, (n, 6).

    Many parts put out such means: to second order ``x + dt²/24 d²x/dt²``, the same on all channels.
    """
    out = np.zeros((len(grid.time), 6))
    turns = np.flatnonzero(grid.pose < 0)
    if len(turns) > 1:
        step = float(np.median(np.diff(grid.time[turns])))
        curved = state.derivative(np.hstack((state.force_dot, state.rate_dot)))
        out[turns] = step**2 / 24 * curved[turns]
    return out


def between_samples(grid: Grid) -> FloatArray:
    """Return what a cubic through four samples misses of the mean between the inner two, (n, 6).

    To the first order ``11/720`` of the fourth difference, the same on all channels of a triad: a
    signal that is faster than its samples resolve looks like one that was filtered.
    """
    values = np.hstack((grid.accel, grid.gyro))
    out = np.zeros_like(values)
    place = np.flatnonzero(grid.pose < 0)
    place = place[(place > 1) & (place < len(values) - 2)]
    weights = (1.0, -4.0, 6.0, -4.0, 1.0)
    out[place] = sum(w * values[place + k] for k, w in zip(range(-2, 3), weights, strict=True))
    return out * (11 / 720)


def _explained(grid: Grid, twin: Twin, state: State) -> FloatArray:
    """Return what the model's further terms add to the signals at rest, (n, 6).

    A delay or a filter changes nothing there. The grid thins rests, so that what spills into them
    from a turn would not be to scale.
    """
    model = twin.model
    added = tuple(t for t in model.terms if not isinstance(get_effect(t.effect), TransformEffect))
    if not added:
        return np.zeros((len(grid.time), 6))
    full, bare = (replace(model, terms=terms).distort(state) for terms in (added, ()))
    return np.hstack((full.accel - bare.accel, full.gyro - bare.gyro))


def _components(
    grid: Grid,
    pieces: tuple[sparse.csr_matrix, ...],
    kind: IntArray,
    segment: IntArray,
    white: FloatArray,
    noise: FloatArray,
    closed: Closures,
    spread: float,
) -> tuple[Component, ...]:
    """Return the unknown variances: of each channel's drift, and the closures' own."""
    dense = len(kind)
    rest = grid.pose >= 0
    step = _interval(grid)
    # One-sided density squared: variance of a mean, times its length, times two.
    density = np.median(2 * noise[rest] * grid.count[rest, None] * step, axis=0)
    kernels = DriftKernels.of(grid.interval, np.flatnonzero(~grid.is_rest))
    if grid.held is not None and grid.density is not None:
        density = grid.density
        kernels = kernels.beside(int(grid.is_rest.sum()))
    cause = SAMPLING if step > TREMBLING else ""
    out = []
    for c, name in enumerate(CHANNELS):
        drift = DRIFT[name.split(".")[0]] ** 2 * density[c]
        out += drift_components(name, pieces[c][:dense], kernels, drift, spread)
    for label, which, scale in (
        ("attitude", Kind.ATTITUDE, None),
        ("attitude by angle", Kind.ATTITUDE, closed.angle),
        ("velocity", Kind.VELOCITY, None),
        ("velocity by effort", Kind.VELOCITY, closed.effort),
    ):
        rows = np.flatnonzero(kind == which)
        if not len(rows):
            continue
        turn_of = np.searchsorted(np.flatnonzero(~grid.is_rest), segment[rows])
        size = np.ones(len(rows)) if scale is None else np.square(scale[turn_of])
        typical = float(np.median(np.diag(white)[rows]))
        expected = 0.02 * typical / max(float(np.median(size)), 1e-12)
        out.append(Component.alone(label + cause, rows, size, expected=expected, spread=UNKNOWN))
    return tuple(out)
