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
from calib.recording import Recording
from calib.rotation import skew
from calib.types import FloatArray, IntArray

BLOCK = 0.25
"""s over which a sensor's noise is averaged: slow beside its own low-pass, quick beside its drift.
"""

LEAST = 20
"""Differences between neighbouring blocks that tell how loud a sensor is to a fifth."""


class Known(NamedTuple):
    """Densities of white noise: of the sensor's own triads, and of each angle (rad/√Hz).

    ``interval`` (s) is that between the points that are compared.
    """

    accel: float
    gyro: float
    angle: float
    interval: float


def sensor_densities(recording: Recording, rests: IntArray) -> tuple[float, float] | None:
    """Return the noise densities of both triads, by blocks of (k, 2) rests; None if these are few.

    ``rests`` are samples ``[start, stop)``.
    """
    each = max(1, round(BLOCK / recording.interval))
    values = np.hstack((recording.accel, recording.gyro))
    changes = []
    for start, stop in rests:
        count = (stop - start) // each
        blocks = values[start : start + count * each].reshape(count, each, 6).mean(axis=1)
        changes.append(np.diff(blocks, axis=0))
    found = np.concatenate([*changes, np.zeros((0, 6))])
    if len(found) < LEAST:
        return None
    # Half of a normal variable's sizes are below 0.6745 of its standard deviation.
    sigma = np.median(np.abs(found), axis=0) / 0.6745 / np.sqrt(2.0)
    accel, gyro = sigma.reshape(2, 3).mean(axis=1) * np.sqrt(2.0 * each * recording.interval)
    return float(accel), float(gyro)


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
    n, step = len(state.time), known.interval
    # Of a sum of weights times a derivative: minus the derivative of the weights.
    slope = sparse.diags([0.5 / step, -0.5 / step], [1, -1], shape=(n, n), format="csr")
    crossed = skew(state.force), skew(state.rate)
    out = np.zeros((len(channel), len(channel)))
    for c, weights in enumerate(functional):
        own = np.flatnonzero(channel == c)
        rows = weights[own]
        # Per point a variance is half a density over the interval.
        total = rows @ rows.T * (known[c // 3] ** 2 / (2.0 * step))
        for k in range(3):
            felt = rows @ sparse.diags(crossed[c // 3][:, c % 3, k])
            if c == 3 + k:
                felt = felt + rows @ slope
            total += felt @ felt.T * (known.angle**2 / (2.0 * step))
        out[np.ix_(own, own)] = total.toarray()
    return out
