"""What the noise of a captured orientation makes of the means of windows.

An orientation that is off by the angles ``phi`` shows force and rate in a frame that is off::

    force + force x phi        rate + rate x phi + d(phi)/dt

So while a body is at rest its mean rate is known but for the angles at either end, far better than
noise of the same size throughout would leave it; while it turns quickly, it is not. Its mean force
is the noisier the more of gravity is across an axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import sparse

from calib.effects.base import State
from calib.effects.vibration import quiet_level
from calib.mismatch.reference.colour import Colour
from calib.mismatch.rows.rows import Component
from calib.recording import Recording
from calib.rotation import skew
from calib.types import FloatArray, IntArray

BLOCK = 0.25
"""s over which a sensor's noise is averaged: slow beside its own low-pass, quick beside its drift.
"""

FEWEST, LEAST = 3, 20
"""Differences between neighbouring blocks: of a rest that tells anything, and of all rests that
tell how loud a sensor is to a tenth."""


UNSURE = 1.5
"""Factor up to which a density at zero frequency is not known from what is above
`calib.mismatch.reference.colour.SLOWEST`."""

WANDERS, WIDE = 0.1, 2.0
"""Variance of an angle's slow errors as a share of what its noise leaves in the mean of a window,
and the standard deviation of the logarithm of that: what captures a motion seldom says."""

LEAST_ANGLE = 1e-5
"""rad that no capture is better than."""

LEFT = 0.189
"""Integral of x² times the fourth power of the response of `band.zero_phase`, x the frequency
relative to its cut-off."""


class Known(NamedTuple):
    """Densities of white noise: of the sensor's own triads, and of each angle (rad/√Hz).

    ``interval`` (s) is that between the points that are compared, ``coning`` the density of the
    rate that the angles make of themselves.
    """

    accel: float
    gyro: float
    angle: float
    interval: float
    coning: float = 0.0


def sensor_densities(recording: Recording, rests: IntArray) -> tuple[float, float] | None:
    """Return the noise densities of both triads, by blocks of (k, 2) rests; None if these are few.

    ``rests`` are samples ``[start, stop)``. Those that shake tell of what shakes them.
    """
    each = max(1, round(BLOCK / recording.interval))
    values = np.hstack((recording.accel, recording.gyro))
    found = []
    for start, stop in rests:
        count = (stop - start) // each
        if count > FEWEST:
            blocks = values[start : start + count * each].reshape(count, each, 6).mean(axis=1)
            square = np.square(np.diff(blocks, axis=0)).sum(axis=0).reshape(2, 3).mean(axis=1)
            found.append([*square, count - 1])
    of_rests = np.array(found).reshape(-1, 3)
    number = of_rests[:, 2]
    if number.sum() < LEAST:
        return None
    variance = of_rests[:, :2] / number[:, None]
    # Neighbouring differences of the three axes share a block.
    limit = 1.0 + 4.0 * np.sqrt(1.0 / number)
    densities = []
    for own in variance.T:
        quiet = own <= limit * quiet_level(own, limit)
        level = float(own[quiet] @ number[quiet] / number[quiet].sum())
        densities.append(float(np.sqrt(level * each * recording.interval)))
    return densities[0], densities[1]


def known_noise(
    own: tuple[float, float],
    seen: tuple[float, float],
    colour: Colour,
    *,
    interval: float,
    cutoff: float,
) -> Known:
    """Return what is known of the noise of a sensor beside a captured motion.

    Parameters
    ----------
    own, seen : two floats
        Densities of both triads, of the sensor alone and of slow differences.
    colour : Colour
        Of the differences of rates.
    interval, cutoff : float, s and Hz
        Between the points that are compared, and of what the orientations have passed.
    """
    # A rate is 2 pi f times an angle.
    angle = seen[1] * float(np.sqrt(colour.square)) / (2.0 * np.pi)
    # The sensor alone is no louder than both: where it is, the body moves in its rests.
    accel, gyro = (a if a < UNSURE * b else b for a, b in zip(own, seen, strict=True))
    return Known(accel, gyro, angle, interval, coning(angle, cutoff))


def coning(angle: float, cutoff: float) -> float:
    """Return the density of the rate that the noise of angles makes of itself, (rad/s)/√Hz.

    Errors phi of an orientation add ``phi x d(phi)/dt / 2`` to its rate besides ``d(phi)/dt``, and
    that does not come back. At zero frequency its spectral density is the integral of the product
    of those of an angle and of its derivative, ``(2 pi)² angle⁴ cutoff³ LEFT``.

    Parameters
    ----------
    angle : float, rad/√Hz
        Density of the noise of each angle.
    cutoff : float, Hz
        Of the low-pass that the orientations have passed.
    """
    return float(2.0 * np.pi * angle**2 * np.sqrt(LEFT * cutoff**3))


def mean_covariance(
    functional: list[sparse.csr_matrix], channel: IntArray, state: State, known: Known
) -> FloatArray:
    """Return the covariance (k, k) of rows that are slow beside the samples.

    What channels have in common is left out: each is judged by itself.

    Parameters
    ----------
    functional : six sparse (k, n) matrices
        What the rows are of each channel.
    channel : (k,) array of int
        The one that each row is of.
    state : State
        The motion at the n points.
    known : Known
        Whatever else there is comes on top.
    """
    step = known.interval
    out = np.zeros((len(channel), len(channel)))
    for c, weights in enumerate(functional):
        own = np.flatnonzero(channel == c)
        rows = weights[own]
        # Per point a variance is half a density over the interval.
        density = known.accel if c < 3 else np.hypot(known.gyro, known.coning)
        total = rows @ rows.T * (density**2 / (2.0 * step))
        for felt in _felt(rows, c, state, step):
            total += felt @ felt.T * (known.angle**2 / (2.0 * step))
        out[np.ix_(own, own)] = total.toarray()
    return out


def wobble(
    functional: list[sparse.csr_matrix],
    channel: IntArray,
    state: State,
    known: Known,
    nodes: FloatArray,
) -> Component:
    """Return what angles err by slowly, as a component of (k,) rows: straight from node to node.

    However slowly an angle wanders it comes back, and what it adds to the mean rate of one window
    it takes from another's. Errors that each window had by itself would not: beside them a bias
    were never known better than that.

    Parameters
    ----------
    nodes : (s,) array, s
        Between them an angle errs by what is between its errors there.
    """
    hats = np.stack([np.interp(state.time, nodes, hat) for hat in np.eye(len(nodes))], axis=1)
    response = sparse.lil_matrix((len(channel), 3 * len(nodes)))
    for c, weights in enumerate(functional):
        own = np.flatnonzero(channel == c)
        felt = [each @ hats for each in _felt(weights[own], c, state, known.interval)]
        response[own] = np.hstack(felt)
    length = float(np.median(np.diff(nodes)))
    expected = WANDERS * max(known.angle**2 / (2.0 * length), LEAST_ANGLE**2)
    index, kernel = np.arange(len(channel)), np.eye(3 * len(nodes))
    return Component("angles slow", index, response.tocsr(), kernel, expected, WIDE)


def _felt(
    rows: sparse.csr_matrix, c: int, state: State, step: float
) -> Iterator[sparse.csr_matrix]:
    """Yield what rows (k, n) of a channel feel of errors of each angle at the n points."""
    n = len(state.time)
    crossed = skew(state.force if c < 3 else state.rate)
    for k in range(3):
        felt = rows @ sparse.diags(crossed[:, c % 3, k])
        if c == 3 + k:
            # Of a sum of weights times a derivative: minus the derivative of the weights.
            slope = sparse.diags([0.5 / step, -0.5 / step], [1, -1], shape=(n, n), format="csr")
            felt = felt + rows @ slope
        yield felt
