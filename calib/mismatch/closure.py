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
    cumulative_quat_segments,
    mat_from_quat,
    quat_from_rotvec,
    rate_increments,
    skew,
)
from calib.types import FloatArray, IntArray


class Closures(NamedTuple):
    """Residuals of k turns (k, 5): two angles (rad), and three velocities (m/s) at the start.

    Their response to df and dw at the n points of all turns, (5, n, 3) each, and to the two
    attitude angles of the rests on either side, (k, 5, 2): ``before`` and ``after`` are derivatives
    of the *model*, so that ``residual ~ before @ db + after @ da``. ``angle`` is the path of
    rotation (rad), ``effort`` that of velocity (m/s), (k,), and ``unresolved`` (k, 5) what every
    second sample changes of the residuals; they scale the closure's own errors.
    """

    residual: FloatArray
    accel_weights: FloatArray
    gyro_weights: FloatArray
    before: FloatArray
    after: FloatArray
    angle: FloatArray
    effort: FloatArray
    unresolved: FloatArray


class Ended(NamedTuple):
    """Where turns end, or are, seen from the start of each: frame (k, 3, 3), velocity (k, 3)."""

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


def turned_frames(time: FloatArray, rate: FloatArray, first: IntArray) -> FloatArray:
    """Return the frame at each time seen from that at the start of its turn, (n, 3, 3).

    Points ``[first[i], first[i + 1])`` are turn i's, two or more.
    """
    if len(first) < 2:
        return np.zeros((0, 3, 3))
    increments = np.zeros_like(rate)
    increments[1:] = rate_increments(time, rate)
    increments -= _bent(time, rate, first)
    increments[first[:-1]] = 0.0
    return mat_from_quat(cumulative_quat_segments(quat_from_rotvec(increments), first))


def _bent(time: FloatArray, values: FloatArray, first: IntArray) -> FloatArray:
    """Return what trapezoids from the point before are too large by, (n, 3) in units times s.

    A trapezoid is off by ``dt²/12 dx/dt`` in between, and right again where the sensor rests: at
    50 Hz a velocity of 2 mm/s after a brisk turn; where samples are uneven, it stays off. So the
    next term is taken along (Euler-Maclaurin), with slopes of the order that uneven samples need.
    """
    out = np.zeros_like(values)
    if len(first) > 1:
        slope = _slopes(time, values, first)
        out[1:] = np.square(np.diff(time))[:, None] / 12 * np.diff(slope, axis=0)
        out[first[:-1]] = 0.0
    return out


def _slopes(time: FloatArray, values: FloatArray, first: IntArray) -> FloatArray:
    """Return the slopes of polynomials through two points on either side; none where turns end."""
    near = np.gradient(values, time, axis=0)
    slope, middle = near.copy(), slice(2, len(time) - 2)
    places = (0, 1, 3, 4)
    off = [time[k : len(time) - 4 + k] - time[middle] for k in places]
    slope[middle] = 0.0
    for k, own in zip(places, off, strict=True):
        weight = -1.0 / own
        for other in off:
            if other is not own:
                weight = weight * other / (own - other)
        slope[middle] += weight[:, None] * (values[k : len(time) - 4 + k] - values[middle])
    start, last = first[:-1], first[1:] - 1
    beside = np.concatenate((np.minimum(start + 1, last), np.maximum(last - 1, start)))
    slope[beside] = near[beside]
    slope[start] = slope[last] = 0.0  # at rest; their noise would count twice
    return slope


def integrate_turns(
    time: FloatArray, force: FloatArray, rate: FloatArray, first: IntArray
) -> Ended:
    """Return where turns end, all at once: what `close_turns` compares, without derivatives.

    Points ``[first[i], first[i + 1])`` are turn i's. The velocity is the integral of the specific
    force: gravity's is in it.
    """
    return end_turns(time, force, turned_frames(time, rate, first), first)


def end_turns(time: FloatArray, force: FloatArray, mat: FloatArray, first: IntArray) -> Ended:
    """Return where turns end whose `turned_frames` are known."""
    turned = np.einsum("nij,nj->ni", mat, force)
    passed = _weights(_steps(time, first))[:, None] * turned - _bent(time, turned, first)
    return Ended(mat[first[1:] - 1], np.add.reduceat(passed, first[:-1], axis=0))


def follow_turns(time: FloatArray, force: FloatArray, rate: FloatArray, first: IntArray) -> Ended:
    """Return where turns are at each of their points, (n, ...): at the last, where they end."""
    mat = turned_frames(time, rate, first)
    turned = np.einsum("nij,nj->ni", mat, force)
    gained = 0.5 * _steps(time, first)[:, None] * (turned + np.roll(turned, 1, 0))
    passed = np.cumsum(gained - _bent(time, turned, first), axis=0)
    return Ended(mat, passed - np.repeat(passed[first[:-1]], np.diff(first), axis=0))


def integrate_half(time: FloatArray, force: FloatArray, rate: FloatArray, first: IntArray) -> Ended:
    """Return the same from every second sample: how far off that is, samples do not resolve."""
    number = np.diff(first)
    place = np.arange(len(time)) - np.repeat(first[:-1], number)
    kept = (place % 2 == 0) | (place == np.repeat(number, number) - 1)
    fewer = np.append(0, np.cumsum(kept)[first[1:] - 1])
    return integrate_turns(time[kept], force[kept], rate[kept], fewer)


def _steps(time: FloatArray, first: IntArray) -> FloatArray:
    """Return the time since the point before in the same turn, (n,) s."""
    step = np.diff(time, prepend=0.0)
    step[first[:-1]] = 0.0
    return step


def _weights(step: FloatArray) -> FloatArray:
    """Return what each point counts in the integral over its turn, by trapezoids (n,)."""
    return np.asarray(0.5 * (step + np.append(step[1:], 0.0)))


def close_turns(
    time: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    first: IntArray,
    up_before: FloatArray,
    up_after: FloatArray,
    *,
    gravity: float,
) -> Closures:
    """Return the closures of turns.

    Parameters
    ----------
    time : (n,) array, s
    force, rate : (n, 3) arrays
        Corrected signals.
    first : (k + 1,) array of int
        Points ``[first[i], first[i + 1])`` are turn i's.
    up_before, up_after : (k, 3) arrays
        Unit vectors up, in frame s, at the rests on either side.
    gravity : float, m/s²
    """
    start, last, number = first[:-1], first[1:] - 1, np.diff(first)
    turn = np.repeat(np.arange(len(start)), number)
    weight = _weights(_steps(time, first))
    mat, velocity = follow_turns(time, force, rate, first)
    turned = np.einsum("nij,nj->ni", mat, force)
    remaining = velocity[last][turn] - velocity
    total = velocity[last]
    duration = time[last] - time[start]
    plane, plane_after = across(up_before), across(up_after)
    end = np.einsum("kij,kj->ki", mat[last], up_after)
    residual = np.hstack(
        (
            np.einsum("kij,ki->kj", plane, end - up_before),
            total - gravity * duration[:, None] * up_before,
        )
    )
    weighted = mat * weight[:, None, None]
    gyro, accel = np.empty((5, len(time), 3)), np.zeros((5, len(time), 3))
    lever = np.cross(end[:, None], np.swapaxes(plane, 1, 2))
    gyro[:2] = np.swapaxes(lever[turn] @ weighted, 0, 1)
    # R x e of each unit vector e are the columns of skew(R).
    gyro[2:] = np.swapaxes(np.swapaxes(skew(remaining), 1, 2) @ weighted, 0, 1)
    accel[2:] = np.swapaxes(weighted, 0, 1)
    before, after = np.zeros((len(start), 5, 2)), np.zeros((len(start), 5, 2))
    before[:, :2] = np.eye(2)
    after[:, :2] = -np.swapaxes(plane, 1, 2) @ mat[last] @ plane_after
    before[:, 2:] = gravity * duration[:, None, None] * plane
    moved = np.linalg.norm(turned - gravity * up_before[turn], axis=1)
    half = integrate_half(time, force, rate, first)
    tilt = np.einsum("kij,kj->ki", half.frame, up_after) - end
    unresolved = np.hstack((np.einsum("kij,ki->kj", plane, tilt), half.velocity - total))
    return Closures(
        residual,
        accel,
        gyro,
        before,
        after,
        np.add.reduceat(weight * np.linalg.norm(rate, axis=1), start),
        np.add.reduceat(weight * moved, start),
        unresolved,
    )
