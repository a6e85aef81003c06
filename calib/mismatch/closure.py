"""Closures of a turn from rest to rest, and their response to errors of the signals.

With ``C(t)`` the rotation from the frame at time t to that at the turn's start, ``u`` the unit
vector up in frame s, and the signals corrected by the model,

- attitude: ``E' (C(T) u_after - u_before) = 0``, E two axes across ``u_before`` (heading is free);
- velocity: ``integral of C f dt - g u_before T = 0``, as the sensor is at rest at either end.

A rate error turns the frame by ``psi(t) = integral of C dw``, so that::

    d attitude . e = integral of dw . C' (C(T) u_after x e) dt
    d velocity . e = integral of df . C' e dt + integral of dw . C' (R(t) x e) dt,
                     R(t) = integral of C f from t to T

Both are integrals of the signal's errors with known weights, which is what makes any effect a
column of rows by one matrix product. The velocity closure needs no fixture; a lever arm common to
the three axes drops out of it, as the velocity that it causes is zero at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.rotation import (
    cumulative_quat,
    cumulative_quat_segments,
    mat_from_quat,
    quat_from_rotvec,
    rate_increments,
)
from calib.types import FloatArray, IntArray


class Closure(NamedTuple):
    """One turn: five residuals and their response to df, dw (5, n, 3) and to the attitudes."""

    residual: FloatArray
    accel_weights: FloatArray
    gyro_weights: FloatArray
    before: FloatArray
    after: FloatArray
    angle: float
    effort: float


class Ended(NamedTuple):
    """Where k turns end, in the frame at the start of each: frame (k, 3, 3), velocity (k, 3)."""

    frame: FloatArray
    velocity: FloatArray


def across(up: FloatArray) -> FloatArray:
    """Return two unit vectors across each of (..., 3) unit vectors, (..., 3, 2)."""
    up = np.asarray(up, np.float64)
    axis = np.zeros_like(up)
    smallest = np.argmin(np.abs(up), axis=-1)
    np.put_along_axis(axis, smallest[..., None], 1.0, axis=-1)
    first = np.cross(axis, up)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack((first, np.cross(up, first)), axis=-1)


def turned_frame(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return quaternions (n, 4) of the frame at each time seen from that at the first.

    A trapezoid is off by ``dt²/12 dw/dt`` in between, and right again where the sensor rests: at
    50 Hz a velocity of 2 mm/s after a brisk turn. So its next term is taken along
    (Euler-Maclaurin).
    """
    increments = rate_increments(time, rate)
    if len(time) > 2:
        slope = np.gradient(rate, time, axis=0)
        slope[[0, -1]] = 0.0  # at rest; their noise would count twice
        increments -= np.square(np.diff(time))[:, None] / 12 * np.diff(slope, axis=0)
    quat = np.zeros((len(time), 4))
    quat[0, 0] = 1.0
    quat[1:] = cumulative_quat(quat_from_rotvec(increments))
    return quat


def integrate_turns(
    time: FloatArray, force: FloatArray, rate: FloatArray, first: IntArray
) -> Ended:
    """Return where turns end, all at once: what `close_turn` compares, without derivatives.

    Points ``[first[i], first[i + 1])`` are turn i's. The velocity is the integral of the specific
    force: gravity's is in it.
    """
    if len(first) < 2:
        return Ended(np.zeros((0, 3, 3)), np.zeros((0, 3)))
    start, last = first[:-1], first[1:] - 1
    slope = np.gradient(rate, time, axis=0)
    slope[start] = slope[last] = 0.0
    increments = np.zeros_like(rate)
    increments[1:] = rate_increments(time, rate)
    increments[1:] -= np.square(np.diff(time))[:, None] / 12 * np.diff(slope, axis=0)
    increments[start] = 0.0
    mat = mat_from_quat(cumulative_quat_segments(quat_from_rotvec(increments), first))
    turned = np.einsum("nij,nj->ni", mat, force)
    step = np.diff(time, prepend=time[0])
    step[start] = 0.0
    weight = 0.5 * (step + np.append(step[1:], 0.0))
    return Ended(mat[last], np.add.reduceat(weight[:, None] * turned, start, axis=0))


def close_turn(
    time: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    up_before: FloatArray,
    up_after: FloatArray,
    *,
    gravity: float,
) -> Closure:
    """Return the closures of one turn.

    Parameters
    ----------
    time : (n,) array, s
    force, rate : (n, 3) arrays
        Corrected signals.
    up_before, up_after : (3,) arrays
        Unit vectors up, in frame s, at the rests on either side.
    gravity : float, m/s²

    Returns
    -------
    Closure
        Residuals: two angles (rad), three velocities (m/s) in the frame at the start. ``before``
        and ``after`` (5, 2) are the derivatives of the *model* by the two attitude angles of each
        rest, so that ``residual ~ before @ db + after @ da``. ``angle`` is the path of rotation
        (rad), ``effort`` that of velocity (m/s); they scale the closure's own errors.
    """
    step = np.diff(time)
    weight = np.zeros(len(time))
    weight[:-1] += 0.5 * step
    weight[1:] += 0.5 * step
    mat = mat_from_quat(turned_frame(time, rate))
    turned = np.einsum("nij,nj->ni", mat, force)
    increments = 0.5 * step[:, None] * (turned[:-1] + turned[1:])
    total = increments.sum(axis=0)
    remaining = np.zeros_like(turned)
    remaining[:-1] = np.cumsum(increments[::-1], axis=0)[::-1]
    duration = time[-1] - time[0]
    plane, plane_after = across(up_before), across(up_after)
    end = mat[-1] @ up_after
    residual = np.concatenate((plane.T @ (end - up_before), total - gravity * duration * up_before))
    weighted = mat * weight[:, None, None]
    gyro = np.empty((5, len(time), 3))
    accel = np.zeros_like(gyro)
    for row in range(2):
        gyro[row] = np.cross(end, plane[:, row]) @ weighted
    for row in range(3):
        unit = np.eye(3)[row]
        accel[2 + row] = weighted[:, row, :]
        gyro[2 + row] = np.einsum("ni,nij->nj", np.cross(remaining, unit), weighted)
    before, after = np.zeros((5, 2)), np.zeros((5, 2))
    before[:2] = np.eye(2)
    after[:2] = -plane.T @ mat[-1] @ plane_after
    before[2:] = gravity * duration * plane
    moved = np.linalg.norm(turned - gravity * up_before, axis=1)
    return Closure(
        residual,
        accel,
        gyro,
        before,
        after,
        float(weight @ np.linalg.norm(rate, axis=1)),
        float(weight @ moved),
    )
