"""A sensor that is put down with knocks beside markers, which see nothing of them."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.reference.filters import low_passed
from calib.mismatch.reference.struck import struck
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import quat_from_rotvec, quat_multiply, rotate
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665
ONSET, FADING = 0.005, 0.06
"""s in which a table begins to ring, and in which it fades."""
MARKERS = (2e-4, 1e-3)
"""Noise of a captured position, m, and of each angle, rad."""
SEEN = 120.0
"""Samples of a captured motion each second."""
SETTLING = Term("accel_settling", {"kx": 0.05, "ky": -0.04, "kz": 0.06, "tau": 1.5})


def put_down(motion: Motion) -> np.ndarray:
    """Return when its rests begin, but for the first, s."""
    time = np.arange(0.0, motion.duration, 1e-3)
    rests = np.linalg.norm(motion.state(time).rate, axis=1) < 1e-6
    return time[np.flatnonzero(rests[1:] & ~rests[:-1]) + 1]


def rings(at: np.ndarray, time: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement (n, 3) of a table that rings, m, and its acceleration, m/s²."""
    rng = np.random.default_rng(seed)
    place, force = np.zeros((len(time), 3)), np.zeros((len(time), 3))
    for begins in at:
        turning = 2.0 * np.pi * rng.uniform(15.0, 35.0)
        size = rng.uniform(1.0, 6.0) / turning**2 * np.array([0.3, 0.3, 1.0])
        since = np.maximum(time - begins, 0.0)[:, None]
        pole = 1j * turning - 1.0 / FADING - np.arange(3) / ONSET
        parts = np.array([1.0, -2.0, 1.0]) * np.exp(pole * since)
        place += size * parts.sum(axis=1, keepdims=True).imag
        force += size * (parts * pole**2).sum(axis=1, keepdims=True).imag * (since > 0)
    return place, force


def knocked(
    seed: int, *terms: Term, poses: int = 12, rate: float = 100.0
) -> tuple[Recording, ReferenceMotion]:
    """Return what a sensor without an anti-alias filter records, and what markers see of it."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=poses, first_pose=2.0, pose_duration=(3.0, 6.0))
    at = put_down(motion)
    real = simulate(motion, SensorModel(terms=terms), CONSUMER, rng=rng, rate=rate)
    quat = motion.kinematics(real.time)[0].quat
    force = rings(at, real.time, seed)[1]
    real = replace(real, accel=real.accel + rotate(quat * [1.0, -1.0, -1.0, -1.0], force))
    time = np.arange(0.0, motion.duration, 1.0 / SEEN)
    turning, path = motion.kinematics(time)
    assert path is not None
    place = path.position + rings(at, time, seed)[0] + MARKERS[0] * rng.normal(size=(len(time), 3))
    wrong = quat_from_rotvec(MARKERS[1] * rng.normal(size=(len(time), 3)))
    return real, ReferenceMotion(time, quat_multiply(turning.quat, wrong), place)


def test_a_table_that_rings_comes_back():
    """What is added to the forces is the second derivative of what is added to the places."""
    time = np.arange(0.0, 0.6, 2e-5)
    place, force = rings(np.array([0.2]), time, 1)
    bend = np.diff(place, n=2, axis=0) / 4e-10
    assert np.abs(bend - force[1:-1]).max() < 0.01 * np.abs(force).max()
    assert 1.0 < np.abs(force).max() < GRAVITY
    assert np.abs(place[-1]).max() < 0.01 * np.abs(place).max()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_sensor_that_is_put_down_with_knocks_has_no_errors_of_its_own(seed):
    """It settled after turns, at p < 1e-10, or was off in windows."""
    real, seen = knocked(seed)
    found = diagnose_reference(real, seen, gravity=GRAVITY)
    assert {f.effect for f in found.findings} <= {"time_offset", "accel_lever_arm"}
    assert not found.unexplained


def test_what_settles_for_seconds_is_found_beside_knocks():
    real, seen = knocked(4, SETTLING, poses=20)
    found = diagnose_reference(real, seen, gravity=GRAVITY)
    (item,) = (f for f in found.findings if f.effect == SETTLING.effect)
    for name, true in SETTLING.parameters.items():
        q = item.parameters[name]
        assert abs(q.value - true) < 4.0 * q.sigma
    assert not found.unexplained


def test_samples_are_struck_by_what_no_filter_kept_from_folding():
    rng = np.random.default_rng(5)
    time = np.arange(6000) / 100.0
    accel = 0.02 * rng.normal(size=(6000, 3))
    accel[:, 2] += 5.0 * np.sin(2 * np.pi * time)
    still = Recording(time, accel, 1e-3 * rng.normal(size=(6000, 3)), "device")
    assert not struck(still, time[::3], (5.0, 5.0)).any()
    at = np.arange(50, 5950, 100)
    accel = accel.copy()
    accel[at, 2] += 20.0 * rng.normal(size=len(at))
    hit = replace(still, accel=accel)
    left = low_passed(hit, 5.0).accel[::3, 2] - low_passed(still, 5.0).accel[::3, 2]
    variance = struck(hit, time[::3], (5.0, 5.0))
    assert variance[:, 0].mean() == pytest.approx(np.square(left).mean(), rel=0.1)
    assert not variance[:, 1].any()
