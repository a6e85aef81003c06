"""Rests that creep after they were put down lean more than others; a gyroscope's own changes no."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.noise.sensornoise import LEANING, sample_noise
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.unequal import how_it_leans
from calib.model import SensorModel
from calib.poses import average_poses
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import also_turned

GRAVITY = 9.80665


def made(seed: int, poses: int = 22) -> tuple[Motion, Recording]:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(
        rng, poses=poses, pose_duration=(2.0, 12.0), power_on=0.0, temperature=25.0
    )
    return motion, simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)


def creep(motion: Motion, time: FloatArray, degrees: FloatArray, seed: int) -> FloatArray:
    """Return by how far a sensor (n, 3) creeps in each rest, rad; the turn after it undoes that."""
    rng = np.random.default_rng(seed)
    out = np.zeros((len(time), 3))
    rests = [s for s in motion.segments if s.kind != "turn"]
    for rest, after, size in zip(rests, [*rests[1:], None], degrees, strict=True):
        since = np.maximum(time - rest.start, 0.0)
        begin = 0.5 - 0.5 * np.cos(np.pi * np.minimum(since / 0.4, 1.0))
        part = (1 - np.exp(-since / rng.uniform(0.7, 4.0))) * begin
        if after is not None:
            back = np.clip((time - rest.stop) / (after.start - rest.stop), 0.0, 1.0)
            part *= 1 - back**3 * (10 - 15 * back + 6 * back**2)
        out += np.outer(part, np.radians(size) * rng.normal(size=3))
    return out


def leans(recording: Recording) -> tuple[FloatArray, FloatArray, float]:
    """Return how much more each pose leans, when it is, and how much all creep as they begin."""
    grid = make_grid(recording, find_poses(recording))
    size, creep, *_ = how_it_leans(grid, sample_noise(grid), least=LEANING)
    assert size is not None
    middle = [grid.time[grid.pose == k].mean() for k in range(grid.n_poses)]
    return size, np.array(middle), creep


def test_those_that_creep_far_lean_by_more() -> None:
    motion, recording = made(2)
    rests = [s for s in motion.segments if s.kind != "turn"]
    far = np.array([k % 6 == 3 for k in range(len(rests))])
    degrees = np.where(far, 0.25, 0.02)
    found, middle, _ = leans(also_turned(recording, creep(motion, recording.time, degrees, 5)))
    which = np.searchsorted([s.stop for s in rests], middle)
    assert (found[~far[which]] < 3.0).all()
    assert (found[far[which]] > 4.0).sum() >= 2
    assert (found >= 1.0).all()


@pytest.mark.parametrize("seed", [1, 4])
def test_none_does_on_a_table(seed: int) -> None:
    found, _, crept = leans(made(seed)[1])
    assert crept == 0.0
    assert (found < 4.0).all()
    assert (found == 1.0).mean() > 0.85


def test_what_the_gyroscope_alone_shows_is_no_lean() -> None:
    motion, recording = made(2)
    rests = [s for s in motion.segments if s.kind != "turn"]
    degrees = np.where([k % 6 == 3 for k in range(len(rests))], 0.25, 0.0)
    angle = creep(motion, recording.time, degrees, 5)
    rate = np.gradient(angle, recording.time, axis=0)
    found, _, crept = leans(replace(recording, gyro=recording.gyro + rate))
    assert (found < 4.0).all()
    assert crept == 0.0


@pytest.mark.parametrize("seed", [2, 3])
def test_what_all_rests_begin_with_is_creep_where_gravity_moves(seed: int) -> None:
    motion, recording = made(seed)
    rests = sum(s.kind != "turn" for s in motion.segments)
    angle = creep(motion, recording.time, np.full(rests, 0.17), seed)
    assert leans(also_turned(recording, angle))[2] > 10.0
    # Of the gyroscope alone it is something that it remembers of turns.
    rate = np.gradient(angle, recording.time, axis=0)
    assert leans(replace(recording, gyro=recording.gyro + rate))[2] == 0.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 6, 8, 9])
def test_nothing_is_named_for_a_sensor_also_turned(seed: int) -> None:
    motion, recording = made(seed)
    rests = sum(s.kind != "turn" for s in motion.segments)
    angle = creep(motion, recording.time, np.full(rests, 0.17), seed)
    found = diagnose_recording(also_turned(recording, angle), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == []
    assert found.unexplained == ()


@pytest.mark.parametrize("seed", range(4))
def test_what_is_left_of_a_rest_in_a_hand_sways_as_the_others_do(seed: int) -> None:
    """In three quarters of a second no hand turns back: the parts of that are alike."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=24, temperature=None, sway=1.5)
    recording = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    poses = find_poses(recording)
    brief = np.arange(len(poses)) % 5 == 2
    stop = np.where(brief, np.minimum(poses.start + 75, poses.stop), poses.stop)
    grid = make_grid(recording, average_poses(recording, poses.start, stop))
    found = how_it_leans(grid, sample_noise(grid), least=LEANING)
    assert found.sway.expected
    assert found.size is not None
    assert (found.size[brief] >= 1.0).all()
