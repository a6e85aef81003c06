"""Turns that do not close as all the others do: something happened in them.

A sample that was misread, a channel that stood still for a moment, a touch that a gyroscope felt:
one turn ends where it did not lead. As noise of all turns it would hide what else there is, and no
term of a sensor is told by one turn. So the turn that is furthest off is foretold by all else, and
compared with the others; then the next, without it:

    F = mean of d' inv(C) d over its closures,    d = what it is off by beside a fit without it,
                                                  C = its covariance, times what the median turn has

C never is less than what is expected of closures by themselves. Turns are not alike: a hand jolts,
and some are set down harder. By how much their variances differ has as many degrees of freedom as
turns of real logs have, and F follows Snedecor's law. Deleting rows is adding a column for each of
them [1]_.

Where one reading of one channel, off by any amount at any moment of the turn, leaves next to
nothing of its five closures, that is where it happened.

References
----------
.. [1] Cook, Weisberg, "Residuals and Influence in Regression", 1982, sec. 2.2.2 (the mean shift
   outlier model).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, comb, fdtrc

from calib.mismatch.findings.diagnosis import Interval, Unexplained
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import (
    bare_levels,
    estimate_levels,
    expected_levels,
    make_whitener,
)
from calib.mismatch.rows.rows import SAMPLING, Rows
from calib.mismatch.search.accepted import Accepted, fitted
from calib.mismatch.search.search import Outcome
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

CLAIM = 5e-3
"""Family-wise p-value below which a turn is said not to close."""

ALIKE = 12.0
"""Degrees of freedom of the variances of turns. 513 turns of 27 public logs, of hands and of
shocks, are most probable with 15 to 20; with 12 less so by two nats, and one may be off by more."""

UNTOLD = 5.0
"""Times its own error by which all else fails to foretell a turn, from which it is not judged."""

FEWEST = 6
"""Turns that one is compared with, at least."""

FEW, MOST = 0.25, 0.5
"""Share of the turns that may be odd, wherever they are, and where they follow each other: of more,
they are alike."""

TOGETHER, SELDOM = 3, 0.05
"""Odd turns that are said as one, at least, where so few would be as near each other by chance."""

LEFT, NEAR = float(chdtri(3.0, 1e-3)), float(chdtri(2.0, 0.01))
"""What may be left of a turn's closures, squared, beside one reading at one moment, if that is what
happened; and by how much more other moments and channels leave that may be it as well."""

CURVED = 0.01
"""A share that may be left, or be more, in any case: what is off by degrees is no longer linear in
a reading."""


class OddTurn(NamedTuple):
    """A turn that does not close: its segment, by how much in words, and what is said of it."""

    segment: int
    size: str
    said: Unexplained


def close_badly_in_a_row(rows: Rows) -> bool:
    """Whether turns that follow each other do not close as the others do, beside nothing at all.

    A channel that is late in a few would explain most of that, whatever it comes from.
    """
    levels = bare_levels(rows).values
    bare = Outcome(rows, (), levels, contrast_variance(rows), 0.0, frozenset())
    odd = odd_turns(bare)
    # Those are said as one.
    return len({turn.said for turn in odd}) < len(odd)


def odd_turns(outcome: Outcome) -> list[OddTurn]:
    """Return the turns that do not close as the others do, beside all that a search found.

    None beside what is unexplained elsewhere: it may be what they do not close by.
    """
    rows, levels = outcome.rows, outcome.levels
    ends = rows.ends
    number = len(ends)
    elsewhere = [a for a in outcome.accepted if not (a.candidate.physical or _of_one_turn(rows, a))]
    if number < FEWEST or elsewhere:
        return []
    columns = np.zeros((len(rows.residual), number, 5))
    columns[ends, np.arange(number)[:, None], np.arange(5)] = 1.0
    mean = fitted(rows, [a for a in outcome.accepted if not _of_one_turn(rows, a)])
    out: list[OddTurn] = []
    left = np.ones(number, bool)
    while True:
        # Noise that was estimated takes it up, the more where it is expected to.
        usual = _usual(rows, levels)
        every = _Foretold.of(rows, usual, outcome.contrast, mean, columns[:, left])
        k = int(np.flatnonzero(left)[np.argmax(every.statistic)])
        beside = np.hstack((mean, columns[:, k]))
        levels = estimate_levels(rows, beside, levels).values
        left[k] = False
        others = _Foretold.of(rows, levels, outcome.contrast, beside, columns[:, left])
        own = _Foretold.of(rows, levels, outcome.contrast, mean, columns[:, [k]], others.scale)
        p_value = number * float(fdtrc(5.0, ALIKE, own.statistic[0]))
        if p_value >= CLAIM:
            return _gathered(rows, out)
        out.append(_odd(rows, ends[k], own.off[0], own.sigma[0], p_value))
        if len(out) > MOST * number:
            return []
        mean = beside


def _gathered(rows: Rows, odd: list[OddTurn]) -> list[OddTurn]:
    """Return odd turns, those that follow each other as one; none of many that are anywhere.

    Of n turns k lie within w that follow each other, at any place, with the probability
    ``(n - w + 1) C(w, k) / C(n, k)`` if nothing brings them together.
    """
    turns = rows.segment[rows.ends[:, 0]]
    number, k = len(turns), len(odd)
    order = sorted(odd, key=lambda turn: turn.segment)
    at = np.searchsorted(turns, [turn.segment for turn in order])
    width = int(np.ptp(at)) + 1 if k else 0
    chance = (number - width + 1) * comb(width, k) / comb(number, k)
    many = k > FEW * number
    if k < TOGETHER or chance >= (CLAIM if many else SELDOM):
        return [] if many else odd
    start, stop = (
        float(rows.interval[turn.segment, i])
        for turn, i in zip(order[:: k - 1], (0, 1), strict=True)
    )
    worst = min(order, key=lambda turn: turn.said.p_value)
    channels = tuple(c for c in CHANNELS if any(c in turn.said.channels for turn in order))
    follows = f"these {k} turns: they do not close, by up to {worst.size}, and the others do"
    said = Unexplained(channels, ((start, stop),), follows, worst.said.p_value * chance)
    return [turn._replace(said=said) for turn in order]


class _Foretold(NamedTuple):
    """By how much each of k turns is off what all else foretells, in closures (k, 5).

    With standard errors, the statistic of each (k,), and the scales of attitudes and velocities.
    """

    off: FloatArray
    sigma: FloatArray
    statistic: FloatArray
    scale: FloatArray

    @classmethod
    def of(
        cls,
        rows: Rows,
        levels: FloatArray,
        contrast: FloatArray,
        mean: FloatArray,
        columns: FloatArray,
        scale: FloatArray | None = None,
    ) -> _Foretold:
        """Return this of turns with the ``columns`` (m, k, 5); their own scales, if not given."""
        whitener = make_whitener(rows, levels, contrast, mean)
        # They are on rows of turns alone, and so they are once they are whitened.
        turns = rows.touched(())
        here = whitener.restricted(turns)
        own = here.whiten(columns[turns].reshape(len(turns), -1))
        white = -whitener.basis @ (here.basis.T @ own)
        white[turns] += own
        white = white.reshape(columns.shape)
        covariance = np.linalg.pinv(np.einsum("mki,mkj->kij", white, white), hermitian=True)
        match = np.einsum("mki,m->ki", white, whitener.project(rows.residual))
        off = np.einsum("kij,kj->ki", covariance, match)
        parts = [_size(off[:, at], covariance[:, at, at]) for at in (slice(0, 2), slice(2, 5))]
        if scale is None:
            scale = _scales(rows, levels, parts)
        statistic = (2.0 * parts[0] / scale[0] + 3.0 * parts[1] / scale[1]) / 5.0
        square = np.maximum(np.einsum("kii->ki", covariance), np.finfo(float).tiny)
        alone = np.einsum("mki,m->ki", columns[: rows.n_dense], rows.variance(levels))
        statistic[(square > UNTOLD**2 * alone).any(axis=1)] = 0.0
        sigma = np.sqrt(square * np.repeat(scale, (2, 3)))
        return cls(off, sigma, statistic, scale)


def _scales(rows: Rows, levels: FloatArray, parts: list[FloatArray]) -> FloatArray:
    """Return by how much the variances of attitudes and velocities are larger than said, (2,).

    That is of the median turn, by its mean squares in each of the ``parts``; and by no less than
    what is expected of closures by themselves is of what the levels make of them.
    """
    least = (rows.variance(_usual(rows, levels)) / rows.variance(levels))[rows.ends]
    own = (least[:, :2], least[:, 2:])
    return np.array(
        [
            max(float(np.median(part)) * n / float(chdtri(n, 0.5)), float(np.median(floor)))
            for part, n, floor in zip(parts, (2.0, 3.0), own, strict=True)
        ]
    )


def _size(off: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the mean square of (k, n) numbers in their standard errors, (k,)."""
    inverse = np.linalg.pinv(covariance, hermitian=True)
    return np.asarray(np.einsum("ki,kij,kj->k", off, inverse, off) / off.shape[1])


def _of_one_turn(rows: Rows, a: Accepted) -> bool:
    """Whether something without a name is in one turn alone."""
    where = a.candidate.interval
    if a.candidate.physical or where is None:
        return False
    inside = (rows.interval[:, 0] < where[1]) & (rows.interval[:, 1] > where[0])
    return int(inside.sum()) == 1 and not rows.is_rest[inside].any()


def _usual(rows: Rows, levels: FloatArray) -> FloatArray:
    """Return levels at which closures have of their own what is expected of them."""
    own = np.array(
        [
            c.name.split(" ")[0] in ("attitude", "velocity") or c.name.endswith(SAMPLING)
            for c in rows.components
        ]
    )
    return np.where(own, expected_levels(rows), levels)


def _odd(
    rows: Rows, index: IntArray, off: FloatArray, sigma: FloatArray, p_value: float
) -> OddTurn:
    """Return what is said of one turn, with the rows ``index`` (5,), that is ``off`` by so much."""
    segment = int(rows.segment[index[0]])
    angle, speed = float(np.linalg.norm(off[:2])), float(np.linalg.norm(off[2:]))
    turned = angle > 3.0 * float(np.linalg.norm(sigma[:2]))
    size = f"{np.degrees(angle):.2g}°" if turned else f"{speed:.2g} m/s"
    channels, interval = _at(rows, segment, index, off / sigma, sigma, turned=turned)
    follows = f"this one turn: it does not close, by {size}, and the others do"
    return OddTurn(segment, size, Unexplained(channels, (interval,), follows, p_value))


def _at(
    rows: Rows,
    segment: int,
    index: IntArray,
    off: FloatArray,
    sigma: FloatArray,
    *,
    turned: bool,
) -> tuple[tuple[str, ...], Interval]:
    """Return the channels, and the time, of one wrong reading that makes a turn be ``off``."""
    points = np.flatnonzero(rows.point_segment == segment)
    time = rows.state.time[points]
    start, stop = rows.interval[segment].tolist()
    square = float(off @ off)
    seen = [f[index][:, points].toarray() / sigma[:, None] for f in rows.functional]
    beside = [
        square - np.square(off @ own) / np.maximum(np.square(own).sum(axis=0), 1e-300)
        for own in seen
    ]
    best = min(float(own.min()) for own in beside)
    if not best <= max(LEFT, CURVED * square):
        return (CHANNELS[3:] if turned else CHANNELS), (start, stop)
    most = best + max(NEAR, CURVED * square)
    felt = {c: time[o <= most] for c, o in zip(CHANNELS, beside, strict=True) if o.min() <= most}
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    first = min(float(t[0]) for t in felt.values())
    last = max(float(t[-1]) for t in felt.values())
    return tuple(felt), (max(first - 0.5 * step, start), min(last + 0.5 * step, stop))
