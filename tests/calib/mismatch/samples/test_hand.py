"""What a hand does to samples at rest is no disturbance of either triad."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.samples.hand import held_in_hand
from calib.mismatch.samples.resting import look_at_rests
from calib.mismatch.samples.spectrum import LOUDER_THERE
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses


def made(seed: int, *, sway: float, swayed: float, tremor: float = 0.0) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(
        rng,
        poses=20,
        pose_duration=(4.0, 10.0),
        temperature=None,
        sway=sway,
        swayed=swayed,
        hold_tremor=tremor,
    )
    return simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)


def throughout(recording: Recording) -> Unexplained:
    where = (float(recording.time[0]), float(recording.time[-1]))
    return Unexplained(("gyro.x",), (where,), LOUDER_THERE, 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_hand_is_told_by_gravity(seed: int) -> None:
    swaying, laid = made(seed, sway=1.0, swayed=1.0), made(seed, sway=0.0, swayed=0.0)
    assert held_in_hand([throughout(swaying)], swaying, find_poses(swaying))
    assert not held_in_hand([throughout(laid)], laid, find_poses(laid))


@pytest.mark.parametrize("seed", range(4))
def test_a_few_rests_in_a_hand_are_not_louder(seed: int) -> None:
    recording = made(seed, sway=1.0, swayed=0.3)
    assert look_at_rests(recording, find_poses(recording)) == ()


@pytest.mark.parametrize("seed", range(4))
def test_a_tremor_has_no_line(seed: int) -> None:
    recording = made(seed, sway=1.0, swayed=1.0, tremor=0.2)
    assert look_at_rests(recording, find_poses(recording)) == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_gyroscope_that_is_louder_in_a_hand_is_said(seed: int) -> None:
    """What is faster than a hand is not its doing."""
    recording = made(seed, sway=1.0, swayed=0.3)
    poses = find_poses(recording)
    rng = np.random.default_rng(seed)
    own = slice(poses.start[8], poses.stop[10])
    noise = recording.gyro[poses.start[8] : poses.stop[8], 1]
    louder = 4 * np.diff(noise).std() / np.sqrt(2)
    gyro = recording.gyro.copy()
    gyro[own, 1] += louder * rng.normal(size=own.stop - own.start)
    recording = replace(recording, gyro=gyro)
    found = look_at_rests(recording, poses)
    assert {item.channels for item in found} == {("gyro.y",)}
    (said,) = (item.intervals for item in found if item.follows == LOUDER_THERE)
    a, b = poses.interval[8, 0], poses.interval[10, 1]
    (begin, end), *_ = said
    assert min(b, end) - max(a, begin) > 0.5 * max(b - a, end - begin)
