"""The digital twin of a recording: the sensor model and the attitudes that reproduce it.

`build_rows` linearises recording minus twin; `fit_twin` iterates it to the best baseline.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from calib.effects import get_effect
from calib.effects.base import State
from calib.mismatch.closure import Closures, across, close_turns
from calib.mismatch.grid import Grid
from calib.mismatch.heading import orient
from calib.mismatch.rows import Component, Kind, Rows
from calib.model import SensorModel, Triad
from calib.recording import AXES, CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

ACCEL_MISALIGNMENT = ("yx", "zx", "zy")
GYRO_MISALIGNMENT = ("xy", "xz", "yx", "yz", "zx", "zy")

DRIFT = {"accel": 0.15, "gyro": 0.5}
"""How far a bias wanders in `DRIFT_TIME`, per noise density: the ratio of bias instability to noise
density in data sheets and Allan plots (MPU-6050: 50 µg to 400 µg/√Hz, 10 °/h to 18 °/h/√Hz). In
minutes at rest a few slow modes are all that shows of drift, and effects go with them; so the prior
on drift is part of the physics. Jitter, flicker and walk of the axes of one triad share their
scale, so that what is seen from pose to pose says what to expect over minutes."""

SPREAD = 1.4
"""Standard deviation of the logarithm of a level (a variance) of drift, or of what sampling adds: a
factor of 2 in size."""

DRIFT_TIME = 600.0
"""s."""

MEANS = 1 / 3
"""Mean square of the share, from 0 to 1, of a sample interval over which samples are means."""

BINS = (1 / 6, 1 / 2)
"""Where a cell of a rest is cut, in its length: what a turn leaves behind fades at its start."""

HALVED = 1 / 9
"""Variance of what sampling adds to a closure, relative to what every second sample changes: a rule
of the second order errs by a third of that."""

UNRESOLVED = 3.0
"""Square of what every second sample changes, relative to what noise does to it, from which a turn
is too fast for its samples: noise alone reaches it in one turn of twenty."""

# Weak knowledge that keeps the iteration steady where a recording says nothing: standard deviations
# many times what uncalibrated parts have. It is no part of any evidence.
_LOOSE = {"bias": 2.0, "scale_factor_error": 0.5, "misalignment": 0.3}


@dataclass(frozen=True, eq=False)
class Twin:
    """A sensor model, and the unit vector up in frame s at each rest (k, 3)."""

    model: SensorModel
    up: FloatArray
    full_gyro: bool
    gravity: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the baseline's parameters, in the order of their columns."""
        names = [f"accel.bias.{a}" for a in AXES]
        names += [f"accel.scale_factor_error.{a}" for a in AXES]
        names += [f"accel.misalignment.{p}" for p in ACCEL_MISALIGNMENT]
        names += [f"gyro.bias.{a}" for a in AXES]
        names += [f"gyro.scale_factor_error.{a}" for a in AXES]
        if self.full_gyro:
            names += [f"gyro.misalignment.{p}" for p in GYRO_MISALIGNMENT]
        return tuple(names)

    def moved(self, step: Mapping[str, float], angles: FloatArray) -> Twin:
        """Return the twin with baseline parameters and attitudes (k, 2) moved."""
        triads = []
        for name, triad in (("accel", self.model.accel), ("gyro", self.model.gyro)):
            now = triad.parameters(name)
            new = {k: now[k] + v for k, v in step.items() if k in now}
            triads.append(triad.with_parameters(new))
        up = self.up + np.einsum("kij,kj->ki", across(self.up), angles)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        return replace(self, model=replace(self.model, accel=triads[0], gyro=triads[1]), up=up)


def true_state(grid: Grid, twin: Twin) -> State:
    """Return the true state on the grid: at rest exactly so, in turns as the twin corrects it."""
    measured = State(
        time=grid.time,
        force=grid.accel,
        rate=grid.gyro,
        temperature=grid.temperature,
        reference_temperature=twin.model.reference_temperature,
        power_on=float(grid.time[0]),
        since_turn=grid.since_turn,
        vibration=grid.vibration,
        temperature_slope=grid.temperature_slope,
        gravity=twin.gravity,
    )
    corrected = twin.model.correct(measured)
    measured = replace(measured, mat_ns=orient(grid, twin.up, corrected.gyro))
    if any("mat_ns" in get_effect(term.effect).reads for term in twin.model.terms):
        corrected = twin.model.correct(measured)
    pose = grid.pose
    rest = pose >= 0
    force, rate = corrected.accel.copy(), corrected.gyro.copy()
    force[rest] = twin.gravity * twin.up[pose[rest]]
    rate[rest] = 0.0
    return replace(measured, force=force, rate=rate)


def baseline_column(name: str, state: State) -> dict[str, FloatArray]:
    """Return what one unit of a baseline parameter adds to the signals."""
    triad, group, index = name.split(".")
    values = state.force if triad == "accel" else state.rate
    channel = f"{triad}.{index[0]}"
    if group == "bias":
        return {channel: np.ones(len(values))}
    return {channel: values[:, AXES.index(index[-1])]}


def start_twin(grid: Grid, model: SensorModel | None, *, gravity: float, full_gyro: bool) -> Twin:
    """Return a first twin: the given model, or one from the rests alone."""
    means = _pose_means(grid)
    if model is None:
        model = SensorModel(gyro=Triad(bias=means[:, 3:].mean(axis=0)))
        if grid.temperature is not None:
            model = replace(model, reference_temperature=float(np.median(grid.temperature)))
    up = means[:, :3] - model.accel.bias
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    twin = Twin(model, up, full_gyro, gravity)
    accel = [n for n in twin.names if n.startswith("accel")]
    k = len(up)
    loose = np.array([_LOOSE[n.split(".")[1]] for n in accel])
    for _ in range(12):
        matrix, bias = twin.model.accel.matrix, twin.model.accel.bias
        force = gravity * twin.up
        residual = means[:, :3] - force @ matrix.T - bias
        state = State(np.arange(k, dtype=float), force, np.zeros_like(force))
        design = np.zeros((k, 3, len(accel) + 2 * k))
        for j, name in enumerate(accel):
            for channel, values in baseline_column(name, state).items():
                design[:, CHANNELS.index(channel), j] = values
        turn = gravity * np.einsum("ij,kjl->kil", matrix, across(twin.up))
        for p in range(k):
            design[p, :, len(accel) + 2 * p : len(accel) + 2 * p + 2] = turn[p]
        flat = design.reshape(3 * k, -1)
        now = twin.model.accel.parameters("accel")
        pull = np.array([now[n] for n in accel]) / loose
        ridge = np.zeros((len(accel), flat.shape[1]))
        ridge[:, : len(accel)] = np.diag(1.0 / loose)
        # The ridge weighs as 1 m/s² of residual does: nothing beside poses that determine.
        step = np.linalg.lstsq(
            np.vstack((flat, 1e-3 * ridge)),
            np.concatenate((residual.ravel(), -1e-3 * pull)),
            rcond=None,
        )[0]
        twin = twin.moved(
            dict(zip(accel, step[: len(accel)], strict=True)),
            step[len(accel) :].reshape(k, 2),
        )
        if np.abs(step).max() < 1e-9:
            break
    return twin


def _pose_means(grid: Grid) -> FloatArray:
    pose = grid.pose
    rest = pose >= 0
    weight = np.where(rest, grid.count, 0).astype(float)[rest]
    both = np.hstack((grid.accel, grid.gyro))[rest]
    total = np.bincount(pose[rest], weight, grid.n_poses)
    out = np.empty((grid.n_poses, 6))
    for c in range(6):
        out[:, c] = np.bincount(pose[rest], weight * both[:, c], grid.n_poses) / total
    return out


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
    cell = (np.cumsum(grid.is_rest) - 1)[grid.segment[still]]
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
    points = np.flatnonzero(grid.pose < 0)
    first = np.append(0, np.cumsum(grid.last[turns] - grid.first[turns]))
    before, after = grid.before[turns], grid.after[turns]
    closed = close_turns(
        grid.time[points],
        state.force[points],
        state.rate[points],
        first,
        twin.up[before],
        twin.up[after],
        gravity=twin.gravity,
    )
    ends = n_mean + np.arange(n_close).reshape(n_turn, 5)
    residual[ends] = closed.residual
    kind[ends] = [Kind.ATTITUDE] * 2 + [Kind.VELOCITY] * 3
    segment[ends] = turns[:, None]
    for j in (0, 1):
        nuisance[ends, 2 * before[:, None] + j] += closed.before[:, :, j]
        nuisance[ends, 2 * after[:, None] + j] += closed.after[:, :, j]
    row_of = np.repeat(ends, np.diff(first), axis=0).T
    moved = (closed.accel_weights @ inverse[0], closed.gyro_weights @ inverse[1])
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
    dense = n_mean + n_close
    member = sparse.csr_matrix(
        (np.ones(n), (np.arange(n), grid.segment)), shape=(n, len(grid.first))
    )
    white = np.zeros((dense, dense))
    diagonal = np.zeros(m - dense)
    for c, f in enumerate(functional):
        top = f[:dense]
        white += (top.multiply(noise[:, c]) @ top.T).toarray()
        diagonal += np.asarray(f[dense:].power(2) @ noise[:, c]).ravel()
    pieces = tuple((f @ member).tocsr() for f in functional)
    components = _components(
        grid,
        pieces,
        kind[:dense],
        segment[:dense],
        white,
        noise,
        closed,
        SPREAD if spread is None else spread,
    )
    blur = mean_over_interval(grid, state)
    spilt = sum(f[:dense] @ blur[:, c] for c, f in enumerate(functional))
    white += MEANS * np.outer(spilt, spilt)
    return Rows(
        residual=residual,
        baseline=baseline,
        names=twin.names,
        nuisance=nuisance,
        functional=tuple(functional),
        state=state,
        point_segment=grid.segment,
        white=white,
        white_diagonal=diagonal,
        components=components,
        kind=kind,
        channel=channel,
        segment=segment,
        block=grid.before[segment],
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


def flicker_covariance(time: FloatArray, length: FloatArray) -> FloatArray:
    """Return the covariance of means of 1/f noise with a bias instability of one.

    A sum of Gauss-Markov processes, correlation times a factor of 3 apart from shorter than any
    segment to longer than the recording, each of variance ``ln(3) / pi``: one-sided density
    ``1 / (pi f)``. Those shorter than a segment are averaged down in it.
    """
    gap = np.abs(np.subtract.outer(time, time))
    span = max(float(gap.max()), 1e-9)
    size = np.maximum(length, 1e-9)
    out = np.zeros_like(gap)
    for correlation in 3 * span * 3.0 ** -np.arange(12.0):
        ratio = size / correlation
        # Variance of the mean of a Gauss-Markov process over a segment.
        own = 2 * (ratio - 1 + np.exp(-ratio)) / np.square(ratio)
        part = np.exp(-np.maximum(gap, 0) / correlation) * np.sqrt(np.outer(own, own))
        np.fill_diagonal(part, own)
        out += part
    return np.asarray(out * np.log(3.0) / np.pi)


def drift_components(
    channel: str,
    pieces: sparse.csr_matrix,
    flicker: FloatArray,
    walk: FloatArray,
    drift: float,
    spread: float,
) -> list[Component]:
    """Return the drift of one channel's bias: jitter, flicker and random walk.

    Parameters
    ----------
    channel : str
    pieces : sparse (n_dense, s) matrix
        Response to a constant on that channel in each segment.
    flicker, walk : (s, s) arrays
        Covariances of the mean bias of the segments, for a level of one.
    drift : float
        Expected level.
    spread : float
    """
    index = np.flatnonzero(np.diff(pieces.indptr))
    response = pieces[index].toarray()
    triad = channel.split(".")[0]
    return [
        Component(f"{channel} {label}", index, matrix, share * drift, spread, triad)
        for label, matrix, share in (
            ("jitter", response @ response.T, 0.1),
            ("flicker", response @ flicker @ response.T, 1.0),
            ("walk", response @ walk @ response.T, 1.0),
        )
    ]


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
        out.append(Component(label, rows, np.diag(size), expected))
    for label, which, change in (
        ("attitude by sampling", Kind.ATTITUDE, closed.unresolved[:, :2]),
        ("velocity by sampling", Kind.VELOCITY, closed.unresolved[:, 2:]),
    ):
        rows = np.flatnonzero(kind == which)
        noisy = np.diag(white)[rows].reshape(change.shape).mean(axis=1)
        size = np.square(change).mean(axis=1)
        size = np.repeat(np.where(size > UNRESOLVED * noisy, size, 0.0), change.shape[1])
        # Also where there is none: as the twin moves, a turn may come to be one, or cease to be.
        out.append(Component(label, rows[size > 0], np.diag(size[size > 0]), HALVED, SPREAD))
    return tuple(out)


def sample_noise(grid: Grid) -> FloatArray:
    """Return the variance of each point's mean on each channel, (n, 6), white part.

    From successive differences of the points at rest (quarter seconds), so that noise that is
    correlated over a few samples counts in full and drift does not. A rest that is clearly noisier
    than the others (vibration, a hand) has its own level.
    """
    values = np.hstack((grid.accel, grid.gyro))
    segment, pose = grid.segment, grid.pose
    pair = (segment[1:] == segment[:-1]) & (pose[1:] >= 0)
    gap = np.diff(grid.time)
    # Across a hole in time the bias has drifted.
    pair &= gap <= 3 * np.median(gap[pair]) if pair.any() else pair
    weight = grid.count[1:] * grid.count[:-1] / (grid.count[1:] + grid.count[:-1])
    square = np.square(np.diff(values, axis=0)) * weight[:, None]
    own = np.empty((grid.n_poses, 6))
    number = np.bincount(pose[1:][pair], minlength=grid.n_poses)
    for c in range(6):
        own[:, c] = np.bincount(pose[1:][pair], square[pair, c], grid.n_poses)
    own /= np.maximum(number, 1)[:, None]
    usable = number >= 4
    common = np.median(own[usable] if usable.any() else own, axis=0)
    floor = np.maximum(common, 1e-12 * np.square(np.abs(values)).max(axis=0) + 1e-18)
    ratio = np.where(usable[:, None], own / floor, 1.0)
    # A ratio beyond four standard errors of its estimate is a rest with a level of its own.
    limit = 1.0 + 4.0 * np.sqrt(2.0 / np.maximum(number, 1))[:, None]
    loud = ratio > limit
    error = np.broadcast_to(3.0 / np.maximum(number, 1)[:, None], ratio.shape)
    for triad in (np.arange(6) < 3, np.arange(6) >= 3):
        mine = loud & triad
        ratio[mine] = shrunk(ratio[mine], error[mine])
    level = floor * np.where(loud, ratio, 1.0)
    # While it moves, nobody knows: the common level.
    near = grid.near
    each = np.where((near >= 0)[:, None], level[np.maximum(near, 0)], floor)
    return np.asarray(each / grid.count[:, None])


def shrunk(level: FloatArray, error: FloatArray) -> FloatArray:
    """Return variances from few differences each, drawn to what they have in common.

    Where each is weighted by its own, those that are too small by chance would count most. The
    logarithm of a variance from n successive differences has a variance of about 3/n, `error`; what
    levels differ by beyond that is how much each is its own.
    """
    if not len(level):
        return level
    logs = np.log(level) + 0.5 * error
    between = max(float(np.var(logs) - error.mean()), 0.0) if len(level) > 1 else np.inf
    own = 1.0 if np.isinf(between) else between / (between + error)
    # The mean of a variance whose logarithm is uncertain.
    return np.asarray(np.exp(logs.mean() + own * (logs - logs.mean()) + 0.5 * own * error))


def fit_twin(
    grid: Grid,
    twin: Twin,
    noise: FloatArray,
    *,
    iterations: int = 8,
    drop: BoolArray | None = None,
) -> Twin:
    """Fit baseline and attitudes to the recording by robust Gauss-Newton.

    Closures that disagree with the rest by far (a bumped turn, lost samples) are down-weighted.
    Segments in `drop` (s,) are left out.
    """
    loose = np.array([_LOOSE[n.split(".")[1]] for n in twin.names])
    for _ in range(iterations):
        rows = build_rows(grid, twin, noise)
        own = np.arange(rows.n_dense)
        if drop is not None:
            own = own[~drop[rows.segment[own]]]
        twin, size = _step(rows, own, twin, loose)
        if size < 1e-7:
            break
    return twin


def _step(rows: Rows, dense: IntArray, twin: Twin, loose: FloatArray) -> tuple[Twin, float]:
    """Return the twin after a step that fits some of the dense rows, and how large a step it is."""
    p = len(twin.names)
    sigma = np.sqrt(rows.expected_variance()[dense])
    design = np.hstack((rows.baseline[dense], rows.nuisance[dense])) / sigma[:, None]
    y, kinds = rows.residual[dense] / sigma, rows.kind[dense]
    now = {**twin.model.accel.parameters("accel"), **twin.model.gyro.parameters("gyro")}
    ridge = np.zeros((p, design.shape[1]))
    ridge[:, :p] = np.diag(1.0 / loose)
    pull = -np.array([now[n] for n in twin.names]) / loose
    weight = np.ones(len(dense))
    step = np.zeros(design.shape[1])
    for _ in range(4):
        root = np.sqrt(weight)
        step = np.linalg.lstsq(
            np.vstack((design * root[:, None], ridge)), np.append(y * root, pull), rcond=None
        )[0]
        left = np.abs(y - design @ step)
        # Each kind has its own scale: what the closures leave is not known beforehand.
        for kind in np.unique(kinds):
            own = kinds == kind
            scale = max(float(np.median(left[own])) / 0.6745, 1.0)
            weight[own] = np.minimum(1.0, 3.0 * scale / np.maximum(left[own], 1e-12)) / scale**2
    angles = step[p:].reshape(-1, 2)
    moved = twin.moved(dict(zip(twin.names, step[:p], strict=True)), np.clip(angles, -0.5, 0.5))
    return moved, float(np.abs(step).max())
