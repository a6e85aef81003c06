"""Gyroscopes that are set to one value at rest."""

import numpy as np
import pytest

from calib.gated import find_gated
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

ALL = [3, 4, 5]


def made(seed: int, *, rate: float = 100.0, noise: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return values (n, 6) of a sensor that turns, and where it does."""
    rng = np.random.default_rng(seed)
    sensor = SensorModel(gyro=Triad(rng.normal(0.0, 2e-3, 3)))
    motion = bench_protocol(rng, poses=20)
    real: Recording = simulate(motion, sensor, CONSUMER.scaled(noise), rng=rng, rate=rate)
    poses = find_poses(real)
    moving = np.ones(len(real), bool)
    for a, b in zip(poses.start, poses.stop, strict=True):
        moving[a:b] = False
    return np.hstack((real.accel, real.gyro)), moving


@pytest.mark.parametrize("rate", [25.0, 100.0, 400.0])
def test_a_dead_band_and_a_zero_at_rest_are_found(rate: float) -> None:
    values, moving = made(1, rate=rate)
    banded = values.copy()
    banded[:, 3:][np.abs(banded[:, 3:]) < 0.02] = 0.0
    assert find_gated(banded, moving) == ALL
    zeroed = values.copy()
    zeroed[~moving, 3:] = 0.0
    zeroed = 5e-5 * np.rint(zeroed / 5e-5)
    assert find_gated(zeroed, moving) == ALL


@pytest.mark.parametrize("rate", [25.0, 100.0, 400.0])
@pytest.mark.parametrize("counts", [0.3, 3.0, 30.0])
def test_coarse_counts_are_no_gate(rate: float, counts: float) -> None:
    """In counts of so many noises each leaves what it reads at rest by one of them."""
    for seed in range(3):
        values, moving = made(seed, rate=rate, noise=0.3)
        lsb = counts * float(values[~moving, 3].std())
        rounded = values.copy()
        rounded[:, 3:] = lsb * np.rint(rounded[:, 3:] / lsb)
        assert find_gated(rounded, moving) == []


def test_without_rest_or_without_motion_there_is_nothing_to_tell() -> None:
    values, moving = made(2)
    values[:, 3:] = 0.0
    assert find_gated(values, moving) == []
    assert find_gated(values, np.zeros(len(values), bool)) == []
    assert find_gated(values, np.ones(len(values), bool)) == []
