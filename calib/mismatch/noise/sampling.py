"""What samples do not resolve of a turn: a jolt between two of them goes into its closure.

An integral over samples errs by what the signal has at multiples of the sample rate. Samples do not
show that, but a signal that has much there has some at half the rate, where they do: so it is
judged by what varies from sample to sample, and not by what a hand's tremor does, which they
resolve. An error of rate turns all that follows: attitude and velocity of a turn err together, each
by what the closure makes of a rate at that moment. So these errors are not noise that each row has
of its own, and turns with a jolt have large ones.
"""

from __future__ import annotations

from math import comb

import numpy as np
from scipy import sparse

from calib.mismatch.noise.sensornoise import SPREAD
from calib.mismatch.rows.closure import Closures, Spans, covariance_of_turns
from calib.mismatch.rows.rows import SAMPLING, Component
from calib.types import FloatArray, IntArray

STEP, CORNER, BEND = 1 / 10, 1 / 58, 1 / 282
"""Variance of what the rule for a turn's integrals errs by where a signal jumps, its slope does, or
its curvature, anywhere between two samples: relative to the squares that `unforetold` has of it,
times that of the sample interval."""

EXPECTED = {"rate": (CORNER * BEND) ** 0.5, "force": (STEP * CORNER) ** 0.5}
"""The same of signals that hands make: a knock makes the force jump at once, a new push makes it
bend, and inertia smooths the rate once more."""

REACH = 6
"""Neighbours on either side that foretell a sample: so many that a tremor of a quarter of the
sample rate counts a hundredth of what jumps from sample to sample."""

BENT = {"rate": 1 / 20000, "force": 1 / 2000}
"""The same as `EXPECTED`, for one neighbour on either side, of turns that take few samples: all
that hands do then varies from sample to sample, and how briskly they do is all that tells how much
is missed. Of a swing of a third of the sample rate the rule loses a few percent."""


def power_of_noise(reach: int) -> float:
    """Return the variance of white noise in `unforetold`, relative to its own."""
    return comb(4 * reach, 2 * reach) / comb(2 * reach, reach) ** 2


_SPEED = slice(2, 5)
_KINDS = ((REACH, "", EXPECTED), (1, " bent", BENT))


def unforetold(values: FloatArray, spans: Spans, reach: int = REACH) -> FloatArray:
    """Return by how much points (n, k) are off what `reach` neighbours on either side foretell.

    A polynomial through them, that is by the difference of the order of twice as many, in which the
    point itself counts one. Beyond its ends, a turn is at rest.
    """
    out = np.zeros_like(values)
    place, turn = np.arange(len(values)), spans.turn
    for k in range(-reach, reach + 1):
        near = np.clip(place + k, spans.start[turn], spans.last[turn])
        out += (
            (-1) ** k
            * comb(2 * reach, reach + k)
            / comb(2 * reach, reach)
            * values.take(near, axis=0)
        )
    return out


def sampling_components(
    closed: Closures,
    force: FloatArray,
    rate: FloatArray,
    noise: FloatArray,
    spans: Spans,
    rows: IntArray,
) -> list[Component]:
    """Return what sampling adds to the closures of k turns, through the rate and the force.

    Parameters
    ----------
    closed : Closures
    force, rate : (n, 3) arrays
        At the points of all turns, as ``spans`` has them.
    noise : (n, 6) array
        Their white noise, as variances.
    rows : (k, 5) array of int
        Rows of the closures.
    """
    if not len(rows):
        return []
    out = []
    for reach, label, expected in _KINDS:
        parts = _jolts(closed, force, rate, noise, spans, reach)
        for (signal, part), own in zip(parts.items(), (slice(0, 5), _SPEED), strict=True):
            index = rows[:, own]
            turns, size = index.shape
            each = np.zeros((turns, size, turns, size))
            each[np.arange(turns), :, np.arange(turns)] = part[:, own, own]
            index, matrix = index.ravel(), each.reshape(turns * size, -1)
            response = sparse.identity(len(matrix), format="csr")
            name = f"{signal}{label}{SAMPLING}"
            out.append(Component(name, index, response, matrix, expected[signal], SPREAD))
    return out


def unresolved(
    closed: Closures, force: FloatArray, rate: FloatArray, noise: FloatArray, spans: Spans
) -> FloatArray:
    """Return the variance (k, 5) of closures by jolts, as `sampling_components` expect it."""
    parts = _jolts(closed, force, rate, noise, spans, REACH)
    return np.asarray(sum(EXPECTED[s] * np.einsum("kii->ki", part) for s, part in parts.items()))


def _jolts(
    closed: Closures,
    force: FloatArray,
    rate: FloatArray,
    noise: FloatArray,
    spans: Spans,
    reach: int,
) -> dict[str, FloatArray]:
    """Return covariances (k, 5, 5) of closures whose points err by what they are off, by signal."""
    return {
        "rate": _added(rate, closed.gyro_weights, noise[:, 3:], spans, reach),
        "force": _added(force, closed.accel_weights, noise[:, :3], spans, reach),
    }


def _added(
    values: FloatArray, weights: FloatArray, noise: FloatArray, spans: Spans, reach: int
) -> FloatArray:
    """Return the covariance (k, 5, 5) of closures by what (n, 3) values are off, noise apart."""
    square = np.square(unforetold(values, spans, reach))
    total = np.add.reduceat(square, spans.start)
    loud = power_of_noise(reach) * np.add.reduceat(noise, spans.start)
    share = 1.0 - loud / np.maximum(total, 1e-300)
    square *= np.maximum(share, 0.0)[spans.turn]
    return covariance_of_turns(weights, square, spans)
