"""Recording minus twin as rows, linearised at the twin; with the covariance that judges them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from calib.effects.base import State
from calib.mismatch.closure import Closures, across, close_turns
from calib.mismatch.grid import Grid
from calib.mismatch.rows import UNKNOWN, Component, Kind, Rows
from calib.mismatch.sampling import sampling_components
from calib.mismatch.sensornoise import (
    DRIFT,
    DRIFT_TIME,
    SPREAD,
    drift_components,
    flicker_covariance,
)
from calib.mismatch.twin import Twin, baseline_column, true_state
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

MEANS = 1 / 3
"""Mean square of the share, from 0 to 1, of a sample interval over which samples are means."""

BINS = (1 / 6, 1 / 2)
"""Where a cell of a rest is cut, in its length: what a turn leaves behind fades at its start."""


class Linear(NamedTuple):
    """Recording minus twin, and its derivatives, as `Rows` have them; without what noise does.

    ``closed`` are the closures of the turns, and ``ends`` (k, 5) their rows.
    """

    residual: FloatArray
    baseline: FloatArray
    nuisance: FloatArray
    functional: tuple[sparse.csr_matrix, ...]
    state: State
    kind: IntArray
    channel: IntArray
    segment: IntArray
    closed: Closures
    ends: IntArray


def linearise(grid: Grid, twin: Twin) -> Linear:
    """Return recording minus twin, linearised at the twin.

    But turns are linearised where the rests beside them have the gyro's bias. In a day it walks by
    a tenth of a degree a second, and what an attitude that is off by ``d`` does to the velocity,
    ``g d²/2`` a second, is no longer linear in it.
    """
    state = true_state(grid, twin)
    measured = np.hstack((grid.accel, grid.gyro))
    # Terms and transforms that the model already holds are taken out of the measured signals.
    explained = _explained(grid, twin, state)
    model = twin.model
    predicted = np.hstack((model.accel.distort(state.force), model.gyro.distort(state.rate)))
    inverse = (np.linalg.inv(model.accel.matrix), np.linalg.inv(model.gyro.matrix))
    rest = np.flatnonzero(grid.is_rest)
    turns = np.flatnonzero(~grid.is_rest)
    n, n_cell, n_turn = len(grid.time), len(rest), len(turns)
    n_mean, n_close = 6 * n_cell, 5 * n_turn
    m = n_mean + n_close + 12 * n_cell
    residual = np.zeros(m)
    kind = np.empty(m, np.int64)
    channel = np.full(m, -1, np.int64)
    segment = np.empty(m, np.int64)
    nuisance = np.zeros((m, 2 * grid.n_poses))
    left = measured - explained - predicted
    # At rest: rows (3, cells, 6) of the means, and of two contrasts.
    still = np.flatnonzero(grid.pose >= 0)
    cell_of = np.cumsum(grid.is_rest) - 1
    cell = cell_of[grid.segment[still]]
    weights = _cell_weights(grid.count[still], cell)
    at = np.arange(6 * n_cell).reshape(n_cell, 6)
    later = n_mean + n_close + 12 * np.arange(n_cell)[:, None] + np.arange(6)
    rows = np.stack((at, later, later + 6))
    for row, weight in zip(rows, weights, strict=True):
        for c in range(6):
            residual[row[:, c]] = np.bincount(cell, weight * left[still, c], n_cell)
    channel[rows] = np.arange(6)
    segment[rows] = rest[:, None]
    kind[rows[0]], kind[rows[1:]] = Kind.MEAN, Kind.CONTRAST
    tilt = twin.gravity * np.einsum("ij,kjl->kil", model.accel.matrix, across(twin.up))
    pose = grid.before[rest]
    for j in (0, 1):
        nuisance[rows[0, :, :3], 2 * pose[:, None] + j] = tilt[pose, :, j]
    # Turns: rows (turns, 5).
    points, spans = grid.turns
    drift = 0.5 * (residual[at[cell_of[turns - 1], 3:]] + residual[at[cell_of[turns + 1], 3:]])
    drift = drift[spans.turn]
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
    ends = n_mean + np.arange(n_close).reshape(n_turn, 5)
    moved = (closed.accel_weights @ inverse[0], closed.gyro_weights @ inverse[1])
    undone = np.add.reduceat(np.einsum("rni,ni->rn", moved[1], drift), spans.start, axis=1)
    residual[ends] = closed.residual + undone.T
    kind[ends] = [Kind.ATTITUDE] * 2 + [Kind.VELOCITY] * 3
    segment[ends] = turns[:, None]
    for j in (0, 1):
        nuisance[ends, 2 * before[:, None] + j] += closed.before[:, :, j]
        nuisance[ends, 2 * after[:, None] + j] += closed.after[:, :, j]
    row_of = ends[spans.turn].T
    functional = []
    for c in range(6):
        # Of the attitude, accelerometers know nothing.
        known = slice(2, 5) if c < 3 else slice(0, 5)
        onto = moved[c // 3][known, :, c % 3]
        index = (*rows[:, :, c][:, cell], *row_of[known])
        place = np.concatenate((*[still] * 3, *[points] * len(onto)))
        values = np.concatenate((*weights, *onto))
        functional.append(sparse.csr_matrix((values, (np.concatenate(index), place)), shape=(m, n)))
    baseline = np.zeros((m, len(twin.names)))
    for j, name in enumerate(twin.names):
        for key, values in baseline_column(name, state).items():
            baseline[:, j] += functional[CHANNELS.index(key)] @ values
    return Linear(
        residual,
        baseline,
        nuisance,
        tuple(functional),
        state,
        kind,
        channel,
        segment,
        closed,
        ends,
    )


def build_rows(grid: Grid, twin: Twin, noise: FloatArray, *, spread: float | None = None) -> Rows:
    """Return recording minus twin as rows, linearised at the twin.

    Parameters
    ----------
    grid, twin : Grid, Twin
    noise : (n, 6) array
        Variance of each point's mean on each channel, white part.
    spread : float, optional
        How uncertain the size of drift is beforehand, in place of `SPREAD`.
    """
    linear = linearise(grid, twin)
    state, closed, ends = linear.state, linear.closed, linear.ends
    points, spans = grid.turns
    n, m = len(grid.time), len(linear.residual)
    dense = int((linear.kind != Kind.CONTRAST).sum())
    member = sparse.csr_matrix(
        (np.ones(n), (np.arange(n), grid.segment)), shape=(n, len(grid.first))
    )
    white = np.zeros((dense, dense))
    diagonal = np.zeros(m - dense)
    for c, f in enumerate(linear.functional):
        top = f[:dense]
        white += (top.multiply(noise[:, c]) @ top.T).toarray()
        diagonal += np.asarray(f[dense:].power(2) @ noise[:, c]).ravel()
    pieces = tuple((f @ member).tocsr() for f in linear.functional)
    components = _components(
        grid,
        pieces,
        linear.kind[:dense],
        linear.segment[:dense],
        white,
        noise,
        closed,
        SPREAD if spread is None else spread,
    )
    components += tuple(
        sampling_components(
            closed,
            state.force[points],
            state.rate[points],
            noise[points],
            spans.first,
            ends,
            np.diag(white)[ends],
        )
    )
    blur = mean_over_interval(grid, state)
    spilt = sum(f[:dense] @ blur[:, c] for c, f in enumerate(linear.functional))
    white += MEANS * np.outer(spilt, spilt)
    return Rows(
        residual=linear.residual,
        baseline=linear.baseline,
        names=twin.names,
        nuisance=linear.nuisance,
        functional=linear.functional,
        state=state,
        point_segment=grid.segment,
        white=white,
        white_diagonal=diagonal,
        components=components,
        kind=linear.kind,
        channel=linear.channel,
        segment=linear.segment,
        block=grid.before[linear.segment],
        interval=grid.interval,
        is_rest=grid.is_rest,
        pieces=pieces,
    )


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


def _explained(grid: Grid, twin: Twin, state: State) -> FloatArray:
    """Return what the model's further terms add to the signals, (n, 6)."""
    model = twin.model
    if not model.terms:
        return np.zeros((len(grid.time), 6))
    plain = replace(model, terms=())
    full, bare = model.distort(state), plain.distort(state)
    return np.hstack((full.accel - bare.accel, full.gyro - bare.gyro))


def _cell_weights(count: IntArray, cell: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weights of a mean and of two contrasts over the `BINS`, all of one variance.

    Each point has its `count` of samples, and its `cell`.
    """
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    points = np.diff(first, append=len(cell))[cell]
    place = (np.arange(len(cell)) - first[cell] + 0.5) / points
    bins = np.searchsorted(BINS, place)
    size = np.bincount(3 * cell + bins, count).reshape(-1, 3)
    share = (size / size.sum(axis=1, keepdims=True))[cell]
    mean = count / size.sum(axis=1)[cell]
    own = count / size[cell, bins]
    # Each bin against those after it; the squares over the shares add up to one.
    after = share[:, 1] + share[:, 2]
    early = np.where(bins == 0, 1.0, -share[np.arange(len(cell)), bins] / after)
    early *= np.sqrt(share[:, 0] * after)
    late = np.array([0.0, 1.0, -1.0])[bins]
    late *= np.sqrt(share[:, 1] * share[:, 2] / after)
    return mean, own * early, own * late


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
    """Return the unknown variances: per channel a jitter and a random walk; the closures' own."""
    dense = len(kind)
    rest = grid.pose >= 0
    inside = np.diff(grid.segment) == 0
    step = float(np.median(np.diff(grid.time)[inside] / grid.count[1:][inside]))
    # One-sided density squared: variance of a mean, times its length, times two.
    density = np.median(2 * noise[rest] * grid.count[rest, None] * step, axis=0)
    middle = grid.interval.mean(axis=1)
    walk = np.minimum.outer(middle - middle[0], middle - middle[0]) / DRIFT_TIME
    flicker = flicker_covariance(middle, np.ptp(grid.interval, axis=1))
    out = []
    for c, name in enumerate(CHANNELS):
        drift = DRIFT[name.split(".")[0]] ** 2 * density[c]
        out += drift_components(name, pieces[c][:dense], flicker, walk, drift, spread)
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
        out.append(Component.alone(label, rows, size, expected=expected, spread=UNKNOWN))
    return tuple(out)
