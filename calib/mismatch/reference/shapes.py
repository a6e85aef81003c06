"""Windows of the differences between a recording and a truth, and the shapes that count in each.

Effects have more columns than a window needs: a few orthogonal shapes span most of them there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from calib.errors import NoCommonMotionError
from calib.mismatch.reference.colour import Blur
from calib.mismatch.reference.flicker import Slow, flicker_levels, flicker_of, slow_left
from calib.mismatch.reference.scatter import Scatter
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

SEGMENTS = 80
"""Windows that a recording is cut into, at most."""

SHORTEST, FEWEST = 1.0, 12
"""s and points of a window, at least."""

TORN = (
    "what the two have in common is torn by gaps: no stretch is free of them for long enough to be "
    f"compared, expected {FEWEST} samples in a row or more"
)

SHAPES = 1200
"""Rows that follow a shape within a window, at most: those that tell most are kept."""

ENOUGH = 20.0
"""Standard errors to which a column counts at most, all windows together, in what shapes tell: what
is plain without its weaker shapes leaves them to effects that hardly show."""

VISIBLE = 0.1
"""A shape that effects of typical size reach by less than this, in standard errors, is no row."""

LEAST_FREE = 0.3
"""Share of a window's independent samples that tell of its noise at least: weak shapes that are
much alike take up fewer of them than there are shapes."""

SLIGHT = 0.4
"""Share of a mean that a shape of its window may have in common with it."""

BEYOND = 3.0
"""Standard errors by which the noise of one window must be above that of most to be its own."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """Windows ``[first, last)`` of points, and the shapes (unit vectors) that are rows there.

    ``noise`` (k, 6) is the variance of a window's points, its white part, and ``flicker`` what
    projections on the shapes have besides. Points are seen through the ``blur``. Where the noise is
    not the same throughout, ``scatter`` tells of every point but for a factor of each window, and
    the shapes are those of points in units of its root. Where the accelerometer is not judged
    everywhere, ``told`` (k,) says in which windows it is.
    """

    first: IntArray
    last: IntArray
    segment: IntArray
    channel: IntArray
    vectors: tuple[FloatArray, ...]
    noise: FloatArray
    flicker: FloatArray
    blur: Blur
    scatter: Scatter | None = None
    told: BoolArray | None = None

    @property
    def channels(self) -> IntArray:
        """The channel of each row: those of all means, and of the shapes."""
        return np.concatenate((np.tile(np.arange(6), len(self.first)), self.channel))

    @property
    def segments(self) -> IntArray:
        """The window of each row."""
        return np.concatenate((np.repeat(np.arange(len(self.first)), 6), self.segment))

    @cached_property
    def weights(self) -> tuple[tuple[sparse.csr_matrix, ...], FloatArray]:
        """What rows feel of the n points on each channel, (m, n), and of white noise, (m,)."""
        first, last, blur, scatter = self.first, self.last, self.blur, self.scatter
        channel, segment, count = self.channels, self.segments, last - first
        dense, m = 6 * len(first), len(channel)
        size = _sizes(scatter, blur)
        typical = np.sqrt(_of_windows(size, first, last))
        shape = m, len(blur.seen)
        functional: list[sparse.csr_matrix] = [None] * 6
        white = np.zeros(m)
        for c in range(6):
            own = np.flatnonzero(channel == c)
            many = count[segment[own]]
            points = np.concatenate([np.arange(first[s], last[s]) for s in segment[own]])
            relative = size[points, c] / np.repeat(typical[segment[own], c], many)
            mean = np.repeat(own < dense, many)
            values = np.repeat(1.0 / np.where(own < dense, many, np.sqrt(many)), many) / relative
            values[mean] /= relative[mean]
            vectors = [self.vectors[i] for i in own[own >= dense] - dense]
            values[~mean] *= np.concatenate((np.zeros(0), *vectors))
            ends = np.zeros(m + 1, np.int64)
            ends[own + 1] = many
            seen = sparse.csr_matrix((values, points, np.cumsum(ends)), shape=shape)
            felt = blur.seen_by(self._in_one_frame(seen, c), c)
            for k, part in felt.items():
                functional[k] = part if functional[k] is None else functional[k] + part
            weight = seen if blur.whitens else felt[c]
            square = sparse.csr_matrix(
                (np.square(weight.data), weight.indices, weight.indptr), shape=weight.shape
            )
            if scatter is None:
                white += np.asarray(square.sum(axis=1)).ravel()
            else:
                variance = scatter.variance[blur.seen if blur.whitens else slice(None), c]
                white[own] = (square @ variance)[own] / np.square(typical[segment[own], c])
        return tuple(functional), white

    def _in_one_frame(self, seen: sparse.csr_matrix, channel: int) -> sparse.csr_matrix:
        """Return (m, n) weights on a channel, with means in the frame of the middle of each window.

        In one frame rates err by what captured angles err by at both ends of a window. In that of
        the body their errors in between count as well, times the rate, and do not come back.
        """
        first, last, blur = self.first, self.last, self.blur
        if blur.mat_ns is None or channel < 3:
            return seen
        dense = 6 * len(first)
        means = seen[channel:dense:6].tocoo()
        mat, middle = blur.mat_ns[blur.seen], (first + last) // 2
        turned = np.einsum("nji,nj->ni", mat[middle][means.row], mat[means.col, :, channel - 3])
        rows = 6 * means.row[:, None] + [3, 4, 5]
        entries = (means.data[:, None] * turned).ravel(), (rows.ravel(), np.repeat(means.col, 3))
        shapes = sparse.diags(1.0 * (np.arange(seen.shape[0]) >= dense)) @ seen
        return (shapes + sparse.csr_matrix(entries, shape=seen.shape)).tocsr()


def cut(
    time: FloatArray, judged: BoolArray | None = None, still: FloatArray | None = None
) -> tuple[IntArray, IntArray]:
    """Return windows ``[first, last)`` of equal length with at least `FEWEST` points each.

    Where the accelerometer is ``judged``, (n,) bool, in parts only, windows begin and end with
    these. None ends within a turn where a rest that is ``still``, (k, 2) s, begins or ends nearby.
    """
    if len(time) < FEWEST:
        raise NoCommonMotionError(TORN)
    span = time[-1] - time[0]
    # Of slow samples windows are longer.
    count = int(np.clip(min(span / SHORTEST, 0.8 * len(time) / FEWEST), 1, SEGMENTS))
    even = time[0] + span * np.arange(count + 1) / count
    half = 0.5 * even[1] - 0.5 * even[0]
    edges = np.searchsorted(time, even)
    edges[-1] = len(time)
    fixed = np.zeros(0, np.int64)
    if judged is not None:
        fixed = np.flatnonzero(np.diff(judged)) + 1
    elif still is not None and len(still):
        nearest = still.ravel()[np.abs(even[:, None] - still.ravel()).argmin(axis=1)]
        within = ((even[:, None] >= still[:, 0]) & (even[:, None] <= still[:, 1])).any(axis=1)
        fixed = np.unique(np.searchsorted(time, nearest[~within & (np.abs(nearest - even) < half)]))
        fixed = fixed[(np.diff(fixed, prepend=0) >= FEWEST) & (fixed < len(time))]
    if len(fixed):
        away = np.abs(even[:, None] - time[fixed]).min(axis=1)
        edges = np.unique(np.concatenate(([0, len(time)], fixed, edges[away > half])))
    keep = np.diff(edges) >= FEWEST
    if not keep.any():
        raise NoCommonMotionError(TORN)
    return edges[:-1][keep], edges[1:][keep]


def find_shapes(
    time: FloatArray,
    left: FloatArray,
    views: list[list[FloatArray]],
    *,
    blur: Blur,
    scatter: Scatter | None = None,
    still: FloatArray | None = None,
) -> Shapes:
    """Return windows, the shapes that columns have in each, and the noise of its samples.

    Parameters
    ----------
    time : (n,) array, s
    left : (n, 6) array
        Recording minus model.
    views : lists of (m,) arrays, of six channels
        Columns, as the blur sees them.
    blur : Blur
        Windows and shapes are of the m points that it leaves.
    scatter : Scatter, optional
        Without, points are as noisy throughout a window.
    still : (k, 2) array, optional
        As `cut` has it.
    """
    seen_at = time[blur.seen]
    first, last = cut(seen_at, blur.judged, still)
    judged = np.stack(
        [[blur.counts(c)[a:b].all() for c in range(6)] for a, b in zip(first, last, strict=True)]
    )
    noise, free = np.empty((len(first), 6)), np.empty((len(first), 6))
    size = _sizes(scatter, blur)
    seen_of = np.ones_like(size) if scatter is None else scatter.seen
    independent = np.repeat(blur.power, 3) * np.array(
        [seen_of[a:b].sum(axis=0) for a, b in zip(first, last, strict=True)]
    )
    judged &= independent >= 1.0  # all of a window may say nothing
    found: list[tuple[float, int, int, FloatArray]] = []
    slow: list[dict[int, Slow]] = [{} for _ in CHANNELS]
    left = blur.see(left)
    for c, mine in enumerate(views):
        # Window by window they stay near the processor.
        parts = [
            np.stack([values[a:b] for values in mine]) / size[a:b, c]
            for a, b in zip(first, last, strict=True)
        ]
        seen = left[:, c] / size[:, c]
        counts = blur.counts(c)
        beside = counts[2:] & counts[:-2]
        bend = np.abs(np.diff(seen, n=2))[beside if beside.any() else slice(None)]
        rough = float(np.median(bend)) / 0.6745 / np.sqrt(6.0)
        rough = max(rough, 1e-9)
        counted = _counted(parts, rough) if scatter is None else np.full(len(mine), 1.0 / rough)
        for s, (a, b, part) in enumerate(zip(first, last, parts, strict=True)):
            if not judged[s, c]:
                noise[s, c], free[s, c] = 0.0, 1.0
                continue
            mean = _means(blur, a, b, c) / size[a:b, c]
            mean = _strongest(mean)
            level = part @ mean.T
            values, vectors = np.linalg.eigh(part @ part.T - level @ level.T)
            values, mixing = np.maximum(values[::-1], 0.0), vectors.T[::-1]
            strength = np.sqrt(values) / rough
            keep = (strength > VISIBLE) & (strength > 1e-6 * strength[0])
            keep[max((b - a) // 3, 1) :] = False
            mixing = mixing[keep]
            shapes = mixing @ part - (mixing @ level) @ mean
            long = np.linalg.norm(shapes, axis=1, keepdims=True)
            shapes /= long
            y = seen[a:b] - (mean @ seen[a:b]) @ mean
            rest = y - (shapes @ y) @ shapes
            # So many of its samples are independent; the mean and the shapes take up one each.
            many = independent[s, c]
            free[s, c] = max(many - len(mean) - len(shapes), LEAST_FREE * many)
            noise[s, c] = float(rest @ rest) / free[s, c]
            tell = np.linalg.norm(values[keep, None] / long * mixing * counted, axis=1)
            found += [(float(v), s, c, x) for v, x in zip(tell, shapes, strict=True)]
            slow[c][s] = slow_left(rest, mean.T, shapes.T)
    noise = _levelled(noise, free, independent, blur.white, judged)
    strongest = sorted(found, key=lambda item: -item[0])[:SHAPES]
    strongest.sort(key=lambda item: (item[2], item[1]))
    segment = np.array([item[1] for item in strongest], np.int64)
    channel = np.array([item[2] for item in strongest], np.int64)
    kept = tuple(item[3] for item in strongest)
    interval = (seen_at[last - 1] - seen_at[first]) / (last - first - 1)
    level = flicker_levels(slow, noise, interval)
    flicker = level[channel] * flicker_of(kept)
    worth = _of_windows(size, first, last)
    return Shapes(
        first,
        last,
        segment,
        channel,
        kept,
        noise * worth,
        flicker * worth[segment, channel],
        blur,
        scatter,
        None if blur.judged is None else judged[:, 0],
    )


def _means(blur: Blur, first: int, last: int, channel: int) -> FloatArray:
    """Return what the means of a window are of its points on a channel, (k, n)."""
    if blur.mat_ns is None or channel < 3:
        return np.ones((1, last - first))
    mat = blur.mat_ns[blur.seen[first:last]]
    return np.asarray(mat[(last - first) // 2].T @ mat[:, :, channel - 3].T)


def _strongest(rows: FloatArray) -> FloatArray:
    """Return orthonormal rows (r, n) that span (k, n) ones but for what is `SLIGHT` of them."""
    if len(rows) == 1:
        return rows / np.linalg.norm(rows)
    _, values, vectors = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(vectors[values > SLIGHT * values[0]])


def _counted(parts: list[FloatArray], rough: float) -> FloatArray:
    """Return by how much each of k columns counts: all of them to `ENOUGH` at most.

    ``parts`` are (k, n) of each window, whose points are alike.
    """
    power = np.zeros(len(parts[0]))
    for part in parts:
        mean = np.ones(part.shape[1])
        mean /= np.linalg.norm(mean)
        power += np.einsum("kn,kn->k", part, part) - np.square(part @ mean)
    return np.asarray(ENOUGH / np.maximum(np.sqrt(np.maximum(power, 0.0)) / rough, ENOUGH) / rough)


def _sizes(scatter: Scatter | None, blur: Blur) -> FloatArray:
    """Return the root of how far the points that are seen scatter, (m, 6), the blur left aside."""
    if scatter is None:
        return np.ones((len(blur.seen), len(CHANNELS)))
    out = []
    for c in range(len(CHANNELS)):
        if blur.whitens:
            out.append(scatter.variance[blur.seen, c])
            continue
        square = blur.matrices[c // 3].power(2)
        total = np.asarray(square.sum(axis=1)).ravel()
        heard = square @ scatter.variance[:, c]
        # Of what is not judged nothing is seen.
        out.append(np.divide(heard, total, out=np.ones_like(heard), where=total > 0))
    return np.asarray(np.sqrt(np.stack(out, axis=1)))


def _of_windows(size: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the variance (k, 6) of points that tell as much as those of windows do."""
    worth = [np.square(1.0 / size[a:b]).mean(axis=0) for a, b in zip(first, last, strict=True)]
    return np.asarray(1.0 / np.array(worth))


def _levelled(
    noise: FloatArray,
    free: FloatArray,
    independent: FloatArray,
    white: tuple[float, float],
    judged: BoolArray,
) -> FloatArray:
    """Return the noise of windows (k, 6): that of most of them, or more where there is more.

    Where shapes take up most of a window, little of its noise is left to be seen. What is more is
    not of the colour of the rest: it is taken as white, of which the share ``white`` is seen. What
    was not ``judged`` (k, 6) says nothing.
    """
    out = np.ones_like(noise)
    for c in range(6):
        own = judged[:, c]
        if not own.any():
            continue
        told = own & (free[:, c] > 0.5 * independent[:, c])
        if told.sum() < 5:
            told = own & (free[:, c] >= np.quantile(free[own, c], 0.8))
        # The median of chi-squared is below its mean: Wilson and Hilferty's approximation.
        middle = (1.0 - 2.0 / (9.0 * np.maximum(free[told, c], 1.0))) ** 3
        most = max(float(np.median(noise[told, c] / middle)), 1e-18)
        beyond = noise[:, c] > most * (1.0 + BEYOND * np.sqrt(2.0 / free[:, c]))
        more = (noise[:, c] - most) / white[c // 3]
        out[:, c] = most + np.where(beyond, more, 0.0)
    return out
