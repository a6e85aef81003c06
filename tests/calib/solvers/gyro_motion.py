"""Known motion for the gyroscope's tests: poses at rest, and smooth turns between them."""

from dataclasses import dataclass, field

import numpy as np

from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.rotation import integrate_rate, mat_from_quat
from calib.types import FloatArray

GRAVITY = 9.80665
OVERSAMPLE = 8


@dataclass(frozen=True)
class Motion:
    """A rotation vector in the frame of the sensor for each turn, and how long all of it takes."""

    turns: FloatArray
    rest: float = 3.0
    turn: float = 2.0
    rate: float = 100.0
    ramp: float = 0.5  # part of a turn that is spent on speeding up, and on slowing down
    mat_ns: FloatArray = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class Truth:
    recording: Recording
    poses: Poses
    rate: FloatArray
    mat_ns: FloatArray


def protocol() -> FloatArray:
    """Return 24 rotation vectors: each axis turned both ways while it is horizontal, and mixed."""
    q = np.pi / 2
    x, y, z = np.eye(3) * q
    single = [x, x, -x, -x, y, y, -y, -y, x, z, z, -z, -z, -x, 2 * y, -2 * y]
    mixed = [x + y, y - z, z + x, -x - y, x + y + z, -y + z, x - z, y + z]
    return np.array(single + mixed)


def simulate(
    motion: Motion,
    gyro: Triad,
    *,
    rng: np.random.Generator,
    accel: Triad | None = None,
    gyro_noise: float = 0.002,
    accel_noise: float = 0.02,
) -> Truth:
    """Return a recording of a motion, with its poses known and every truth beside it."""
    accel = Triad() if accel is None else accel
    dt = 1 / (motion.rate * OVERSAMPLE)
    rest, turn = round(motion.rest / dt), round(motion.turn / dt)
    edge = np.minimum(np.arange(turn), turn - np.arange(turn)) / (turn * motion.ramp)
    edge = np.clip(edge, 0, 1)
    speed = edge**2 * (3 - 2 * edge)
    speed /= speed.sum() * dt
    parts, edges, n = [np.zeros((rest, 3))], [(0, rest)], rest
    for rotvec in motion.turns:
        parts += [speed[:, None] * rotvec, np.zeros((rest, 3))]
        edges.append((n + turn, n + turn + rest))
        n += turn + rest
    fine = np.concatenate(parts)
    mats = motion.mat_ns @ mat_from_quat(integrate_rate(np.arange(n) * dt, fine))
    keep = slice(None, None, OVERSAMPLE)
    rate, mats = fine[keep], mats[keep]
    force = GRAVITY * mats[:, 2, :]
    time = np.arange(len(rate)) / motion.rate
    recording = Recording(
        time,
        accel.distort(force) + rng.normal(0, accel_noise, force.shape),
        gyro.distort(rate) + rng.normal(0, gyro_noise, rate.shape),
        clock="device",
    )
    start, stop = -(-np.array(edges) // OVERSAMPLE).T
    stop = np.minimum(stop, len(time))
    return Truth(
        recording, known_poses(recording, start, stop, accel_noise, gyro_noise), rate, mats
    )


def noisy(
    clean: Truth, *, rng: np.random.Generator, gyro_noise: float, accel_noise: float
) -> Truth:
    """Return a recording made without noise with noise added: many runs from one simulation."""
    r = clean.recording
    recording = Recording(
        r.time,
        r.accel + rng.normal(0, accel_noise, r.accel.shape),
        r.gyro + rng.normal(0, gyro_noise, r.gyro.shape),
        clock="device",
    )
    poses = known_poses(recording, clean.poses.start, clean.poses.stop, accel_noise, gyro_noise)
    return Truth(recording, poses, clean.rate, clean.mat_ns)


def known_poses(recording, start, stop, accel_noise, gyro_noise) -> Poses:
    spans = [slice(a, b) for a, b in zip(start, stop, strict=True)]
    count = (stop - start)[:, None, None]
    return Poses(
        np.asarray(start),
        np.asarray(stop),
        np.stack([recording.time[start], recording.time[stop - 1]], axis=1),
        np.stack([recording.accel[s].mean(axis=0) for s in spans]),
        np.stack([recording.gyro[s].mean(axis=0) for s in spans]),
        np.eye(3) * accel_noise**2 / count,
        np.eye(3) * gyro_noise**2 / count,
    )
