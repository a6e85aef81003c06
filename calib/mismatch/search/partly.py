"""Whether an effect acts throughout, or in a part of the recording only.

A sensor's term acts in every pose and turn. What was there for a while (a magnet was near, a screw
had come loose, a filter was set anew) looks like a term of an averaged size, and its standard error
says nothing of that. So a finding that follows the motion is judged in every window of the
recording as well: what it does there, and nothing outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, softmax

from calib.effects import get_effect
from calib.mismatch.findings.diagnosis import Interval
from calib.mismatch.hypotheses.ends import expected_overlap, of_parts, of_place
from calib.mismatch.noise.noise import make_whitener
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, fitted, lasting
from calib.types import FloatArray, IntArray

SELDOM = 0.05
"""How probable it is that what looks like a term acts in a part only, rather than throughout."""

SURE = 20.0
"""Odds from which on it does."""

OUTSIDE = 0.25
"""Share of what it would do throughout that a part leaves out, at least: without one turn that
closes badly anything fits better."""

ROUNDED = 1e-12
"""Size of a direction, of the largest, that rounding leaves of none."""

STAYS = 1.0
"""How probable it is that it began, or ended, for good, to that it did both."""

IN_A_PART = "in a part of the recording"

_IN_TIME = ("power-on", "temperature", "variance")
"""What follows these has a course of its own in time."""

_TURNS = "time since the last turn"
"""What follows this has another shape beside its size, and yet the same after each turn."""


class Part(NamedTuple):
    """When an effect acts, and how many times less probable it is that it does throughout."""

    interval: Interval
    odds: float


def acting_part(
    rows: Rows,
    accepted: Sequence[Accepted],
    which: int,
    levels: FloatArray,
    contrast: FloatArray,
) -> Part | None:
    """Return the part of the recording in which one finding acts, if it does not throughout.

    The rows have the part of every finding in them.
    """
    own = accepted[which]
    if not lasting(own.candidate):
        return None
    effect = get_effect(own.candidate.name)
    if effect.kind != "sensor" or any(word in effect.follows for word in _IN_TIME):
        return None
    if own.candidate.shape and not (own.candidate.present or effect.follows == _TURNS):
        return None
    others = [a for i, a in enumerate(accepted) if i != which]
    whitener = make_whitener(rows, levels, contrast, fitted(rows, others))
    y = whitener.project(rows.residual)
    number = len(rows.interval)
    directions, mixing = _few(own.columns, rows.segment, number)
    gram, match = _products(whitener.project(directions), y, mixing)
    share = np.append(0.0, np.cumsum(np.einsum("ikik->i", gram)))
    first, last = np.triu_indices(number + 1, 1)
    some = share[-1] - (share[last] - share[first]) >= OUTSIDE * share[-1]
    whole = (first == 0) & (last == number)
    if not some.any():
        return None
    value = of_parts(gram, match, first[some | whole], last[some | whole])
    all_of_it = float(value[whole[some | whole]][0])
    first, last, value = first[some], last[some], value[some[some | whole]]
    weight = value + of_place(first, last, number, STAYS)
    ahead = float(logsumexp(weight)) + float(np.log(SELDOM)) - all_of_it
    if ahead < np.log(SURE):
        return None
    where = expected_overlap(rows.interval[first, 0], rows.interval[last - 1, 1], softmax(weight))
    return Part(where, float(np.exp(min(ahead, 700.0))))


def _few(columns: FloatArray, segment: IntArray, number: int) -> tuple[FloatArray, FloatArray]:
    """Return (m, k) columns in each of so many segments by r directions of the rows there.

    That is (m, number * r) directions and (number, r, k) combinations of them. A segment has few
    rows, and a rest knows one direction of gravity: the more parameters, the fewer are these.
    """
    order = np.argsort(segment, kind="stable")
    count = np.bincount(segment, minlength=number)
    place = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    own = np.zeros((number, int(count.max()), columns.shape[1]))
    own[segment[order], place] = columns[order]
    left, size, right = np.linalg.svd(own, full_matrices=False)
    r = int((size > ROUNDED * size[:, :1]).sum(axis=1).max())
    directions = np.zeros((len(order), number, r))
    directions[order, segment[order]] = left[segment[order], place, :r]
    return directions.reshape(len(order), -1), size[:, :r, None] * right[:, :r]


def _products(
    white: FloatArray, y: FloatArray, mixing: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the products (n, k, n, k) of (n, r, k) combinations of columns, and with y (n, k)."""
    n, r, k = mixing.shape
    half = np.swapaxes(mixing, 1, 2) @ (white.T @ white).reshape(n, r, n * r)
    gram = half.reshape(n * k, n, r).transpose(1, 0, 2) @ mixing
    match = np.einsum("nrk,nr->nk", mixing, (y @ white).reshape(n, r))
    return gram.reshape(n, n, k, k).transpose(1, 2, 0, 3), match
