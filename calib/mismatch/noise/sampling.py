"""What samples do not resolve of a turn: a jolt between two of them goes into its closure.

A sample that its neighbours do not foretell was one of a signal that has more in it than they show,
and the integral over the turn errs there. An error of rate turns all that follows: attitude and
velocity of a turn err together, each by what the closure makes of a rate at that moment. So these
errors are not noise that each row has of its own, and turns with a jolt have large ones.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from calib.mismatch.noise.sensornoise import SPREAD
from calib.mismatch.rows.closure import Closures, Spans, covariance_of_turns
from calib.mismatch.rows.rows import Component
from calib.types import FloatArray, IntArray

HALVED = {"rate": 1 / 45, "force": 1 / 9}
"""Variance of what sampling adds to a closure, relative to what every second sample changes. Where
a signal has a corner, a rule errs by a third of that; where it is smooth, one of the fourth order
by a fifteenth. A knock bends the force at once; of the rate, which inertia smooths, it is the mean
of both."""

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
    parts, shares = _jolts(closed, left, force, rate, noise, spans, white)
    out = []
    for signal, part, share, own in (
        ("rate", parts[0], shares[0], slice(0, 5)),
        ("force", parts[1], shares[1], _SPEED),
    ):
        index = rows[:, own]
        turns, size = index.shape
        each = np.zeros((turns, size, turns, size))
        each[np.arange(turns), :, np.arange(turns)] = share[:, None, None] * part[:, own, own]
        index, matrix = index.ravel(), each.reshape(turns * size, -1)
        response = sparse.identity(len(matrix), format="csr")
        label, expected = f"{signal} by sampling", HALVED[signal]
        out.append(Component(label, index, response, matrix, expected, SPREAD))
    return out


def unresolved(
    closed: Closures,
    left: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    noise: FloatArray,
    spans: Spans,
) -> FloatArray:
    """Return the variance (k, 5) of closures by jolts, as `sampling_components` expect it."""
    white = np.zeros_like(left)
    for weights, own in (
        (closed.gyro_weights, noise[:, 3:]),
        (closed.accel_weights, noise[:, :3]),
    ):
        each = np.einsum("rnc,nc->nr", np.square(weights), own)
        white += np.add.reduceat(each, spans.start)
    (by_rate, by_force), shares = _jolts(closed, left, force, rate, noise, spans, white)
    out = np.einsum("kii->ki", HALVED["rate"] * by_rate + HALVED["force"] * by_force)
    for some, share in zip((_TILT, _SPEED), shares, strict=True):
        out[:, some] *= share[:, None]
    return np.asarray(out)


def _jolts(
    closed: Closures,
    left: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    noise: FloatArray,
    spans: Spans,
    white: FloatArray,
) -> tuple[tuple[FloatArray, FloatArray], list[FloatArray]]:
    """Return what jolts add to closures, and how much of it counts.

    The one is covariances (k, 5, 5) by what samples are off, of the rate and of the force; the
    other shares (k,) of them that show in what every second sample changes, of angles and of
    velocities.
    """
    parts = (
        _added(unforetold(rate, spans.first), closed.gyro_weights, noise[:, 3:], spans),
        _added(unforetold(force, spans.first), closed.accel_weights, noise[:, :3], spans),
    )
    square, both = np.square(left), np.einsum("kii->ki", parts[0] + parts[1])
    shares = [_shares(square[:, own], both[:, own], white[:, own]) for own in (_TILT, _SPEED)]
    return parts, shares


def _added(off: FloatArray, weights: FloatArray, noise: FloatArray, spans: Spans) -> FloatArray:
    """Return the covariance (k, 5, 5) of closures whose points err by `off` (n, 3), noise apart."""
    square = np.square(off)
    total = np.add.reduceat(square, spans.start)
    share = 1.0 - np.add.reduceat(UNFORETOLD * noise, spans.start) / np.maximum(total, 1e-300)
    square *= np.maximum(share, 0.0)[spans.turn]
    return covariance_of_turns(weights, square, spans)


def _shares(square: FloatArray, expected: FloatArray, white: FloatArray) -> FloatArray:
    """Return how much of what is expected every second sample changes, of each turn.

    What samples are off their neighbours by, a smooth turn integrates well for all that, and a jolt
    does not. So each turn says what its own share is, and counts with its rows against what most of
    them have, which counts as one.
    """
    number = square.shape[1]
    square, expected, white = (x.sum(axis=1) for x in (square, expected, white))
    expected = np.maximum(expected, 1e-300)
    ratio = (square - white) / expected
    order = np.argsort(ratio)
    # Turns without a jolt show white noise alone.
    weight = np.cumsum((expected / (expected + white))[order])
    most = max(float(ratio[order][np.searchsorted(weight, 0.5 * weight[-1])]), LEAST)
    total = (white + most * expected + number * square) / (1 + number)
    return np.asarray(np.maximum((total - white) / expected, LEAST * most))
