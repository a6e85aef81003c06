"""A channel that is late in a part of a recording says so, without any truth beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665


def recorded(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=30, pose_duration=(3.0, 6.0), warm_up=0.0)
    return simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "axis"), [(1, 0), (2, 1), (3, 2)])
def test_an_axis_that_is_late_for_a_while_is_unexplained_there(seed: int, axis: int) -> None:
    real = recorded(seed)
    begin, end = np.array([0.3, 0.65]) * real.time[-1]
    slope = np.gradient(real.gyro[:, axis], real.time)
    within = (real.time >= begin) & (real.time <= end)
    gyro = real.gyro.copy()
    gyro[:, axis] -= 1e-3 * slope * within
    found = diagnose_recording(replace(real, gyro=gyro), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == ("delay in a window", (f"gyro.{'xyz'[axis]}",))
    (first, last), *_ = left.intervals
    assert min(last, end) - max(first, begin) > 0.5 * (max(last, end) - min(first, begin))


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_late_where_nothing_is(seed: int) -> None:
    found = diagnose_recording(recorded(seed), gravity=GRAVITY)
    assert found.verdict == "consistent"
