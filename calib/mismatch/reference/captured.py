"""What the noise of a captured orientation makes of the means of windows.

An orientation that is off by the angles ``phi`` shows force and rate in a frame that is off::

    force + force x phi        rate + rate x phi + d(phi)/dt

So while a body is at rest its mean rate is known but for the angles at either end, far better than
noise of the same size throughout would leave it; while it turns quickly, it is not. Its mean force
is the noisier the more of gravity is across an axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from calib.effects.base import State
from calib.effects.vibration import quiet_level
from calib.mismatch.reference.colour import Colour
from calib.mismatch.reference.steadied import Steady
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

WANDERS, WIDE = 0.1, 4.0
"""Variance of an angle's slow errors as a share of what its noise leaves in the mean of a window,
and the standard deviation of the logarithm of that: what captures a motion seldom says."""

SLOW_ANGLES = "angles slow"
"""Name of the component of what captured angles err by slowly."""

STAYS = (2.0, 8.0, 32.0)
"""s for which slow errors of angles stay, as much of them for each as come and go at once."""

LEAST_ANGLE = 1e-5
"""rad that no capture is better than."""

LEFT = 0.189
"""Integral of x² times the fourth power of the response of `filters.smoothed`, x the frequency
relative to its cut-off."""


class Known(NamedTuple):
    """Densities of white noise: of the sensor's own triads, and of what was captured.

    That is each ``angle`` (rad/√Hz) and ``position`` (m/√Hz). ``interval`` (s) is that between the
    points that are compared, ``coning`` the density of the rate that the angles make of themselves.
    """

    accel: float
    gyro: float
    angle: float
    interval: float
    coning: float = 0.0
    position: float = 0.0


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
    colours: list[Colour],
    *,
    interval: float,
    cutoff: float,
) -> Known:
    """Return what is known of the noise of a sensor beside a captured motion.

    Parameters
    ----------
    own, seen : two floats
        Densities of both triads, of the sensor alone and of slow differences.
    colours : two of Colour
        Of the differences of forces and rates.
    interval, cutoff : float, s and Hz
        Between the points that are compared, and of what the orientations have passed.
    """
    # A rate is 2 pi f times an angle, an acceleration the square of that times a position.
    angle = seen[1] * float(np.sqrt(colours[1].square)) / (2.0 * np.pi)
    position = seen[0] * float(np.sqrt(colours[0].fourth)) / (2.0 * np.pi) ** 2
    # The sensor alone is no louder than both: where it is, the body moves in its rests.
    accel, gyro = (a if a < UNSURE * b else b for a, b in zip(own, seen, strict=True))
    return Known(accel, gyro, angle, interval, coning(angle, cutoff), position)


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


class Felt(NamedTuple):
    """What k rows are of n points of each channel, and what they feel of a captured motion there.

    Sparse (k, n) matrices: six of ``channels``, and three of the angles (``turned``) and positions
    (``carried``) of the body.
    """

    channels: list[sparse.csr_matrix]
    turned: tuple[sparse.csr_matrix, ...]
    carried: tuple[sparse.csr_matrix, ...]

    @classmethod
    def of(cls, functional: list[sparse.csr_matrix], state: State, interval: float) -> Felt:
        """Return what rows feel whose `functional` is that of the motion at points so far apart."""
        slope, bend = _derivatives(state.time, interval)
        crossed = np.concatenate((skew(state.force), skew(state.rate)), axis=1)
        turned = (
            functional[3 + k] @ slope
            + sum(rows @ sparse.diags(crossed[:, c, k]) for c, rows in enumerate(functional))
            for k in range(3)
        )
        mat = np.zeros((len(state.time), 3, 3)) if state.mat_ns is None else state.mat_ns
        carried = (
            sum(functional[c] @ sparse.diags(mat[:, k, c]) for c in range(3)) @ bend
            for k in range(3)
        )
        return cls(functional, tuple(turned), tuple(carried))


def mean_covariance(felt: Felt, known: Known, steady: Steady | None = None) -> FloatArray:
    """Return the covariance (k, k) of rows that are slow beside the samples.

    One angle moves all channels: what it turns gravity by across is not seen along gravity, however
    noisy it is.

    Parameters
    ----------
    felt : Felt
    known : Known
        Whatever else there is comes on top.
    steady : Steady, optional
        What orientations at rest are taken as.
    """
    step = known.interval
    out = sparse.csr_matrix((felt.channels[0].shape[0],) * 2)
    for c, rows in enumerate(felt.channels):
        # Per point a variance is half a density over the interval.
        density = known.accel if c < 3 else np.hypot(known.gyro, known.coning)
        out += rows @ rows.T * (density**2 / (2.0 * step))
    for rows in felt.carried if known.position else ():
        out += rows @ rows.T * (known.position**2 / (2.0 * step))
    for rows in felt.turned:
        if steady is None:
            out += rows @ rows.T * (known.angle**2 / (2.0 * step))
            continue
        own = rows @ sparse.diags(np.where(steady.inside, steady.sway, known.angle))
        slow = rows @ steady.lines * steady.noise
        out += (own @ own.T + slow @ slow.T) / (2.0 * step)
    return np.asarray(out.toarray())


def moved_by(felt: Felt, angle: FloatArray) -> FloatArray:
    """Return what rows (k,) see of a truth whose orientations are turned by (n, 3) angles."""
    parts = [rows @ own for rows, own in zip(felt.turned, angle.T, strict=True)]
    return np.asarray(np.sum(parts, axis=0))


def wobble(
    felt: Felt, time: FloatArray, known: Known, nodes: FloatArray, steady: Steady | None = None
) -> Component:
    """Return what angles err by slowly, as a component of (k,) rows: straight from node to node.

    However slowly an angle wanders it comes back, and what it adds to the mean rate of one window
    it takes from another's. Errors that each window had by itself would not: beside them a bias
    were never known better than that. How slowly nothing tells beforehand: there is as much of it
    at each of some times that it stays for, as where a camera loses a marker for a while.

    Parameters
    ----------
    felt : Felt
    time : (n,) array, s
        Of its points.
    known : Known
    nodes : (s,) array, s
        Between them an angle errs by what is between its errors there.
    steady : Steady, optional
        What orientations at rest are taken as.
    """
    hats = _between(time, nodes)
    if steady is not None:
        outside = sparse.diags(1.0 * ~steady.inside)
        hats = outside @ hats + steady.lines @ (steady.lines.T @ hats)
    response = sparse.hstack([rows @ hats for rows in felt.turned], format="csr")
    length = float(np.median(np.diff(nodes)))
    expected = WANDERS * max(known.angle**2 / (2.0 * length), LEAST_ANGLE**2)
    apart = np.abs(nodes[:, None] - nodes)
    stays = [np.eye(len(nodes)), *(np.exp(-apart / seconds) for seconds in STAYS)]
    kernel = np.asarray(np.kron(np.eye(3), np.mean(stays, axis=0)), np.float64)
    return Component(SLOW_ANGLES, np.arange(response.shape[0]), response, kernel, expected, WIDE)


def _between(time: FloatArray, nodes: FloatArray) -> sparse.csr_matrix:
    """Return what makes values at (n,) times of those at (s,) nodes, straight between these."""
    n, last = len(time), len(nodes) - 1
    before = np.clip(np.searchsorted(nodes, time, side="right") - 1, 0, last - 1)
    share = np.clip((time - nodes[before]) / (nodes[before + 1] - nodes[before]), 0.0, 1.0)
    index = np.stack((before, before + 1), axis=1).ravel()
    values = np.stack((1.0 - share, share), axis=1).ravel()
    return sparse.csr_matrix((values, index, 2 * np.arange(n + 1)), shape=(n, len(nodes)))


def _derivatives(time: FloatArray, step: float) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Return what makes first and second derivatives of values at (n,) times; none beside gaps."""
    near = np.diff(time) < 1.5 * step
    both = sparse.diags(1.0 * (np.convolve(near, np.ones(2)) > 1.5))
    one, two = np.ones(len(near)), np.ones(len(time))
    slope = sparse.diags([one, -one], [1, -1]) / (2.0 * step)
    bend = sparse.diags([one, -2.0 * two, one], [1, 0, -1]) / step**2
    return (both @ slope).tocsr(), (both @ bend).tocsr()
