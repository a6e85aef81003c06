"""What a truth jumps by between two samples: the sensor turns by less."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch.reference.slips import find_slips

RATE = 100.0
TIME = np.arange(2000) / RATE


def compared(jump: float, *, corner: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what is left of the gyroscope, its samples, and where the truth is not known."""
    rng = np.random.default_rng(4)
    noise = rng.normal(0.0, 1e-3, (len(TIME), 3))
    rate = noise + np.where(TIME > 10.003, corner, 0.0)[:, None] * [0.0, 0.0, 1.0]
    left = noise.copy()
    # The spline through a jump rings, and sums up to it.
    ring = np.array([0.2, -0.6, 0.9, 0.9, -0.6, 0.2])
    left[998:1004, 2] += ring * (RATE * jump - 0.3 * corner)
    unknown = (TIME > 9.7) & (TIME < 10.3)
    return left, rate, unknown


def test_a_jump_is_said_with_its_size_axis_and_moment() -> None:
    left, rate, unknown = compared(np.radians(-0.5))
    (found,) = find_slips(TIME, left, rate, unknown, 1.0 / RATE)
    assert found.channels == ("gyro.z",)
    assert "by 0.5°" in found.follows
    ((start, stop),) = found.intervals
    assert start == pytest.approx(9.7, abs=0.02)
    assert stop == pytest.approx(10.3, abs=0.02)


def test_what_samples_miss_of_a_corner_is_no_jump() -> None:
    """A turn that begins between two samples: neither tells when."""
    left, rate, unknown = compared(0.0, corner=3.0)
    assert not find_slips(TIME, left, rate, unknown, 1.0 / RATE)
    assert not find_slips(TIME, *compared(0.0), 1.0 / RATE)
    assert not find_slips(TIME, left, rate, np.ones(len(TIME), bool), 1.0 / RATE)


def test_what_a_coarse_count_rounds_is_no_jump() -> None:
    """At rest most samples are equal: their median scatter is none, and rounding does not end."""
    left, rate, unknown = compared(0.0)
    lsb = 3e-3
    lost = np.rint((rate + 0.4 * lsb) / lsb) * lsb - rate
    assert not find_slips(TIME, left + lost, rate + lost, unknown, 1.0 / RATE)
    left, rate, unknown = compared(np.radians(-0.5))
    lost = np.rint((rate + 0.4 * lsb) / lsb) * lsb - rate
    (found,) = find_slips(TIME, left + lost, rate + lost, unknown, 1.0 / RATE)
    assert found.channels == ("gyro.z",)
