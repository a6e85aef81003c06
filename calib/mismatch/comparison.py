"""A recording against a truth that something else measured: a simulation, or a reference.

``real(t) = model(x(t + offset + stretch (t - middle))) + noise``, x the truth. The differences are
not judged sample by sample: in each window and on each channel they are projected on its mean and
on the few shapes that the sensor's baseline, the alignment and the catalogue can have there. Those
projections are the rows; what is left of the samples is white noise, and gives its level.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from scipy import sparse

from calib.effects import effects, get_effect
from calib.effects.base import State, Term, TransformEffect
from calib.effects.observed import observed
from calib.errors import NoCommonMotionError
from calib.mismatch.alignment import Alignment
from calib.mismatch.grid import smooth_temperature
from calib.mismatch.rows import Component, Kind, Rows
from calib.mismatch.twin import (
    ACCEL_MISALIGNMENT,
    DRIFT,
    DRIFT_TIME,
    SPREAD,
    baseline_column,
    drift_components,
    flicker_covariance,
)
from calib.model import SensorModel
from calib.recording import AXES, CHANNELS, Recording
from calib.rotation import mat_from_rotvec
from calib.types import BoolArray, FloatArray, IntArray

SEGMENTS = 80
"""Windows that a recording is cut into, at most."""

SHORTEST = 1.0
"""s of a window, at least."""

SHAPES = 1200
"""Rows that follow a shape within a window, at most: the strongest ones are kept."""

VISIBLE = 0.1
"""A shape that effects of typical size reach by less than this, in standard errors, is no row."""

UNLIKE = 0.3
"""Share of the power of rotation that differs, after the fit of the baseline, from which on the
two are two motions."""

ACCEL_BASELINE = (
    *(f"accel.bias.{a}" for a in AXES),
    *(f"accel.scale_factor_error.{a}" for a in AXES),
    *(f"accel.misalignment.{p}" for p in ACCEL_MISALIGNMENT),
)
GYRO_BASELINE = (
    *(f"gyro.bias.{a}" for a in AXES),
    *(f"gyro.scale_factor_error.{a}" for a in AXES),
)
BASELINE = (*ACCEL_BASELINE, *GYRO_BASELINE)

_LOOSE = {"bias": 2.0, "scale_factor_error": 0.5, "misalignment": 0.3}


class Truth(Protocol):
    """What a simulation or a reference says of the motion, on its own clock and in its frame."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        ...

    def covers(self, time: FloatArray) -> BoolArray:
        """Return where the truth is known, (n,) bool."""
        ...

    def state(self, time: FloatArray) -> State:
        """Return the true state at (n,) times of its own clock."""
        ...


class Setup(NamedTuple):
    """Where the comparison stands: sensor model, alignment in time, frames."""

    model: SensorModel
    alignment: Alignment
    mat_sr: FloatArray


@dataclass(frozen=True, eq=False)
class Shapes:
    """Windows ``[first, last)`` of points, and the shapes (unit vectors) that are rows there."""

    first: IntArray
    last: IntArray
    segment: IntArray
    channel: IntArray
    vectors: tuple[FloatArray, ...]
    noise: FloatArray


class ComparisonProblem:
    """Rows of a recording against a truth, under a sensor model that is fitted to it.

    Parameters
    ----------
    real : Recording
    truth : Truth
    alignment : Alignment
    gravity : float, m/s²
    model : SensorModel, optional
        Where the baseline starts; its misalignment and further terms stay.
    mat_sr : (3, 3) array, optional
        From the truth's frame to s. Given, its three angles are fitted; else the frames are one.
    spoilt : (n,) array of bool, optional
        Samples that no model explains (clipped, repeated).
    """

    reference = True
    moves_signals = True

    def __init__(
        self,
        real: Recording,
        truth: Truth,
        alignment: Alignment,
        *,
        gravity: float,
        model: SensorModel | None = None,
        mat_sr: FloatArray | None = None,
        spoilt: BoolArray | None = None,
    ) -> None:
        self.truth, self.gravity = truth, gravity
        self.turned = mat_sr is not None
        covered = truth.covers(alignment.times(real.time))
        if spoilt is not None:
            covered = covered & ~spoilt
        self.index = np.flatnonzero(covered)
        self.time = real.time[self.index]
        self.measured = np.hstack((real.accel, real.gyro))[self.index]
        self.temperature = (
            None if real.temperature is None else smooth_temperature(real)[self.index]
        )
        start = SensorModel() if model is None else model
        if model is None and self.temperature is not None:
            start = replace(start, reference_temperature=float(np.median(self.temperature)))
        self.given = start.terms
        self.power_on = float(real.time[0])
        mat = np.eye(3) if mat_sr is None else mat_sr
        self.setup = Setup(start, alignment, mat)
        self.names = BASELINE
        self.shapes: Shapes | None = None
        self.fit()

    @property
    def aligned(self) -> tuple[str, ...]:
        """The parameters of alignment, in the order of the nuisances."""
        turned = tuple(f"reference_misalignment.r{a}" for a in AXES) if self.turned else ()
        return ("time_offset.delay", "clock_scale.scale", *turned)

    def state(self) -> State:
        """Return the true state at the recording's times, in frame s."""
        model, alignment, mat = self.setup
        state = self.truth.state(alignment.times(self.time))
        given = state.angular_acceleration
        state = replace(
            state,
            time=self.time,
            force=state.force @ mat.T,
            rate=state.rate @ mat.T,
            angular_acceleration=None if given is None else given @ mat.T,
            mat_ns=None if state.mat_ns is None else state.mat_ns @ mat.T,
            temperature=self.temperature,
            temperature_slope=None,
            reference_temperature=model.reference_temperature,
            power_on=self.power_on,
            gravity=self.gravity,
            since_turn=None,
            vibration=None,
        )
        return observed(state, ("vibration", "since_turn"))

    def move(
        self, baseline: Mapping[str, float], nuisance: FloatArray, terms: tuple[Term, ...]
    ) -> None:
        """Move model and alignment by steps; set the further terms."""
        model, alignment, mat = self.setup
        triads = []
        for name, triad in (("accel", model.accel), ("gyro", model.gyro)):
            now = triad.parameters(name)
            new = {k: now[k] + v for k, v in baseline.items() if k in now}
            triads.append(triad.with_parameters(new))
        model = replace(model, accel=triads[0], gyro=triads[1], terms=(*self.given, *terms))
        alignment = alignment.moved(-float(nuisance[0]), -float(nuisance[1]))
        if self.turned:
            # f x rho is -skew(rho) f: the frame turned by -rho.
            mat = mat_from_rotvec(-np.asarray(nuisance[2:5])) @ mat
        self.setup = Setup(model, alignment, mat)

    def rows(self) -> Rows:
        """Return recording minus model of the truth."""
        state = self.state()
        left = self.residual(state)
        if self.shapes is None:
            self.shapes = find_shapes(self.time, left, list(self._shape_columns(state)))
        return make_rows(
            self.shapes,
            state,
            left,
            names=self.names,
            nuisance=[self._nuisance(state, name) for name in self.aligned],
            aligned=self.aligned,
        )

    def residual(self, state: State) -> FloatArray:
        """Return recording minus model, (n, 6)."""
        predicted = self.setup.model.distort(state)
        return np.asarray(self.measured - np.hstack((predicted.accel, predicted.gyro)))

    def fit(self, *, iterations: int = 6) -> None:
        """Fit baseline and alignment by robust Gauss-Newton."""
        for k in range(iterations):
            self.shapes = None if k < 3 else self.shapes
            rows = self.rows()
            step = robust_step(rows)
            p = len(self.names)
            terms = self.setup.model.terms[len(self.given) :]
            self.move(dict(zip(self.names, step[:p], strict=True)), step[p:], terms)
            if k > 3 and np.abs(step).max() < 1e-7:
                break
        self.shapes = None
        state = self.state()
        left = np.square(self.residual(state)[:, 3:]).sum()
        total = np.square(state.rate - state.rate.mean(axis=0)).sum()
        if left > UNLIKE * total:
            raise NoCommonMotionError(
                "the two do not show the same motion: where they match best, "
                f"{100 * left / total:.0f} % of the rotation differs; check that they belong "
                "together and that the axes are the same"
            )

    def _nuisance(self, state: State, name: str) -> Mapping[str, FloatArray]:
        slug, parameter = name.split(".")
        if slug != "clock_scale":
            return get_effect(slug).columns(state, {})[parameter]
        delay = get_effect("time_offset").columns(state, {})["delay"]
        since = state.time - self.setup.alignment.middle
        return {c: since * values for c, values in delay.items()}

    def _shape_columns(self, state: State) -> Iterator[tuple[str, FloatArray]]:
        """Yield what can show in the signals, in units of its typical size: channel and values."""
        for name in self.names:
            if ".bias." not in name:
                for channel, values in baseline_column(name, state).items():
                    yield channel, 0.01 * values
        for name, size in zip(self.aligned, (5e-3, 1e-4, 0.02, 0.02, 0.02), strict=False):
            for channel, values in self._nuisance(state, name).items():
                yield channel, size * values
        for slug, effect in effects().items():
            readout = isinstance(effect, TransformEffect) and effect.stage == "readout"
            if readout or any(s.low is None or s.high is None for s in effect.shape):
                continue
            sizes = {p.name: p.typical for p in effect.parameters}
            for shape in _few_shapes(slug):
                for parameter, column in effect.columns(state, shape).items():
                    for channel, values in column.items():
                        yield channel, sizes[parameter] * values


def _few_shapes(slug: str) -> Iterator[dict[str, float]]:
    """Yield three values of each shape parameter of an effect."""
    items = get_effect(slug).shape
    optional = [s for s in items if s.optional and s.spacing != "integer"]
    for choice in [[s] for s in optional] or [[]]:
        used = [s for s in items if s.spacing != "integer" and not s.optional] + choice
        grids = [np.geomspace(s.low or 1e-3, s.high or 1.0, 5)[1:4] for s in used]
        for values in product(*grids):
            yield {s.name: float(v) for s, v in zip(used, values, strict=True)}


def cut(time: FloatArray) -> tuple[IntArray, IntArray]:
    """Return windows ``[first, last)`` of equal length with at least 12 points each."""
    span = time[-1] - time[0]
    count = int(np.clip(span / SHORTEST, 1, SEGMENTS))
    edges = np.searchsorted(time, time[0] + span * np.arange(count + 1) / count)
    edges[-1] = len(time)
    keep = np.diff(edges) >= 12
    return edges[:-1][keep], edges[1:][keep]


def find_shapes(
    time: FloatArray, left: FloatArray, columns: list[tuple[str, FloatArray]]
) -> Shapes:
    """Return windows, the shapes that columns have in each, and the noise of its samples.

    Parameters
    ----------
    time : (n,) array, s
    left : (n, 6) array
        Recording minus model.
    columns : list of (channel, (n,) values)
    """
    first, last = cut(time)
    noise = np.empty((len(first), 6))
    found: list[tuple[float, int, int, FloatArray]] = []
    for c, name in enumerate(CHANNELS):
        own = np.stack([v for channel, v in columns if channel == name], axis=1)
        rough = float(np.median(np.abs(np.diff(left[:, c], n=2)))) / 0.6745 / np.sqrt(6.0)
        rough = max(rough, 1e-9)
        for s, (a, b) in enumerate(zip(first, last, strict=True)):
            part = own[a:b] - own[a:b].mean(axis=0)
            values, vectors = np.linalg.eigh(part.T @ part)
            size = np.sqrt(np.maximum(values[::-1], 0.0)) / rough
            keep = (size > VISIBLE) & (size > 1e-6 * size[0])
            keep[max((b - a) // 3, 1) :] = False
            shapes = part @ vectors[:, ::-1][:, keep]
            shapes /= np.linalg.norm(shapes, axis=0)
            y = left[a:b, c] - left[a:b, c].mean()
            rest = y - shapes @ (shapes.T @ y)
            noise[s, c] = float(rest @ rest) / (b - a - 1 - shapes.shape[1])
            found += [(float(v), s, c, x) for v, x in zip(size[keep], shapes.T, strict=True)]
    floor = np.maximum(np.median(noise, axis=0), 1e-18)
    strongest = sorted(found, key=lambda item: -item[0])[:SHAPES]
    strongest.sort(key=lambda item: (item[2], item[1]))
    return Shapes(
        first,
        last,
        np.array([item[1] for item in strongest], np.int64),
        np.array([item[2] for item in strongest], np.int64),
        tuple(item[3] for item in strongest),
        np.maximum(noise, floor),
    )


def make_rows(
    shapes: Shapes,
    state: State,
    left: FloatArray,
    *,
    names: tuple[str, ...],
    nuisance: list[Mapping[str, FloatArray]],
    aligned: tuple[str, ...],
) -> Rows:
    """Return the rows: the mean of every window and channel, and what follows the shapes there.

    Each is scaled such that white samples give it the variance of a mean.
    """
    first, last = shapes.first, shapes.last
    count = last - first
    n, k = len(state.time), len(first)
    dense, m = 6 * k, 6 * k + len(shapes.vectors)
    channel = np.concatenate((np.tile(np.arange(6), k), shapes.channel))
    segment = np.concatenate((np.repeat(np.arange(k), 6), shapes.segment))
    kind = np.full(m, int(Kind.CONTRAST))
    kind[:dense] = Kind.MEAN
    variance = shapes.noise[segment, channel] / count[segment]
    weights = [np.full(count[s], 1.0 / count[s]) for s in segment[:dense]]
    weights += [v / np.sqrt(len(v)) for v in shapes.vectors]
    functional = []
    for c in range(6):
        own = np.flatnonzero(channel == c)
        row = np.repeat(own, count[segment[own]])
        points = np.concatenate([np.arange(first[s], last[s]) for s in segment[own]])
        values = np.concatenate([weights[i] for i in own])
        functional.append(sparse.csr_matrix((values, (row, points)), shape=(m, n)))
    point_segment = np.clip(np.searchsorted(first, np.arange(n), side="right") - 1, 0, k - 1)
    inside = np.flatnonzero(np.arange(n) < last[point_segment])
    member = sparse.csr_matrix(
        (np.ones(len(inside)), (inside, point_segment[inside])), shape=(n, k)
    )
    pieces = tuple((f @ member).tocsr() for f in functional)

    def column(signals: Mapping[str, FloatArray]) -> FloatArray:
        out = np.zeros(m)
        for name, values in signals.items():
            out += functional[CHANNELS.index(name)] @ values
        return out

    residual = column(dict(zip(CHANNELS, left.T, strict=True)))
    interval = np.stack((state.time[first], state.time[last - 1]), axis=1)
    return Rows(
        residual=residual,
        baseline=np.stack([column(baseline_column(x, state)) for x in names], axis=1),
        names=names,
        nuisance=np.stack([column(x) for x in nuisance], axis=1),
        functional=tuple(functional),
        state=state,
        point_segment=point_segment,
        white=np.diag(variance[:dense]),
        white_diagonal=variance[dense:],
        components=_components(pieces, dense, interval, shapes.noise, count),
        kind=kind,
        channel=channel,
        segment=segment,
        block=segment,
        interval=interval,
        is_rest=np.zeros(k, bool),
        pieces=pieces,
        aligned=aligned,
    )


def _components(
    pieces: tuple[sparse.csr_matrix, ...],
    dense: int,
    interval: FloatArray,
    noise: FloatArray,
    count: IntArray,
) -> tuple[Component, ...]:
    """Return the drift of each channel: jitter, flicker and walk, as in the twin's rows."""
    length = np.ptp(interval, axis=1)
    step = length / np.maximum(count - 1, 1)
    density = np.median(2 * noise * step[:, None], axis=0)
    middle = interval.mean(axis=1)
    walk = np.minimum.outer(middle - middle[0], middle - middle[0]) / DRIFT_TIME
    flicker = flicker_covariance(middle, length)
    out = []
    for c, name in enumerate(CHANNELS):
        triad = name.split(".")[0]
        drift = DRIFT[triad] ** 2 * density[c]
        out += drift_components(name, pieces[c][:dense], flicker, walk, drift, SPREAD)
    return tuple(out)


def robust_step(rows: Rows) -> FloatArray:
    """Return the Gauss-Newton step of baseline and nuisances, by Huber's weights."""
    p = rows.baseline.shape[1]
    sigma = np.sqrt(np.concatenate((rows.expected_variance(), rows.white_diagonal)))
    design = np.hstack((rows.baseline, rows.nuisance)) / sigma[:, None]
    y = rows.residual / sigma
    loose = np.array([_LOOSE[n.split(".")[1]] for n in rows.names])
    ridge = np.zeros((p, design.shape[1]))
    ridge[:, :p] = np.diag(1.0 / loose)
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    weight = np.ones(len(y))
    step = np.zeros(design.shape[1])
    for _ in range(5):
        root = np.sqrt(weight)
        stacked = np.vstack((design * root[:, None], ridge)) / size
        step = np.linalg.lstsq(stacked, np.append(y * root, np.zeros(p)), rcond=1e-10)[0] / size
        left = np.abs(y - design @ step)
        scale = max(float(np.median(left)) / 0.6745, 1.0)
        weight = np.minimum(1.0, 3.0 * scale / np.maximum(left, 1e-12)) / scale**2
    return np.asarray(step)
