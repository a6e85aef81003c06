"""Whether samples resolve the turns they are integrated over.

Between samples a rate is taken as a cubic. What that misses of a turn is, to the first order,
``11/720`` of the fourth differences, and to the next ``191/60480`` of the sixth: terms of a series
that a hand which trembles near half the sample rate does not let converge. What it then comes to
looks like a low-pass of both triads, which likewise takes the fast part of all signals.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.rows.rows import Rows
from calib.types import FloatArray, IntArray

TERMS = ((11 / 720, (1, -4, 6, -4, 1)), (-191 / 60480, (1, -6, 15, -20, 15, -6, 1)))
"""What the integral of a cubic through its neighbours misses per sample, of central differences."""

SLOWEST = 0.95
"""Ratio of one term of the series to the one before, at most: its sum is twenty terms."""

SHOWN = 9.0
"""Power of what is missed after the first term, in units of noise, from which it shows: three
standard errors."""

ROUNDING = 1e-9
"""Share of a variance that is left at least where most of it is taken off."""


def are_resolved(rows: Rows) -> bool:
    """Return whether what samples miss of most turns is too little to show.

    The first term is part of the noise. By how much the second is smaller says what is left of a
    geometric series: that of most turns, as single jolts are in the noise of their own turns.
    """
    turns = rows.turns
    if not len(turns.index):
        return True
    points = np.flatnonzero(np.isin(rows.point_segment, rows.segment[turns.index[:, 0]]))
    missed = np.zeros((len(TERMS), *turns.index.shape))
    everywhere = np.zeros((len(rows.state.time), 3))
    for k, (factor, weights) in enumerate(TERMS):
        everywhere[points] = factor * _differences(turns.rate, weights, turns.spans.first)
        column = sum(f @ everywhere[:, c] for c, f in enumerate(rows.functional[3:]))
        missed[k] = np.asarray(column)[turns.index]
    # The first term is in the noise already.
    whole = np.diag(rows.white)[turns.index]
    noise = np.maximum(whole - np.square(missed[0]), ROUNDING * whole + 1e-100)
    power = (np.square(missed) / noise).sum(axis=2)
    # White noise has differences as well.
    own = [factor**2 * np.square(weights).sum() for factor, weights in TERMS]
    first, second = np.median(power, axis=1) - turns.index.shape[1] * np.array(own)
    if first <= 0 or second <= 0:
        return True
    ratio = min(float(np.sqrt(second / first)), SLOWEST)
    return bool(len(turns.index) * first * (ratio / (1.0 - ratio)) ** 2 < SHOWN)


def _differences(values: FloatArray, weights: tuple[int, ...], first: IntArray) -> FloatArray:
    """Return central differences of (n, 3) values within turns; none beside their ends."""
    reach, n = len(weights) // 2, len(values)
    out = np.zeros_like(values)
    for k, weight in enumerate(weights):
        out[reach : n - reach] += weight * values[k : n - 2 * reach + k]
    place = np.arange(n)
    turn = np.searchsorted(first, place, side="right")
    edge = np.minimum(place - first[turn - 1], first[turn] - 1 - place) < reach
    out[edge] = 0.0
    return out
