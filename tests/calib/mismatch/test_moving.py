"""A bias that goes to another level in half a minute is no step of it."""

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
LASTS = 30.0


def moved(seed: int, channels: list[int], by: float, *, lasts: float) -> tuple[Recording, float]:
    """Return a recording whose bias begins to move at a time, which is returned as well."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=30, pose_duration=(3.0, 6.0), warm_up=0.0)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    begin = 0.4 * real.time[-1]
    bias = np.zeros((len(real.time), 6))
    share = np.clip((real.time - begin) / lasts, 0.0, 1.0)
    bias[:, channels] = by * np.outer(share, [1.0, -0.7, 0.5][: len(channels)])
    return replace(real, accel=real.accel + bias[:, :3], gyro=real.gyro + bias[:, 3:]), begin


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "channels", "by"),
    [(1, [0], 0.03), (2, [3, 4, 5], 1.5e-3), (3, [4], 1.5e-3), (4, [0, 1, 2], 0.03)],
)
def test_a_bias_that_moves_is_unexplained_from_then_on(
    seed: int, channels: list[int], by: float
) -> None:
    real, begin = moved(seed, channels, by, lasts=LASTS)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert left.follows == "bias that moves to another level"
    assert set(left.channels) <= {("accel.", "gyro.")[c // 3] + "xyz"[c % 3] for c in channels}
    ((first, last),) = left.intervals
    assert abs(first - begin) < LASTS / 2
    assert last == pytest.approx(real.time[-1], abs=1.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "channels", "by", "name"),
    [(1, [0], 0.03, "accel_bias_step"), (2, [3, 4, 5], 1.5e-3, "gyro_bias_step")],
)
def test_a_step_stays_a_step(seed: int, channels: list[int], by: float, name: str) -> None:
    real, _ = moved(seed, channels, by, lasts=1e-3)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == [name]
    assert not found.unexplained
