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

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import sparse

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
    rotation (rad), ``effort`` that of velocity (m/s), (k,): they scale the closure's own errors.
    """

    residual: FloatArray
    accel_weights: FloatArray
    gyro_weights: FloatArray
    before: FloatArray
    after: FloatArray
    angle: FloatArray
    effort: FloatArray


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


@dataclass(frozen=True, eq=False)
class Spans:
    """When turns were, and what integrals over them need, which depends on nothing else.

    Parameters
    ----------
    time : (n,) array, s
        Of the points of k turns, one turn after another.
    first : (k + 1,) array of int
        Points ``[first[i], first[i + 1])`` are turn i's, two or more.
    """

    time: FloatArray
    first: IntArray

    @property
    def start(self) -> IntArray:
        """The first point of each turn, (k,)."""
        return self.first[:-1]

    @property
    def last(self) -> IntArray:
        """The last point of each turn, (k,)."""
        return self.first[1:] - 1

    @cached_property
    def turn(self) -> IntArray:
        """The turn of each point, (n,)."""
        return np.repeat(np.arange(len(self.start)), np.diff(self.first))

    @cached_property
    def duration(self) -> FloatArray:
        """How long each turn takes, (k,) s."""
        return np.asarray(self.time[self.last] - self.time[self.start])

    @cached_property
    def step(self) -> FloatArray:
        """The time since the point before in the same turn, (n,) s."""
        step = np.diff(self.time, prepend=0.0)
        step[self.start] = 0.0
        return step

    @cached_property
    def weight(self) -> FloatArray:
        """What each point counts in the integral over its turn, by trapezoids (n,) s."""
        return np.asarray(0.5 * (self.step + np.append(self.step[1:], 0.0)))

    @cached_property
    def bend(self) -> sparse.csr_matrix:
        """What trapezoids from the point before are too large by, of values at the points, s.

        A trapezoid is off by ``dt²/12 dx/dt`` in between, and right again where the sensor rests:
        at 50 Hz a velocity of 2 mm/s after a brisk turn; where samples are uneven, it stays off. So
        the next term is taken along (Euler-Maclaurin), with slopes of the order that uneven samples
        need.
        """
        number = len(self.time)
        weights = np.zeros((number, 6))
        weights[:, 1:] = self._slopes()
        weights[1:, :5] -= weights[:-1, 1:]
        weights *= np.square(self.step)[:, None] / 12
        near = np.clip(np.arange(number)[:, None] + np.arange(-3, 3), 0, number - 1)
        ends = 6 * np.arange(number + 1)
        return sparse.csr_matrix((weights.ravel(), near.ravel(), ends), shape=(number, number))

    def _slopes(self) -> FloatArray:
        """Return what the two points on either side, and its own, weigh in each slope, (n, 5).

        That of a polynomial through all of them, and beside the end of a turn through one on either
        side. At the ends there is none: they are at rest, and their noise would count twice.
        """
        out = np.zeros((len(self.time), 5))
        place = np.arange(len(self.time)) - self.start[self.turn]
        left = self.last[self.turn] - self.start[self.turn] - place
        edge = np.minimum(place, left)
        for own, reach in ((edge > 1, (-2, -1, 1, 2)), (edge == 1, (-1, 1))):
            here = np.flatnonzero(own)
            off = [self.time[here + k] - self.time[here] for k in reach]
            for k, mine in zip(reach, off, strict=True):
                weight = 1.0 / mine
                for other in off:
                    if other is not mine:
                        weight = weight * other / (other - mine)
                out[here, 2 + k] = weight
        out[:, 2] = -out.sum(axis=1)
        return out


def turned_frames(spans: Spans, rate: FloatArray) -> FloatArray:
    """Return the frame at each point seen from that at the start of its turn, (n, 3, 3)."""
    if not len(spans.start):
        return np.zeros((0, 3, 3))
    increments = np.zeros_like(rate)
    increments[1:] = rate_increments(spans.time, rate)
    increments -= spans.bend @ rate
    increments[spans.start] = 0.0
    return mat_from_quat(cumulative_quat_segments(quat_from_rotvec(increments), spans.first))


def integrate_turns(spans: Spans, force: FloatArray, rate: FloatArray) -> Ended:
    """Return where turns end, all at once: what `close_turns` compares, without derivatives.

    The velocity is the integral of the specific force: gravity's is in it.
    """
    return end_turns(spans, force, turned_frames(spans, rate))


def end_turns(spans: Spans, force: FloatArray, mat: FloatArray) -> Ended:
    """Return where turns end whose `turned_frames` are known."""
    turned = np.einsum("nij,nj->ni", mat, force)
    passed = spans.weight[:, None] * turned - spans.bend @ turned
    return Ended(mat[spans.last], np.add.reduceat(passed, spans.start, axis=0))


def follow_turns(spans: Spans, force: FloatArray, rate: FloatArray) -> Ended:
    """Return where turns are at each of their points, (n, ...): at the last, where they end."""
    mat = turned_frames(spans, rate)
    turned = np.einsum("nij,nj->ni", mat, force)
    gained = 0.5 * spans.step[:, None] * (turned + np.roll(turned, 1, 0))
    passed = np.cumsum(gained - spans.bend @ turned, axis=0)
    return Ended(mat, passed - passed[spans.start][spans.turn])


def close_turns(
    spans: Spans,
    force: FloatArray,
    rate: FloatArray,
    up_before: FloatArray,
    up_after: FloatArray,
    *,
    gravity: float,
) -> Closures:
    """Return the closures of turns.

    Parameters
    ----------
    spans : Spans
    force, rate : (n, 3) arrays
        Corrected signals.
    up_before, up_after : (k, 3) arrays
        Unit vectors up, in frame s, at the rests on either side.
    gravity : float, m/s²
    """
    start, last, turn, weight = spans.start, spans.last, spans.turn, spans.weight
    mat, velocity = follow_turns(spans, force, rate)
    turned = np.einsum("nij,nj->ni", mat, force)
    remaining = velocity[last][turn] - velocity
    duration = spans.duration
    plane, plane_after = across(up_before), across(up_after)
    end = np.einsum("kij,kj->ki", mat[last], up_after)
    ended = Ended(mat[last], velocity[last])
    residual = open_ends(ended, up_before, up_after, duration, gravity=gravity)
    weighted = mat * weight[:, None, None]
    gyro, accel = np.empty((5, len(turn), 3)), np.zeros((5, len(turn), 3))
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
    return Closures(
        residual,
        accel,
        gyro,
        before,
        after,
        np.add.reduceat(weight * np.linalg.norm(rate, axis=1), start),
        np.add.reduceat(weight * moved, start),
    )


def open_ends(
    ended: Ended,
    up_before: FloatArray,
    up_after: FloatArray,
    duration: FloatArray,
    *,
    gravity: float,
) -> FloatArray:
    """Return the residuals (k, 5) of turns that ended there, after a `duration` (k,)."""
    tilt = np.einsum("kij,kj->ki", ended.frame, up_after) - up_before
    attitude = np.einsum("kij,ki->kj", across(up_before), tilt)
    return np.hstack((attitude, ended.velocity - gravity * duration[:, None] * up_before))


def covariance_of_turns(weights: FloatArray, variance: FloatArray, spans: Spans) -> FloatArray:
    """Return the covariance (k, 5, 5) of closures whose points err by a `variance` (n, c).

    ``weights`` (5, n, c) are what the points count in them.
    """
    out = np.empty((len(spans.start), 5, 5))
    for k, (a, b) in enumerate(pairwise(spans.first)):
        own = weights[:, a:b]
        out[k] = (own * variance[a:b]).reshape(5, -1) @ own.reshape(5, -1).T
    return out
