"""How a sensor moves at rest: a hand, a foot or a soft bench gives way, and it leans.

What it leans by both sensors see: gravity moves across the accelerometer, by ``g`` times the angle,
and the gyroscope turns by as much in that time. On a table that is nothing. On a foot it is tenths
of a degree in seconds, and a bias that changes looks the same. The angle of each pose is modelled
as a random walk upon a steady turn, both of which begin anew with the pose::

    Var angle(t) = q (t + t² / STEADY),  Cov of rates = q (delta + 1 / STEADY)

with q in rad²/s, one for the recording. A hand that holds it sways about where it was, and comes
back. Instead of the walk that is a process of Ornstein and Uhlenbeck [1]_ with the time tau, and
the steady turn is smaller::

    Cov(angle(t), angle(s)) = q tau / 2 exp(-|t - s| / tau)

What is put down on foam, or let go of with its cable pulling, creeps besides, by ``a exp(-t / T)``
with any T of `TIMES`; the variance of a is in a ratio to q. The attitude of a pose is that of its
mean, which takes up what the angle is on average; what is left is how its parts differ.

References
----------
.. [1] Uhlenbeck, Ornstein, "On the theory of the Brownian motion", Phys. Rev. 36, 1930, p. 823.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from calib.types import BoolArray, FloatArray, IntArray

STEADY = 10.0
"""s after which the steady turn is as large as the walk: people sway in seconds, and shift their
weight in tens of seconds."""

TIMES = (0.5, 1.0, 2.0, 4.0)
"""s in which what was put down creeps to where it stays: foam, cables and hands that let go."""


class Sway(NamedTuple):
    """How an angle wanders: what is expected of q (rad²/s), tau (s), and a steady turn (1/s).

    Nothing is ``expected`` where gravity does not tell; of a walk tau, the time of coming ``back``,
    is infinite. ``steady`` is the variance of the steady rate, for q of one.
    """

    expected: float = 0.0
    back: float = np.inf
    steady: float = 1.0 / STEADY


WALK = Sway()
"""Of what nobody has told."""


@dataclass(frozen=True, eq=False)
class Lean:
    """n parts of rests, and what an angle does to them.

    Parameters
    ----------
    up : (n, 3) array
        Unit vectors.
    begin, length : (n,) arrays, s
        ``begin`` counts from where the pose does.
    pose : (n,) array of int
    gravity : float, m/s²
    size : (poses,) array
        Of q in each pose, beside that of most.
    creep : float, s
        Variance of the angle by which it creeps, for q of one.
    sway : Sway
        How it sways beside that.
    held : (poses,) array of bool
        Those in which its gyroscope tells how far it is turned at either end.
    """

    up: FloatArray
    begin: FloatArray
    length: FloatArray
    pose: IntArray
    gravity: float
    size: FloatArray
    creep: float = 0.0
    sway: Sway = WALK
    held: BoolArray = field(default_factory=lambda: np.zeros(0, bool))

    @classmethod
    def of(
        cls,
        up: FloatArray,
        interval: FloatArray,
        pose: IntArray,
        gravity: float,
        size: FloatArray | None = None,
        creep: float = 0.0,
        sway: Sway = WALK,
        held: BoolArray | None = None,
    ) -> Lean:
        """Return the lean in cells of poses; `up` is that of each pose, (poses, 3)."""
        first = np.full(len(up), np.inf)
        np.minimum.at(first, pose, interval[:, 0])
        begin, length = interval[:, 0] - first[pose], np.ptp(interval, axis=1)
        size = np.ones(len(up)) if size is None else size
        held = np.zeros(len(up), bool) if held is None else held
        return cls(up[pose], begin, length, pose, gravity, size, creep, sway, held)

    @property
    def told(self) -> bool:
        """Whether gravity has told, and not only the rates, that something leans."""
        return self.sway.expected > 0 or self.creep > 0 or bool((self.size > 1.0).any())

    def cut(self, at: Sequence[float]) -> Lean:
        """Return the same for parts of each cell, cut at these shares of its length."""
        edges = np.array([0.0, *at, 1.0])
        n = len(edges) - 1
        return replace(
            self,
            up=np.repeat(self.up, n, axis=0),
            begin=(self.begin[:, None] + self.length[:, None] * edges[:-1]).ravel(),
            length=(self.length[:, None] * np.diff(edges)).ravel(),
            pose=np.repeat(self.pose, n),
        )

    def of_angle(self) -> FloatArray:
        """Return the covariance of the angle's means about that of their pose for q of one, (n, n).

        In rad².
        """
        alike = self._alike()
        share = alike * self.length
        about = np.eye(len(self.length)) - share / share.sum(axis=1, keepdims=True)
        crept = self._rates() * np.array(TIMES)[:, None]
        angle = self._means() + self.creep * _product(crept)
        angle *= alike * self.size[self.pose]
        return np.asarray(about @ angle @ about.T)

    def of_force(self) -> FloatArray:
        """Return the covariance of the accelerometer's means for q of one, (3, n, 3, n).

        Gravity moves across itself, and keeps its length.
        """
        across = np.eye(3) - self.up[:, :, None] * self.up[:, None, :]
        return np.asarray(self.gravity**2 * np.einsum("nm,ncd->cndm", self.of_angle(), across))

    def covariance(self, channel: int) -> FloatArray:
        """Return the covariance of the means of one channel for q of one, (n, n)."""
        if channel < 3:
            across = self.gravity * np.sqrt(np.maximum(1.0 - np.square(self.up[:, channel]), 0.0))
            return np.asarray(self.of_angle() * np.outer(across, across))
        rates = self._turns() + self.creep * _product(self._rates())
        return np.asarray(rates * self._alike() * self.size[self.pose])

    def _means(self) -> FloatArray:
        """Return how the angle's means over parts of one pose go together, for q of one, (n, n)."""
        middle = self.begin + 0.5 * self.length
        if np.isfinite(self.sway.back):
            share = _fading(self.length / self.sway.back)
            end = self.begin + self.length
            gap = np.maximum.outer(self.begin, self.begin) - np.minimum.outer(end, end)
            angle = np.outer(share, share) * np.exp(-np.maximum(gap, 0.0) / self.sway.back)
            np.fill_diagonal(angle, 2.0 * (1.0 - share) * self.sway.back / self.length)
            angle *= 0.5 * self.sway.back
        else:
            angle = np.minimum.outer(middle, middle)
            # Of a walk from zero, the mean over a part.
            np.fill_diagonal(angle, self.begin + self.length / 3.0)
        return np.asarray(angle + self.sway.steady * np.outer(middle, middle))

    def _turns(self) -> FloatArray:
        """Return how mean rates of parts of one pose go together, for q of one, (n, n)."""
        if not np.isfinite(self.sway.back):
            return np.asarray(np.diag(1.0 / self.length) + self.sway.steady)
        ends = np.stack((self.begin, self.begin + self.length)) / self.sway.back
        apart = np.exp(-np.abs(ends[:, None, :, None] - ends[None, :, None, :]))
        angle = apart[0, 0] + apart[1, 1] - apart[0, 1] - apart[1, 0]
        return np.asarray(
            0.5 * self.sway.back * angle / np.outer(self.length, self.length) + self.sway.steady
        )

    def _rates(self) -> FloatArray:
        """Return the mean rates of what creeps by ``exp(-t / T)``, for each T, (times, n)."""
        time = np.array(TIMES)[:, None]
        return np.asarray(-np.exp(-self.begin / time) * np.expm1(-self.length / time) / self.length)

    def _alike(self) -> BoolArray:
        return np.asarray(self.pose[:, None] == self.pose)

    def at_ends(self) -> FloatArray:
        """Return the variance of the angle at either end of each pose about its mean, (poses,).

        For q of one, in rad²; none where the gyroscope has told it.
        """
        length = np.zeros(len(self.size))
        np.maximum.at(length, self.pose, self.begin + self.length)
        time = np.array(TIMES)[:, None]
        mean = -np.expm1(-length / time) * time / np.maximum(length, 1e-9)
        ends = np.square(1.0 - mean) + np.square(np.exp(-length / time) - mean)
        crept = self.creep * 0.5 * ends.mean(axis=0)
        angle = length / 3.0
        if np.isfinite(self.sway.back):
            share = _fading(length / self.sway.back)
            spread = self.sway.back / np.maximum(length, 1e-9) * (1.0 - share)
            angle = self.sway.back * (0.5 - share + spread)
        angle = angle + self.sway.steady * np.square(length) / 4.0 + crept
        return np.asarray(np.where(self.held, 0.0, self.size * angle))


def _fading(lasts: FloatArray) -> FloatArray:
    """Return the mean of ``exp(-t)`` from 0 to each of some times, of which none is negative."""
    return np.asarray(-np.expm1(-lasts) / np.maximum(lasts, 1e-12))


def _product(parts: FloatArray) -> FloatArray:
    """Return the products of (k, n) parts with each other, the mean of all k, (n, n)."""
    return np.asarray(parts.T @ parts / len(parts))
