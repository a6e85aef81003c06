"""The rows that differences between a recording and a truth make.

In each window and on each channel a difference is projected on its mean and on given shapes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy import sparse

from calib.effects.base import State
from calib.mismatch.noise.sensornoise import (
    DRIFT,
    SPREAD,
    DriftKernels,
    drift_components,
)
from calib.mismatch.reference.captured import Felt, Known, mean_covariance, moved_by, wobble
from calib.mismatch.reference.shapes import Shapes
from calib.mismatch.reference.steadied import Steady
from calib.mismatch.rows.rows import UNKNOWN, Component, Kind, Rows
from calib.mismatch.twin.twin import baseline_column
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

LIKE_REST = 1.5
"""Up to so much more noise than quiet ones a window has none of its own."""

TOGETHER = 8.0
"""Rows that err alike where captured angles wander: shapes of three channels, and of neighbouring
windows."""

RESTLESS = 4.0
"""A window whose samples scatter by this much more (in variance) than in quiet ones holds motion
that the truth does not follow: shaking beyond its band, play between the two."""


def make_rows(
    shapes: Shapes,
    state: State,
    left: FloatArray,
    *,
    names: tuple[str, ...],
    nuisance: list[Mapping[str, FloatArray]],
    aligned: tuple[str, ...],
    prior: FloatArray,
    known: Known | None = None,
    steady: Steady | None = None,
    late: sparse.csr_matrix | None = None,
    swayed: FloatArray | None = None,
) -> Rows:
    """Return the rows: the mean of every window and channel, and what follows the shapes there.

    Each is scaled such that white samples give it the variance of a mean. What is ``known`` of the
    noise of a captured motion says more of means than the noise of samples does; in rests it may be
    ``steady``. A gyroscope may put out all that it senses ``late``, as `delaying` has it. What
    follows the shapes may be `swayed` by wandering angles, as `swayed_by` says.
    """
    blur, first, last = shapes.blur, shapes.first, shapes.last
    count = last - first
    time = state.time[blur.seen]
    k = len(first)
    dense, m = 6 * k, 6 * k + len(shapes.vectors)
    channel, segment = shapes.channels, shapes.segments
    kind = np.full(m, int(Kind.CONTRAST))
    kind[:dense] = Kind.MEAN
    functional, white = shapes.weights
    variance = shapes.noise[segment, channel] * white
    variance[dense:] += shapes.flicker / count[shapes.segment]
    if swayed is not None:
        variance[dense:] += swayed
    quiet = np.quantile(shapes.noise, 0.2, axis=0)
    restless = shapes.noise[segment, channel] > RESTLESS * quiet[channel]
    interval = np.stack((time[first], time[last - 1]), axis=1)
    point_segment = np.clip(np.searchsorted(interval[:, 0], state.time, side="right") - 1, 0, k - 1)
    inside = np.flatnonzero(
        (state.time >= interval[point_segment, 0]) & (state.time <= interval[point_segment, 1])
    )
    member = sparse.csr_matrix(
        (np.ones(len(inside)), (inside, point_segment[inside])), shape=(len(state.time), k)
    )
    pieces = tuple((f @ member).tocsr() for f in functional)
    samples = functional
    if late is not None:
        functional = (*functional[:3], *((f @ late).tocsr() for f in functional[3:]))

    def column(signals: Mapping[str, FloatArray]) -> FloatArray:
        out = np.zeros(m)
        for name, values in signals.items():
            out += functional[CHANNELS.index(name)] @ values
        return out

    residual = _summed(samples, left)
    matrix, means = np.diag(variance[:dense]), variance[:dense]
    slow: tuple[Component, ...] = ()
    density = np.median(
        2 * shapes.noise * (np.ptp(interval, axis=1) / (count - 1))[:, None], axis=0
    )
    if known is not None:
        share = np.maximum(1.0 - LIKE_REST * quiet / shapes.noise, 0.0)
        felt = Felt.of([f[:dense] for f in samples], state, known.interval)
        matrix = mean_covariance(felt, known, steady)
        matrix += np.diag(means * share[segment[:dense], channel[:dense]])
        nodes = np.append(interval[:, 0], interval[-1, 1])
        slow = (wobble(felt, state.time, known, nodes, steady),)
        if steady is not None:
            force, rate = (moved_by(felt, angle) for angle in (steady.tilted, steady.moved))
            residual[:dense] -= np.where(channel[:dense] < 3, force, rate)
        density = np.square(np.repeat(known[:2], 3))
    rows = Rows(
        residual=residual,
        baseline=np.stack([column(baseline_column(x, state)) for x in names], axis=1),
        names=names,
        nuisance=np.stack([column(x) for x in nuisance], axis=1),
        functional=functional,
        state=state,
        point_segment=point_segment,
        white=matrix,
        white_diagonal=variance[dense:],
        components=(
            *_components(pieces, dense, interval, density),
            *slow,
            *_of_motion(means, restless[:dense], channel[:dense]),
        ),
        kind=kind,
        channel=channel,
        segment=segment,
        block=segment,
        interval=interval,
        is_rest=np.zeros(k, bool),
        aligned=aligned,
        restless=restless,
        prior=prior,
    )
    if shapes.told is None:
        return rows
    rows = rows.without((rows.channel < 3) & ~shapes.told[rows.segment])
    return replace(rows, components=tuple(c for c in rows.components if len(c.index)))


def seen_of(shapes: Shapes, left: FloatArray) -> FloatArray:
    """Return what rows see, (m,), of (n, 6) differences."""
    seen = _summed(shapes.weights[0], left)
    if shapes.told is None:
        return seen
    return seen[(shapes.channels >= 3) | shapes.told[shapes.segments]]


def _summed(functional: tuple[sparse.csr_matrix, ...], left: FloatArray) -> FloatArray:
    seen = [f @ values for f, values in zip(functional, left.T, strict=True)]
    return np.asarray(np.sum(seen, axis=0))


def swayed_by(
    wander: float, shapes: Shapes, state: State, known: Known, steady: Steady | None
) -> FloatArray:
    """Return what wandering angles add to the variance of rows that follow shapes, (k,).

    `TOGETHER` times what each has of it: all of a window err alike, and the next by nearly as much,
    which no row knows of another. ``wander`` is the variance of the angles, rad².
    """
    dense = 6 * len(shapes.first)
    functional, _ = shapes.weights
    time = state.time[shapes.blur.seen]
    nodes = np.append(time[shapes.first], time[shapes.last[-1] - 1])
    felt = Felt.of([f[dense:] for f in functional], state, known.interval)
    return np.asarray(TOGETHER * wander * wobble(felt, state.time, known, nodes, steady).variance)


def _of_motion(variance: FloatArray, restless: BoolArray, channel: IntArray) -> Iterator[Component]:
    """Yield what restless means err by besides, in parts of the variance that samples say.

    The truth's errors, which go with the motion, are no white noise: neighbouring samples err
    alike, so that a mean is off by more.
    """
    for k, triad in enumerate(("accel", "gyro")):
        index = np.flatnonzero(restless & (channel // 3 == k))
        if index.size:
            own = variance[index]
            yield Component.alone(f"{triad} motion", index, own, expected=1.0, spread=UNKNOWN)


def _components(
    pieces: tuple[sparse.csr_matrix, ...],
    dense: int,
    interval: FloatArray,
    density: FloatArray,
) -> tuple[Component, ...]:
    """Return the drift of each channel: jitter, flicker and walk, as in the twin's rows.

    ``density`` (6,) is the square of each channel's noise density.
    """
    kernels, out = DriftKernels.of(interval), []
    for c, name in enumerate(CHANNELS):
        drift = DRIFT[name.split(".")[0]] ** 2 * density[c]
        out += drift_components(name, pieces[c][:dense], kernels, drift, SPREAD)
    return tuple(out)
