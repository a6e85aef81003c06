"""Where a disturbance begins and ends: the window that is expected to overlap it most.

What rows say of the ends of a window is often little: a gain on one axis shows only where that axis
is loaded, and what comes and goes may be quiet for a while. The most probable window may then be
far from most of those that are as good. So every window is weighted by its evidence, and the one is
said whose overlap with the others, intersection over union, is largest on average.

The evidence takes what disturbs for normal, and stationary. Pulses are not: a few stand out, the
others hardly show, and the window of those that do would be told with far too much confidence. So
evidence for where a disturbance of one kind is counts for as much less as it scatters more than
normal errors would let it.

Nor is the evidence that of one kind alone. A part of what jumps about looks like a bias, or like a
wave, whose window is too short: in each window all kinds are weighed against each other. And a bias
that is found may be the largest pulse of many.

References
----------
.. [1] Pauli, Racugno, Ventura, "Bayesian composite marginal likelihoods", Statistica Sinica 21,
   2011, p. 149 (a power of the likelihood whose posterior is as wide as its maximum scatters).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, softmax

from calib.mismatch.findings.diagnosis import Interval
from calib.mismatch.hypotheses.candidates import (
    DELAY,
    FLUCTUATING,
    GAIN,
    GAIN_IN_TIME,
    Candidate,
)
from calib.mismatch.hypotheses.factors import log_bayes_factor, log_bayes_factors
from calib.mismatch.hypotheses.shared import likely_share
from calib.mismatch.hypotheses.slipped import place_slip
from calib.mismatch.hypotheses.turned import turned_parts
from calib.mismatch.hypotheses.wander import wandering
from calib.mismatch.hypotheses.windows import (
    FLUCTUATION,
    RAMP,
    SLIPPED,
    TURNED,
    fluctuating,
    make_slots,
    moved_window,
    segment_columns,
    slot_columns,
    window_columns,
)
from calib.mismatch.noise.noise import Whitener
from calib.mismatch.rows.rows import Rows
from calib.types import FloatArray, IntArray

UNLIKELY = 1e-3
"""Windows less probable than the best by this factor are left out."""

BLOCK = 256
"""Intervals whose overlaps with all others are in memory at once."""

HEAVY = 2.0 / 7.0
"""The power of the evidence for where a disturbance is [1]_. Squares, for a mean of one, have a
variance of 2 if what disturbs is normal; of 5 if it is as often small, and large, as Laplace's law
says, as the heights of pulses are; and of 7 if one segment in four has none besides."""

FAILING = 2.0 / 11.0
"""The same of what comes and goes, where every other segment has none: contacts and supplies."""

STAYS = 0.25
"""How probable it is that a gain changes for good, to that it does in a window: of `rivals`, too,
those have four times the weight."""

LASTING = (0.5, 2.0, 8.0)
"""How long what wanders keeps its value, in typical segments; or it has another in each."""

AT_ONCE = 1e-3
"""How long it does then."""

PERIODS = np.geomspace(0.6, 1.0 / 0.6, 7)
"""Periods that a wave in a window may have, relative to that of the window it was found in."""

TUNES = 21
"""Periods between those of the grid, half a cycle apart, that are tried for a wave."""


class Told(NamedTuple):
    """What rows tell under some noise, and the log-likelihood of that beside the others."""

    whitener: Whitener
    y: FloatArray
    """Whitened projected residual (m,)."""
    likelihood: float = 0.0


def place_window(rows: Rows, candidate: Candidate, *told: Told) -> Candidate:
    """Return a candidate for the window that overlaps most, on average over what is probable.

    It is of the kind that is most probable there. What is probable is what rows tell under any of
    several levels of noise; turned axes go by the first. No window is longer than half of the
    recording: the others are the rule there, and not it. A gain may have changed at a moment:
    beside the scale factor one until then is another one from then on, and it is said of the
    shorter part.
    """
    whitener, y, _ = told[0]
    if candidate.name == SLIPPED:
        return _place_slipped(rows, candidate, whitener, y)
    if candidate.name == TURNED:
        return _place_turned(rows, candidate, whitener, y)
    if candidate.name == GAIN_IN_TIME:
        candidate = replace(candidate, name=GAIN)
    number = len(rows.interval)
    longest = max(number // 2, 1)
    one = len(candidate.channels) == 1
    kinds = [] if candidate.name == FLUCTUATING else _retuned(candidate)
    kinds += [replace(candidate, name=n, shape={}) for n in _SUMS if one and n != candidate.name]
    alike = Counter(c.name for c in kinds)
    share = _share(rows, candidate, whitener, y)
    comes = [_wanders, _recurs] if _may_recur(rows, candidate, longest) else [_wanders]
    under = [
        np.stack(
            [_sums(rows, c, t, longest) - np.log(alike[c.name]) for c in kinds]
            + [f(rows, candidate, t, longest, share) for f in comes]
        )
        + t.likelihood
        for t in told
    ]
    every = np.logaddexp.reduce(under)
    first, last = np.nonzero(np.isfinite(every).any(axis=0))
    value = every[:, first, last]
    stays = [*(STAYS * _may_stay(c) for c in kinds), *[0.0] * len(comes)]
    prior = np.stack([of_place(first, last, number, odds) for odds in stays])
    of_kind = softmax(logsumexp(value + prior, axis=1))
    power = np.array([HEAVY] * len(kinds) + [FAILING] * len(comes))
    weight = of_kind @ softmax(power[:, None] * value + prior, axis=1)
    where = expected_overlap(rows.interval[first, 0], rows.interval[last - 1, 1], weight)
    a = int(np.searchsorted(rows.interval[:, 0], where[0]))
    b = int(np.searchsorted(rows.interval[:, 1], where[1])) + 1
    best = int(np.argmax(every[:, a, b]))
    if best >= len(kinds):
        return fluctuating(candidate, *where, segments=b - a, share=share)
    return moved_window(kinds[best], *where)


def _retuned(candidate: Candidate) -> list[Candidate]:
    """Return a candidate; a wave with periods around its own: it had that of a part of it."""
    if "period" not in candidate.shape:
        return [candidate]
    period = candidate.shape["period"]
    return [replace(candidate, shape={"period": period * k}) for k in PERIODS]


_SUMS = ("bias in a window", GAIN)


def _sums(rows: Rows, candidate: Candidate, told: Told, longest: int) -> FloatArray:
    """Return log B in each window [a, b) of what is a sum over the segments in it."""
    parts = segment_columns(rows, candidate)
    number = parts.shape[1]
    first, last = np.triu_indices(number + 1, 1)
    some = last - first <= longest
    if candidate.name == "bias in a window":
        # Open at one end it would be a step, which has a name.
        some &= (first > 0) & (last < number)
    first, last = first[some], last[some]
    out = np.full((number + 1, number + 1), -np.inf)
    white = told.whitener.project(parts.reshape(len(parts), -1)).reshape(parts.shape)
    out[first, last] = of_windows(white, told.y, first, last)
    return out


def of_place(first: IntArray, last: IntArray, number: int, stays: float) -> FloatArray:
    """Return the logarithm of how probable windows [first, last) of so many segments are.

    Every length, by its logarithm, is as likely as any other, and so is every place. That it
    changed at any moment, for good, has the odds ``stays`` to all windows that end.
    """
    prior = -np.log(last - first) - np.log(number + 1.0 - (last - first))
    open_ = (first == 0) | (last == number)
    if stays and open_.any() and not open_.all():
        prior[open_] = logsumexp(prior[~open_]) + np.log(stays / open_.sum())
    return np.asarray(prior)


def _may_stay(candidate: Candidate) -> bool:
    """Whether it may have changed at a moment for good: a bias that did is a step by name."""
    return candidate.name in (GAIN, DELAY) and not candidate.shape


def of_windows(white: FloatArray, y: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return log B of windows ``[first, last)``, the sums of (m, n, k) columns over their parts.

    Columns and residuals y (m,) are whitened, and have the baseline projected out.
    """
    m, number, k = white.shape
    white = white.reshape(m, -1)
    gram, match = (white.T @ white).reshape(number, k, number, k), (y @ white).reshape(number, k)
    return of_parts(gram, match, first, last)


def of_parts(gram: FloatArray, match: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return what `of_windows` does, from products (n, k, n, k) of columns, and with y (n, k)."""
    number, k = match.shape
    total = np.zeros((number + 1, number + 1, k, k))
    total[1:, 1:] = gram.transpose(0, 2, 1, 3).cumsum(axis=0).cumsum(axis=1)
    along = np.zeros((number + 1, k))
    along[1:] = match.cumsum(axis=0)
    inner = total[last, last] - total[first, last] - total[last, first] + total[first, first]
    return log_bayes_factors(inner, along[last] - along[first], np.zeros(len(inner), bool))


def _place_turned(rows: Rows, candidate: Candidate, whitener: Whitener, y: FloatArray) -> Candidate:
    """Return turned axes for the window that overlaps most, as `place_window` does.

    A window is no longer than half of the recording, but axes may stay turned for good; and what
    turns at a pace does. How far they are turned is one vector, and no sum of pulses: the evidence
    counts in full.
    """
    edges, parts = turned_parts(rows, candidate)
    number = len(edges) - 1
    first, last = np.triu_indices(number + 1, 1)
    stays = last == number
    some = (first > 0) & (stays | ((last - first <= number // 2) & (not candidate.shape)))
    first, last = first[some], last[some]
    white = whitener.project(parts.reshape(len(y), -1)).reshape(parts.shape)
    value = of_windows(white, y, first, last)
    weight = softmax(value + of_place(first, last, number, 1.0))
    where = expected_overlap(edges[first], edges[last], weight)
    return moved_window(candidate, *where)


def _place_slipped(
    rows: Rows, candidate: Candidate, whitener: Whitener, y: FloatArray
) -> Candidate:
    """Return a slip for the window that overlaps most, and at its very moments.

    What went on at a pace, as far as rows tell that are linear in it, may be a larger one at once.
    """
    plain = _place_turned(rows, replace(candidate, shape={}), whitener, y)
    plain, value = place_slip(rows, plain, whitener, y)
    if not RAMP.keys() <= candidate.shape.keys():
        return plain
    paced = _place_turned(rows, candidate, whitener, y)
    other = log_bayes_factor(whitener.project(window_columns(rows, paced)), y)
    return plain if value > other else paced


def _share(
    rows: Rows, candidate: Candidate, whitener: Whitener, y: FloatArray
) -> FloatArray | None:
    """Return the share that each axis of a triad has of one disturbance in a candidate's window.

    None where each seems to have one of its own, or is alone.
    """
    assert candidate.interval is not None
    if len(candidate.channels) == 1:
        return None
    start, stop = candidate.interval
    own = fluctuating(candidate, start, stop, segments=_inside(rows, candidate))
    return likely_share(whitener.project(window_columns(rows, own)), y)


def _wanders(
    rows: Rows, candidate: Candidate, told: Told, longest: int, share: FloatArray | None
) -> FloatArray:
    """Return log B in each window [a, b) of what wanders in it, of any correlation time.

    On every axis in a way of its own, but for what they have a ``share`` of. Of fewer segments than
    any fluctuation is tried in, nobody could say that it does.
    """
    typical = float(np.median(np.ptp(rows.interval, axis=1)))
    many = len(candidate.channels) > 1 and share is None
    found = []
    for coarse, lasting in ((many, LASTING), (True, (AT_ONCE,))):
        slots = make_slots(rows, coarse=coarse)
        parts = slot_columns(rows, slots, candidate.channels)
        if share is not None:
            parts = (parts @ share)[:, :, None]
        m, n, c = parts.shape
        white = told.whitener.project(parts.reshape(m, -1))
        gram, match = (white.T @ white).reshape(n, c, n, c), (told.y @ white).reshape(n, c)
        found += [
            wandering(
                gram, match, slots.middle, slots.first, correlation=k * typical, longest=longest
            )
            for k in lasting
        ]
    value = np.logaddexp.reduce(found) - np.log(len(found))
    first, last = np.indices(value.shape)
    return np.where(last - first < min(FLUCTUATION, longest), -np.inf, value)


def _may_recur(rows: Rows, candidate: Candidate, longest: int) -> bool:
    """Whether what was found may be one of many pulses: a bias, with room for more around it.

    Windows of a second, as beside a truth, show pulses one by one. A rest has several, and one that
    was pushed is a thing of its own.
    """
    plain = candidate.name == "bias in a window" and not candidate.shape
    room = max(_inside(rows, candidate), FLUCTUATION) <= longest
    return plain and room and not rows.is_rest.any()


def _inside(rows: Rows, candidate: Candidate) -> int:
    """Return how many segments a candidate's window reaches into."""
    assert candidate.interval is not None
    start, stop = candidate.interval
    return int(((rows.interval[:, 0] < stop) & (rows.interval[:, 1] > start)).sum())


def _recurs(
    rows: Rows, candidate: Candidate, told: Told, longest: int, share: FloatArray | None
) -> FloatArray:
    """Return log B in each window [a, b) of what was found as the largest of many pulses in it.

    A few of these are as large as all others together, and what is found is one of them, anywhere
    in the window. Beside it, as large as it likes, the others are what wanders.
    """
    assert candidate.interval is not None
    whitener, y, _ = told
    own = whitener.project(window_columns(rows, candidate))
    along = np.linalg.qr(own)[0]
    whitener = replace(whitener, basis=np.hstack((whitener.basis, along)))
    left = Told(whitener, y - along @ (along.T @ y))
    value = _wanders(rows, candidate, left, longest, share) + log_bayes_factor(own, y)
    start, stop = candidate.interval
    first, last = np.indices(value.shape)
    early = np.append(rows.interval[:, 0], np.inf)[first] <= start
    late = np.append(-np.inf, rows.interval[:, 1])[last] >= stop
    inside = _inside(rows, candidate)
    places = np.log(inside) + np.log(np.maximum(last - first + 1 - inside, 1))
    return np.where(early & late, value - places, -np.inf)


def tune_wave(
    rows: Rows, candidate: Candidate, whitener: Whitener, y: FloatArray
) -> tuple[Candidate, FloatArray]:
    """Return a wave throughout, and its columns, of that period near its own that fits most."""
    start, stop = float(rows.interval[0, 0]), float(rows.interval[-1, 1])
    cycles = (stop - start) / candidate.shape["period"]
    best: tuple[float, Candidate, FloatArray] | None = None
    for tried in cycles + np.linspace(-0.5, 0.5, TUNES):
        there = replace(candidate, shape={"period": (stop - start) / max(tried, 0.25)})
        columns = window_columns(rows, replace(there, interval=(start, stop)))
        value = log_bayes_factor(whitener.project(columns), y)
        if best is None or value > best[0]:
            best = value, there, columns
    assert best is not None
    return best[1], best[2]


def expected_overlap(start: FloatArray, stop: FloatArray, weight: FloatArray) -> Interval:
    """Return the one of (n,) intervals that overlaps most, on average over their weights."""
    probable = weight > UNLIKELY * weight.max()
    start, stop, weight = start[probable], stop[probable], weight[probable]
    overlap = np.empty(len(weight))
    for at in range(0, len(weight), BLOCK):
        a, b = start[at : at + BLOCK], stop[at : at + BLOCK]
        common = np.minimum.outer(b, stop) - np.maximum.outer(a, start)
        hull = np.maximum.outer(b, stop) - np.minimum.outer(a, start)
        overlap[at : at + BLOCK] = np.maximum(common, 0.0) / hull @ weight
    best = int(np.argmax(overlap))
    return float(start[best]), float(stop[best])
