"""One short bench recording for the tests of the diagnosis."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from calib.effects.base import State, Term
from calib.mismatch import diagnose_recording
from calib.mismatch.noise.coupling import drift_in_contrasts
from calib.mismatch.noise.noise import covariance
from calib.mismatch.rows.grid import Grid, make_grid
from calib.mismatch.rows.rows import Rows
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel, Triad
from calib.recording import CHANNELS, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses
from calib.types import FloatArray

GRAVITY = 9.80665


def recording(
    *terms: Term,
    seed: int = 3,
    poses: int = 14,
    rate: float = 50.0,
    drift: float = 1.0,
    without_noise: bool = False,
) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=poses, first_pose=2.0, pose_duration=(3.0, 4.0))
    model = SensorModel(
        Triad(
            rng.normal(0, 0.2, 3), rng.normal(0, 0.01, 3), np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        ),
        Triad(rng.normal(0, 0.01, 3), rng.normal(0, 0.01, 3)),
        terms,
        reference_temperature=30.0,
    )
    slow = CONSUMER.scaled(drift)
    noise = type(CONSUMER)(
        accel_noise_density=CONSUMER.accel_noise_density,
        gyro_noise_density=CONSUMER.gyro_noise_density,
        accel_bias_instability=slow.accel_bias_instability,
        gyro_bias_instability=slow.gyro_bias_instability,
        accel_random_walk=slow.accel_random_walk,
        gyro_random_walk=slow.gyro_random_walk,
        temperature=CONSUMER.temperature,
    )
    return simulate(motion, model, NoiseModel() if without_noise else noise, rng=rng, rate=rate)


def with_added(real: Recording, signals: Mapping[str, FloatArray]) -> Recording:
    both = np.hstack((real.accel, real.gyro))
    for channel, values in signals.items():
        both[:, CHANNELS.index(channel)] += values
    return Recording(real.time, both[:, :3], both[:, 3:], "device", temperature=real.temperature)


def left_of(real: Recording) -> list[tuple[str, tuple[str, ...]]]:
    """Return what is unexplained in a recording in which nothing has a name, and its channels."""
    found = diagnose_recording(real, gravity=GRAVITY)
    assert not found.findings
    return [(left.follows, left.channels) for left in found.unexplained]


@cache
def motion(poses: int, seed: int = 8) -> Motion:
    """Return the motion of `recording` with a seed."""
    rng = np.random.default_rng(seed)
    return bench_protocol(rng, poses=poses, first_pose=2.0, pose_duration=(3.0, 4.0))


def motion_of(real: Recording) -> State:
    """Return the true state of a `recording(seed=8)`, in all samples."""
    return motion(len(find_poses(real))).state(real.time)


@cache
def problem(seed: int = 3) -> tuple[Grid, SelfProblem]:
    real = recording(seed=seed, poses=18)
    grid = make_grid(real, find_poses(real))
    return grid, SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)


def drawn(rows: Rows, levels: FloatArray, rng: np.random.Generator) -> Rows:
    """Return rows of nothing but noise of these levels."""
    variance = rows.white_diagonal + levels @ drift_in_contrasts(rows)
    dense = np.linalg.cholesky(covariance(rows, levels)) @ rng.normal(size=rows.n_dense)
    rest = np.sqrt(variance) * rng.normal(size=len(variance))
    return replace(rows, residual=np.append(dense, rest))


def also_turned(recording: Recording, angle: FloatArray) -> Recording:
    """Return a recording of a sensor that is also turned by small angles (n, 3) in its frame."""
    back = Rotation.from_rotvec(angle).inv().as_matrix()
    rate = np.gradient(angle, recording.time, axis=0)
    accel = np.einsum("nij,nj->ni", back, recording.accel)
    gyro = np.einsum("nij,nj->ni", back, recording.gyro) + rate
    return replace(recording, accel=accel, gyro=gyro)
