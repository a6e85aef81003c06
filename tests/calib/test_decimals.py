"""Logs that keep so many digits: what holds for small values and their counts is not for others."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from calib.decimals import counts_at
from calib.faults import find_spikes, find_stuck, resolution
from calib.frozen import find_frozen
from calib.types import BoolArray, FloatArray


def rounded(values: FloatArray, digits: int) -> FloatArray:
    """Return values as a log with so many digits has them."""
    flat = [float(f"{v:.{digits}g}") for v in values.ravel()]
    return np.array(flat).reshape(values.shape)


def moved(*, seed: int = 0, rests: int = 12) -> tuple[FloatArray, BoolArray]:
    """Return six channels (n, 6) of a sensor that turns between rests, and where it does.

    Its accelerometer reads up to 13 m/s² at rest, where three digits step by 0.1, and its
    gyroscope turns steadily for a while, by up to 2 rad/s.
    """
    rng = np.random.default_rng(seed)
    number = 400
    ramp = np.minimum(1.0, np.minimum(np.arange(number), np.arange(number)[::-1]) / 100.0)
    parts, moving = [], []
    force = rng.uniform(-13.0, 13.0, (rests, 3))
    for k in range(rests):
        parts.append(np.hstack((np.tile(force[k], (number, 1)), np.full((number, 3), 0.011))))
        moving.append(np.zeros(number, bool))
        if k < rests - 1:
            way = np.linspace(0.0, 1.0, number)[:, None]
            turn = np.outer(ramp, rng.uniform(-2.0, 2.0, 3)) + 0.011
            parts.append(np.hstack((force[k] + way * (force[k + 1] - force[k]), turn)))
            moving.append(np.ones(number, bool))
    values = np.concatenate(parts)
    values += rng.standard_normal(values.shape) * ([0.02] * 3 + [0.001] * 3)
    return values, np.concatenate(moving)


def test_counts_grow_with_values() -> None:
    rng = np.random.default_rng(1)
    values = rounded(np.exp(rng.uniform(np.log(0.02), np.log(50.0), (4000, 1))), 3)
    step = resolution(values)
    held = counts_at(np.sort(values, axis=0), step)[:, 0]
    place = np.sort(values[:, 0])
    for low, high, count in ((0.2, 0.9, 1e-3), (2.0, 9.0, 1e-2), (20.0, 50.0, 1e-1)):
        assert_allclose(held[(place > low) & (place < high)], count)


@pytest.mark.parametrize("unit", [1.0, 9.80665, np.pi / 180.0])
def test_digits_are_seen_in_the_unit_of_the_log(unit: float) -> None:
    values = rounded(moved()[0][:, :1], 3) * unit
    held = counts_at(values, resolution(values))
    assert_allclose(held.max(), 0.1 * unit)


@pytest.mark.parametrize("decimals", [1, 2, 3, 6])
def test_log_with_so_many_decimals_has_one_count(decimals: int) -> None:
    values = np.round(moved()[0], decimals)
    step = resolution(values)
    assert_allclose(counts_at(values, step), np.broadcast_to(step, values.shape), rtol=1e-9)


@pytest.mark.parametrize("lsb", [9.80665 / 2048, 0.25, 1.0])
def test_counts_of_a_converter_are_all_alike(lsb: float) -> None:
    values = np.rint(moved()[0] * 40.0 / lsb) * lsb
    step = resolution(values)
    assert_allclose(counts_at(values, step), np.broadcast_to(step, values.shape), rtol=1e-9)


def test_half_precision_is_left_as_it_is() -> None:
    values = moved()[0].astype(np.float16).astype(np.float64)
    step = resolution(values)
    assert_array_equal(counts_at(values, step), np.broadcast_to(step, values.shape))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("digits", [3, 4, 5])
def test_nothing_is_stuck_or_off_course(digits: int, seed: int) -> None:
    exact, moving = moved(seed=seed)
    values = rounded(exact, digits)
    none = np.zeros(values.shape, bool)
    assert find_stuck(values, moving, interval=0.01, clipped=none) == []
    assert find_frozen(values, moving, clipped=none, known=none[:, 0]) == []
    assert find_spikes(values, lsb=resolution(values)) == []


@pytest.mark.parametrize("digits", [3, 5])
def test_channel_that_is_stuck_is_still_seen(digits: int) -> None:
    exact, moving = moved()
    exact[900:1700, 4] = exact[900, 4]
    values = rounded(exact, digits)
    none = np.zeros(values.shape, bool)
    ((c, start, stop),) = find_stuck(values, moving, interval=0.01, clipped=none)
    assert c == 4
    assert_allclose((start, stop), (900, 1700), atol=3)


@pytest.mark.parametrize("digits", [3, 5])
def test_spike_is_still_seen(digits: int) -> None:
    exact, _ = moved()
    exact[1000, 1] += 4.0
    values = rounded(exact, digits)
    assert [c for *_, c in find_spikes(values, lsb=resolution(values))] == [1]
