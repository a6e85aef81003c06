"""A hand that holds a sensor: how it sways is learnt from what gravity and rates both say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.noise.sensornoise import LEANING, sample_noise
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.sway import follow, follows
from calib.mismatch.rows.unequal import Leans, how_it_leans
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import also_turned

GRAVITY = 9.80665
RATE = 100.0


def laid(seed: int, *, poses: int = 24, lasts: tuple[float, float] = (3.0, 9.0)) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(
        rng, poses=poses, pose_duration=lasts, power_on=0.0, temperature=25.0, warm_up=0.0
    )
    return simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=RATE)


def swaying(seed: int, number: int, *, size: float, back: float) -> FloatArray:
    """Return angles (n, 3) that come back to where they were, with a smooth rate, rad."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-1 / (RATE * back))
    steps = size * np.sqrt(1 - keep**2) * rng.normal(size=(number, 3))
    angle = np.empty((number, 3))
    angle[0] = size * rng.normal(size=3)
    for k in range(1, number):
        angle[k] = keep * angle[k - 1] + steps[k]
    soft = np.hanning(int(0.3 * RATE))
    soft /= soft.sum()
    return np.stack([np.convolve(a, soft, mode="same") for a in angle.T], axis=1)


def leans(recording: Recording) -> Leans:
    grid = make_grid(recording, find_poses(recording))
    return how_it_leans(grid, sample_noise(grid), least=LEANING)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sway_is_learnt(seed: int) -> None:
    recording = laid(seed)
    size, back = 3e-3, 1.5
    found = leans(also_turned(recording, swaying(seed, len(recording.time), size=size, back=back)))
    assert 0.5 < found.sway.back < 4.0
    # Over seconds an angle differs by twice its variance.
    assert found.sway.expected * found.sway.back == pytest.approx(2 * size**2, rel=0.5)


@pytest.mark.parametrize("seed", range(6))
def test_none_is_on_a_table(seed: int) -> None:
    assert leans(laid(seed)).sway.expected == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_none_is_where_gravity_does_not_move(seed: int) -> None:
    """A gyroscope that fluctuates by as much turns nothing."""
    recording = laid(seed)
    angle = swaying(seed, len(recording.time), size=3e-3, back=1.5)
    rate = np.gradient(angle, recording.time, axis=0)
    assert leans(replace(recording, gyro=recording.gyro + rate)).sway.expected == 0.0


def test_rests_on_a_table_among_those_that_sway_lean_less() -> None:
    recording = laid(5)
    poses = find_poses(recording)
    angle = swaying(5, len(recording.time), size=5e-3, back=1.5)
    part = np.zeros(len(angle))
    for start, stop in zip(poses.start[::2], poses.stop[::2], strict=True):
        part[start:stop] = np.sin(np.linspace(0, np.pi, stop - start)) ** 0.2
    found = leans(also_turned(recording, angle * part[:, None]))
    assert found.sway.expected > 0
    assert found.size is not None
    assert np.median(found.size[1::2]) < 0.5 * np.median(found.size[::2])


def test_gravity_follows_the_turn_that_moves_it() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(40) * 0.25
    angle = np.cumsum(rng.normal(0.0, 1e-3, (40, 3)), axis=0)
    gravity = np.array([0.0, 6.0, 8.0])
    force = gravity - np.cross(angle, gravity) + 1e-3 * rng.normal(size=(40, 3))
    rate = np.gradient(angle, time, axis=0)
    noise = np.full(3, 1e-3)
    assert follows(*follow(time, force, rate, noise))
    assert not follows(*follow(time, force, -rate, noise))
    assert not follows(*follow(time, force, rate[::-1], noise))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_nothing_is_named_for_a_hand(seed: int) -> None:
    recording = laid(seed, lasts=((1.5, 4.0), (3.0, 9.0), (5.0, 20.0))[seed % 3])
    angle = swaying(seed, len(recording.time), size=3e-3, back=1.5)
    found = diagnose_recording(also_turned(recording, angle), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == []
    assert found.unexplained == ()
