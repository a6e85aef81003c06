"""Channels that wrap around at the end of their range."""

import numpy as np
import pytest

from calib.audit import audit
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.wrapped import find_wrapped


def simulated(seed: int, rate: float) -> Recording:
    rng = np.random.default_rng(seed)
    return simulate(bench_protocol(rng, poses=16), SensorModel(), CONSUMER, rng=rng, rate=rate)


@pytest.mark.parametrize("rate", [100.0, 200.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_samples_beyond_the_range_are_found_and_no_others(seed: int, rate: float) -> None:
    real = simulated(seed, rate)
    values = np.hstack((real.accel, real.gyro))
    assert find_wrapped(values, real.time, real.interval) == []
    for c in (3, 4, 5):
        own = values.copy()
        end = 0.8 * float(np.abs(values[:, c]).max())
        own[:, c] = (own[:, c] + end) % (2 * end) - end
        off = np.zeros(len(own), bool)
        for channel, start, stop in find_wrapped(own, real.time, real.interval):
            assert channel == c
            off[start:stop] = True
        np.testing.assert_array_equal(off, np.abs(values[:, c]) > end)


def test_what_shakes_or_is_clipped_does_not_wrap() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 20.0, 0.016)
    shaken = 30.0 * np.sin(2 * np.pi * 24.0 * time[:, None] + np.arange(6.0))
    shaken[: len(time) // 2] = 0.0
    shaken += 0.01 * rng.normal(size=shaken.shape)
    assert find_wrapped(shaken, time, 0.016) == []
    assert find_wrapped(np.clip(shaken, -20.0, 20.0), time, 0.016) == []


def test_what_is_turned_over_between_samples_does_not_wrap() -> None:
    """By a slow log, or in a hole of one."""
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 400.0, 1.0)
    values = 0.01 * rng.normal(size=(len(time), 6))
    values[:, 0] += 9.8 * np.where((time // 100) % 2, 1.0, -1.0)
    assert find_wrapped(values, time, 1.0) == []
    time = 0.01 * time + 60.0 * (time // 100)
    assert find_wrapped(3.0 * values, time, 0.01) == []


def test_the_audit_says_where_it_wraps() -> None:
    real = simulated(1, 100.0)
    gyro = real.gyro.copy()
    end = 0.8 * float(np.abs(gyro[:, 1]).max())
    gyro[:, 1] = (gyro[:, 1] + end) % (2 * end) - end
    found = audit(Recording(real.time, real.accel, gyro, "device")).findings
    assert [f.channels for f in found if f.kind == "wrapped"][:1] == [("gyro.y",)]
