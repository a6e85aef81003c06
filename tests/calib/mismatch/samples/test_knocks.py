"""What rings is of a knock; what sways in a hand, or is louder throughout, is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.samples.knocks import PART, knocked
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses


def made(seed: int, *, sway: float = 0.0) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=10, temperature=None, sway=sway)
    return simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)


@pytest.mark.parametrize("sway", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_hand_that_sways_is_no_knock(seed: int, sway: float) -> None:
    recording = made(seed, sway=sway)
    assert knocked(recording, find_poses(recording)).mean() < 0.02


@pytest.mark.parametrize("sway", [0.0, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_what_rings_is_one(seed: int, sway: float) -> None:
    recording = made(seed, sway=sway)
    poses = find_poses(recording)
    at = int(poses.start[4] + poses.stop[4]) // 2
    since = np.arange(len(recording) - at) * recording.interval
    ring = np.exp(-since / 0.05) * np.sin(2 * np.pi * 20.0 * since + 1.0)
    accel, gyro = recording.accel.copy(), recording.gyro.copy()
    accel[at:] += 1.0 * ring[:, None]
    gyro[at:] += 0.05 * ring[:, None]
    found = knocked(replace(recording, accel=accel, gyro=gyro), poses)
    assert found[at : at + PART].all()
    assert found.sum() <= 10 * PART
