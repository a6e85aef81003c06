"""Temperature from coarse, noisy and rarely read thermometers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib import thermometer
from calib.recording import Recording
from calib.thermometer import known_temperature, smooth_temperature
from calib.types import FloatArray

TIME = np.arange(0.0, 600.0, 0.01)
WARM = 28.0 + 8.0 * (1.0 - np.exp(-(TIME + 20.0) / 200.0))
SLOPE = 8.0 / 200.0 * np.exp(-(TIME + 20.0) / 200.0)


def held(values: FloatArray, samples: int) -> FloatArray:
    return np.repeat(values[::samples], samples)[: len(values)]


READ: dict[str, tuple[Callable[[FloatArray, np.random.Generator], FloatArray], float]] = {
    "fine": (lambda t, rng: t + rng.normal(0, 0.03, len(t)), 0.1),
    "noisy": (lambda t, rng: t + rng.normal(0, 0.3, len(t)), 0.3),
    "half degrees": (lambda t, rng: 0.5 * np.round(2 * t + rng.normal(0, 0.06, len(t))), 1.0),
    "degrees": (lambda t, rng: np.round(t + rng.normal(0, 0.03, len(t))), 1.0),
    "degrees without noise": (lambda t, rng: np.round(t), 2.0),
    "degrees, to and fro": (lambda t, rng: np.round(t + rng.normal(0, 0.2, len(t))), 0.5),
    "once a second": (lambda t, rng: held(t + rng.normal(0, 0.3, len(t)), 100), 1.5),
    "once in five seconds": (lambda t, rng: held(t + rng.normal(0, 0.3, len(t)), 500), 2.5),
    "degrees, once a second": (
        lambda t, rng: held(np.round(t + rng.normal(0, 0.3, len(t))), 100),
        2.0,
    ),
}
"""What thermometers make of a temperature, and how well its rate is known then, mK/s rms.

Moving means over ten seconds, twice, leave 5 to 17 mK/s for all but the first two.
"""


@pytest.mark.parametrize("kind", READ)
def test_rate_of_temperature_from_any_thermometer(kind: str) -> None:
    read, limit = READ[kind]
    for seed in range(3):
        reading = read(WARM, np.random.default_rng(seed))
        error = 1e3 * (smooth_temperature(TIME, reading).rate_at(TIME) - SLOPE)
        # Ends are known worse than all else.
        assert np.sqrt(np.mean(error[2000:-2000] ** 2)) < limit
        assert np.sqrt(np.mean(error**2)) < 1.5 * limit


@pytest.mark.parametrize("step", [0.0, 0.01, 0.0625, 0.5])
@pytest.mark.parametrize("cycles", [0.75, 1.5, 4.0])
def test_a_cycle_is_followed(step: float, cycles: float) -> None:
    """Of paths that are too smooth for it one may be worse than one that is smoother still."""
    time = TIME[:12000]
    cycle = 27.0 + 4.0 * np.sin(2 * np.pi * cycles * time / time[-1])
    reading = step * np.round(cycle / step) if step else cycle
    assert np.abs(smooth_temperature(time, reading)(time) - cycle).max() < 0.1 + 0.3 * step


@pytest.mark.parametrize("duration", [165.56, 130.1, 61.9])
def test_the_end_of_a_recording_is_no_later_than_it_is(duration: float) -> None:
    """However its length is to the cells in which readings are gathered."""
    time = np.arange(0.0, duration, 0.0025)
    true = 30.0 + 6.0 * np.cos(2 * np.pi * time / 110.0)
    rng = np.random.default_rng(3)
    found = smooth_temperature(time, true + rng.normal(0.0, 0.02, len(time)))
    last = time > duration - 3.0
    rate = -6.0 * 2 * np.pi / 110.0 * np.sin(2 * np.pi * time / 110.0)
    assert np.abs(found.rate_at(time) - rate)[last].max() < 0.01
    assert np.abs(found(time) - true)[last].max() < 0.01


def test_constant_temperature_has_no_rate() -> None:
    reading = 25.0 + np.random.default_rng(4).normal(0, 0.3, len(TIME))
    smooth = smooth_temperature(TIME, reading)
    assert np.abs(smooth.rate_at(TIME)).max() < 1e-3
    assert abs(smooth(TIME).mean() - 25.0) < 3 * 0.3 / np.sqrt(len(TIME)) + 1e-3


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 30])
def test_few_readings(n: int) -> None:
    time = np.arange(n) * 0.5
    smooth = smooth_temperature(time, 20.0 + 0.1 * time)
    np.testing.assert_allclose(smooth(time), 20.0 + 0.1 * time, atol=0.05)
    np.testing.assert_allclose(smooth.rate_at(time), 0.1 * (n > 1), atol=0.03)


def test_readings_that_are_missing_for_a_while() -> None:
    some = (TIME < 200.0) | (TIME > 260.0)
    reading = WARM + np.random.default_rng(5).normal(0, 0.03, len(WARM))
    smooth = smooth_temperature(TIME[some], reading[some])
    assert np.abs(smooth(TIME[some]) - WARM[some]).max() < 0.03


def test_stuck_reading_is_left_alone() -> None:
    stuck = np.full(1000, 31.0)
    known = smooth_temperature(TIME[:1000], stuck)
    assert np.array_equal(known(TIME[:1000]), stuck)
    assert not known.rate_at(TIME[:1000]).any()


def test_a_quick_change_is_followed() -> None:
    # A hot air gun at 200 s: 10 K in 15 s.
    path = 25.0 + 10.0 / (1.0 + np.exp(-(TIME - 200.0) / 3.0))
    reading = path + np.random.default_rng(6).normal(0, 0.1, len(TIME))
    assert np.abs(smooth_temperature(TIME, reading)(TIME) - path).max() < 0.3


def test_a_long_recording_s_temperature_is_known_in_little_memory(monkeypatch) -> None:
    reading = WARM + np.random.default_rng(7).normal(0, 0.05, len(WARM))
    still = np.zeros((len(TIME), 3))
    whole = Recording(time=TIME, accel=still, gyro=still, clock="device", temperature=reading)
    monkeypatch.setattr(thermometer, "MOST", 3000)
    parts = [whole.slice(k, k + 777) for k in range(0, len(whole), 777)]
    known = known_temperature(parts)
    assert known is not None
    assert np.abs(known(TIME) - WARM).max() < 0.06
    assert known_temperature([replace(part, temperature=None) for part in parts]) is None
    assert known_temperature([]) is None
