"""Smooth steps from rest to rest, with their derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Polynomial

from calib.simulation.kinematics import Angle
from calib.types import FloatArray

MINIMUM_JERK = Polynomial([0, 0, 0, 10, -15, 6])
"""From 0 to 1 over u = 0..1, with no rate and no acceleration at either end.

References
----------
.. [1] T. Flash, N. Hogan, "The coordination of arm movements: an experimentally confirmed
   mathematical model", J. Neuroscience 5(7), 1985: how people move a hand from rest to rest.
"""

HUMP = 64 * Polynomial([0, 0, 0, 1, -3, 3, -1])
"""``64 u³ (1 - u)³``: from 0 to 1 and back, with no rate and no acceleration at either end."""


def evaluate(shape: Polynomial, u: FloatArray, duration: FloatArray | float) -> Angle:
    """Return a profile and its time derivatives at ``u`` in 0..1 of `duration` seconds."""
    first, second = shape.deriv(1), shape.deriv(2)
    return Angle(shape(u), first(u) / duration, second(u) / duration**2)


def combine(first: Angle, second: Angle) -> Angle:
    """Return the product of two functions of time, by the product rule."""
    return Angle(
        first.value * second.value,
        first.rate * second.value + first.value * second.rate,
        first.acceleration * second.value
        + 2 * first.rate * second.rate
        + first.value * second.acceleration,
    )


def scaled(angle: Angle, factor: FloatArray | float) -> Angle:
    """Return the profile times a factor, (n,) or scalar, that does not change in time."""
    return Angle(angle.value * factor, angle.rate * factor, angle.acceleration * factor)


def summed(first: Angle, second: Angle) -> Angle:
    """Return the sum of two functions of time."""
    return Angle(*(a + b for a, b in zip(first, second, strict=True)))


def random_sinusoids(
    rng: np.random.Generator, *, rms: float, low: float, high: float, count: int = 5
) -> Callable[[FloatArray], Angle]:
    """Return a function of time: `count` sinusoids between `low` and `high` Hz, together `rms`."""
    frequency = 2 * np.pi * rng.uniform(low, high, count)
    phase = rng.uniform(0, 2 * np.pi, count)
    amplitude = rng.rayleigh(1.0, count)
    amplitude *= rms * np.sqrt(2 / np.sum(amplitude**2))

    def at(time: FloatArray) -> Angle:
        out = np.zeros((3, len(time)))
        for w, p, a in zip(frequency, phase, amplitude, strict=True):
            sine, cosine = a * np.sin(w * time + p), a * np.cos(w * time + p)
            out += np.stack([sine, w * cosine, -w * w * sine])
        return Angle(*out)

    return at
