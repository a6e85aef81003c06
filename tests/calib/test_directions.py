"""Where gravity points at the ends of a turn: laid down, swaying, and with a bias that drifts."""

from dataclasses import replace

import numpy as np
import pytest

from calib.directions import closure_errors, find_sway, follow
from calib.model import SensorModel, Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import NoiseModel
from calib.solvers import gyro_solvers
from calib.statics import find_poses
from calib.turns import find_turns

GYRO = Triad(
    np.array([0.01, -0.02, 0.015]),
    np.array([0.02, -0.01, 0.03]),
    0.01 * np.array([[0, 1, -1], [1, 0, 1], [-1, 1, 0]]),
)
NOISE = NoiseModel(accel_noise_density=5e-3, gyro_noise_density=2e-4)


def record(
    seed: int, *, sway: float = 0.0, swayed: float = 1.0, poses: int = 25, tremor: float = 0.1
) -> tuple[Motion, Recording, Poses]:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(
        rng, poses=poses, temperature=None, sway=sway, swayed=swayed, hold_tremor=tremor
    )
    recording = simulate(motion, SensorModel(gyro=GYRO), NOISE, rng=rng, rate=100.0)
    return motion, recording, find_poses(recording)


def wander(motion: Motion, poses: Poses) -> np.ndarray:
    """Return by how much the true direction of gravity moves within each pose, rad rms."""
    ups = [motion.state(np.linspace(*interval, 50)).mat_ns[:, 2] for interval in poses.interval]
    return np.array([np.sqrt(np.var(up, axis=0).sum()) for up in ups])


def test_what_is_laid_down_does_not_sway() -> None:
    for seed in range(8):
        _, recording, poses = record(seed, poses=12, tremor=0.0)
        sway = find_sway(recording, poses, Triad(), GYRO)
        assert not sway.gain.any()
        # N² / 2, from a dozen rests of a few seconds.
        assert sway.noise < 3 * (2e-4) ** 2 / 2


@pytest.mark.parametrize("seed", [3, 4])
def test_sway_is_seen_where_it_is_and_directions_follow_it(seed: int) -> None:
    motion, recording, poses = record(seed, sway=1.0, swayed=0.3)
    gain = find_sway(recording, poses, Triad(), GYRO).gain
    moved = wander(motion, poses)
    swayed = moved > np.radians(0.1)
    assert 3 < swayed.sum() < 15
    # A hand also pushes: some of its poses hide their sway in that.
    assert (gain[swayed] > 0).mean() > 0.6
    assert not gain[~swayed].any()
    assert gain[gain > 0].min() > 0.8

    turns = find_turns(recording, poses)
    _, directions = follow(recording, poses, turns, Triad(), GYRO, gain)
    middle = recording.time[(poses.start + poses.stop) // 2]
    true = motion.state(middle).mat_ns[:, 2]
    found = gain > 0
    error = np.linalg.norm(directions.up - true, axis=1)[found]
    size = np.sqrt(2 * directions.covariance[found, 0, 0])
    assert np.degrees(np.sqrt(np.mean(error**2))) < 0.06
    # What a hand pushes one way it pushes back: the covariance errs on the safe side.
    assert 0.1 < np.mean((error / size) ** 2) < 2
    # Where nothing sways it is the mean over the pose, and the turn that between their ends.
    force = poses.accel[~found]
    expected = force / np.linalg.norm(force, axis=1, keepdims=True)
    np.testing.assert_allclose(directions.up[~found], expected, rtol=1e-12)


def test_no_gain_is_the_turn_between_the_ends() -> None:
    _, recording, poses = record(4, poses=6)
    turns = find_turns(recording, poses)
    steps, _ = follow(recording, poses, turns, Triad(), GYRO, np.zeros(len(poses)))
    np.testing.assert_allclose(steps.duration, turns.interval[:, 1] - turns.interval[:, 0])
    steps, _ = follow(recording, poses, turns, Triad(), GYRO, np.full(len(poses), 0.5))
    middle = recording.time[(poses.start + poses.stop) // 2]
    inside = np.diff(middle) - steps.duration
    # Half of the time inside the poses counts.
    rest = poses.interval[:, 1] - poses.interval[:, 0]
    np.testing.assert_allclose(inside, 0.25 * (rest[:-1] + rest[1:]), atol=0.02)


def test_a_bias_that_drifts_is_no_sway() -> None:
    # 0.1 deg/s a minute, and an accelerometer that settles at the same time.
    _, recording, poses = record(5, tremor=0.0)
    since = recording.time / 60
    drift = np.radians(0.1) * since[:, None] * np.array([1.0, -1.0, 0.5])
    settle = 0.02 * np.exp(-since)[:, None] * np.array([1.0, 1.0, 1.0])
    drifting = replace(recording, gyro=recording.gyro + drift, accel=recording.accel + settle)
    assert not find_sway(drifting, poses, Triad(), GYRO).gain.any()


@pytest.mark.parametrize("swayed", [0.25, 1.0])
@pytest.mark.long
def test_a_hand_that_sways_does_not_spoil_the_calibration(swayed: float) -> None:
    truth = np.array(list(GYRO.parameters("gyro").values()))
    distances, errors = [], []
    for seed in range(20, 28):
        _, recording, poses = record(seed, sway=1.0, swayed=swayed)
        turns = find_turns(recording, poses)
        fit = gyro_solvers()["rotation_segment_3x3"].solve(
            recording, poses, turns, Triad(), gravity=9.80665, options={}
        )
        error = fit.values - truth
        errors.append(error[3:])
        distances.append(error @ np.linalg.solve(fit.covariance, error) / len(error))
        held, ends = (
            closure_errors(recording, poses, turns, Triad(), fit.triad, gain=gain)
            for gain in (None, np.zeros(len(poses)))
        )
        assert np.mean(held**2) < 0.5 * np.mean(ends**2)
    # 0.2 degrees at either end of a turn would cost several times as much.
    assert np.sqrt(np.mean(np.square(errors))) < 3e-4
    assert 0.4 < np.mean(distances) < 2.5
