"""How late a triad is: roughly found, and put into columns."""

import numpy as np
import pytest

from calib.mismatch.reference.lateness import REACH, delaying, rough_delay


def turning(time, rng):
    """Turns of two seconds with a tremor of 9 Hz on them, three channels."""
    slow = np.sin(np.pi * time[:, None] / np.array([2.0, 2.6, 3.1])) ** 3
    return slow + 0.05 * np.sin(2 * np.pi * 9.0 * time[:, None] + rng.uniform(0, 6, 3))


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
@pytest.mark.parametrize("late", [(0.0, 0.04), (0.0123, -0.03), (-0.11, 0.0)])
def test_each_triad_is_placed_to_a_part_of_a_sample(rate, late):
    time = np.arange(0.0, 60.0, 1.0 / rate)

    def signals(delays):
        rng = np.random.default_rng(3)
        return np.hstack([turning(time - delay, rng) for delay in delays])

    noise = np.random.default_rng(4).normal(0.0, 0.02, (len(time), 6))
    gain, bias = 1.02, 0.3
    found = rough_delay(gain * signals(late) + bias + noise, signals((0.0, 0.0)), 1.0 / rate)
    assert found == pytest.approx(late, abs=0.001)


def test_beyond_the_search_nothing_is_said():
    time = np.arange(0.0, 60.0, 0.01)
    once = np.exp(-np.square((time - 30.0) / 0.1))[:, None] * np.ones(3)
    early = np.exp(-np.square((time - 29.0) / 0.1))[:, None] * np.ones(3)
    true, measured = np.hstack((once, early)), np.hstack((once, once))
    assert rough_delay(measured, true, 0.01)[0] == pytest.approx(0.0, abs=1e-9)
    assert abs(rough_delay(measured, true, 0.01)[1]) <= REACH


@pytest.mark.parametrize("delay", [0.04, -0.03, 0.0137, 0.0])
def test_a_delayed_signal_is_that_of_the_time_before(delay):
    # At 50 Hz, a tremor of 6 Hz has eight samples.
    time = np.arange(0.0, 10.0, 0.02)
    inner = slice(10, -10)
    omega = 2 * np.pi * 6.0
    found = delaying(time, delay) @ np.sin(omega * time)
    # A cubic's error is at most (w h)^4 3 / 128.
    bound = (omega * 0.02) ** 4 * 3 / 128 + 1e-12
    np.testing.assert_allclose(found[inner], np.sin(omega * (time - delay))[inner], atol=bound)
    assert delaying(time, delay).sum(axis=1) == pytest.approx(1.0)


def test_ends_are_held():
    time = np.arange(0.0, 1.0, 0.01)
    found = delaying(time, 0.05) @ (1.0 + time)
    np.testing.assert_allclose(found[:5], 1.0, atol=1e-12)
