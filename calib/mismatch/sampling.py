"""What samples do not resolve of a turn: a jolt between two of them goes into its closure.

A sample that its neighbours do not foretell was one of a signal that has more in it than they show,
and the integral over the turn errs there. An error of rate turns all that follows: attitude and
velocity of a turn err together, each by what the closure makes of a rate at that moment. So these
errors are not noise that each row has of its own, and turns with a jolt have large ones.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from calib.mismatch.closure import Closures, Spans, covariance_of_turns
from calib.mismatch.rows import Component
from calib.mismatch.sensornoise import SPREAD
from calib.types import FloatArray, IntArray

HALVED = 1 / 9
"""Variance of what sampling adds to a closure, relative to what every second sample changes: a rule
of the second order errs by a third of that."""

LEAST = 1e-3
"""Share of what samples are off their neighbours by that is taken to be unresolved, at least."""

_TILT, _SPEED = slice(0, 2), slice(2, 5)

UNFORETOLD = 35 / 18
"""Variance of white noise in `unforetold`, relative to its own."""


def unforetold(values: FloatArray, first: IntArray) -> FloatArray:
    """Return by how much points (n, k) are off the cubic through two neighbours on either side.

    Points ``[first[i], first[i + 1])`` are turn i's; its first and last two, at rest, are not off.
    """
    out = np.zeros_like(values)
    near, far = values[1:-3] + values[3:-1], values[:-4] + values[4:]
    out[2:-2] = values[2:-2] - (4 * near - far) / 6
    for k in (0, 1):
        out[np.maximum(first[1:] - 1 - k, 0)] = 0.0
        out[np.minimum(first[:-1] + k, len(out) - 1)] = 0.0
    return out


def sampling_components(
    closed: Closures,
    left: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    noise: FloatArray,
    spans: Spans,
    rows: IntArray,
    white: FloatArray,
) -> list[Component]:
    """Return what sampling adds to the closures of k turns, through the rate and the force.

    Parameters
    ----------
    closed : Closures
    left : (k, 5) array
        What every second sample changes of their residuals.
    force, rate : (n, 3) arrays
        At the points of all turns, as ``spans`` has them.
    noise : (n, 6) array
        Their white noise, as variances.
    rows : (k, 5) array of int
        Rows of the closures.
    white : (k, 5) array
        Variance of the closures by white noise.
    """
    if not len(rows):
        return []
    parts = [
        _added(unforetold(values, spans.first), weights, UNFORETOLD * own, spans)
        for values, weights, own in (
            (rate, closed.gyro_weights, noise[:, 3:]),
            (force, closed.accel_weights, noise[:, :3]),
        )
    ]
    by_rate, by_force = (np.einsum("kii->ki", part) for part in parts)
    square, both = np.square(left), by_rate + by_force
    shares = [_share(square[:, own], both[:, own], white[:, own]) for own in (_TILT, _SPEED)]
    out = []
    for label, part, share, own in (
        ("rate by sampling", parts[0], shares[0], slice(0, 5)),
        ("force by sampling", parts[1], shares[1], _SPEED),
    ):
        index = rows[:, own]
        turns, size = index.shape
        each = np.zeros((turns, size, turns, size))
        each[np.arange(turns), :, np.arange(turns)] = part[:, own, own]
        index, matrix = index.ravel(), each.reshape(turns * size, -1)
        response = sparse.identity(len(matrix), format="csr")
        out.append(Component(label, index, response, matrix, HALVED * share, SPREAD))
    return out


def _added(off: FloatArray, weights: FloatArray, noise: FloatArray, spans: Spans) -> FloatArray:
    """Return the covariance (k, 5, 5) of closures whose points err by `off` (n, 3), noise apart."""
    square = np.square(off)
    total = np.add.reduceat(square, spans.start)
    share = 1.0 - np.add.reduceat(noise, spans.start) / np.maximum(total, 1e-300)
    square *= np.maximum(share, 0.0)[spans.turn]
    return covariance_of_turns(weights, square, spans)


def _share(square: FloatArray, expected: FloatArray, white: FloatArray) -> float:
    """Return how much of what is expected every second sample changes, in most of the turns.

    In a turn with a lost sample, or a bump, it changes more, and that says nothing of the others.
    """
    square, expected, white = (x.sum(axis=1) for x in (square, expected, white))
    ratio = (square - white) / np.maximum(expected, 1e-300)
    order = np.argsort(ratio)
    # Turns without a jolt show white noise alone.
    weight = np.cumsum((expected / (expected + white))[order])
    return max(float(ratio[order][np.searchsorted(weight, 0.5 * weight[-1])]), LEAST)
