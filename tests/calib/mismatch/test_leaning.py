"""Who wears a sensor and stands still sways: that is no error of the sensor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from calib.mismatch import diagnose_recording
from calib.mismatch.noise.leaning import lean_share
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

GRAVITY = 9.80665
RATE = 100.0


def standing(seed: int, lean: float) -> Recording:
    """Return four rests with steps between them, in which a body leans by `lean` in a second."""
    rng = np.random.default_rng(seed)
    parts: list[FloatArray] = [np.zeros((1, 2))]
    for k in range(4):
        number = int(rng.uniform(4, 12) * RATE)
        turning = rng.normal(0, lean / np.sqrt(10.0), 2) / RATE
        steps = rng.normal(0, lean / np.sqrt(RATE), (number, 2)) + turning
        parts.append(parts[-1][-1] + np.cumsum(steps, axis=0))
        if k < 3:
            share = np.arange(1, 301) / 300
            swing = np.sin(np.pi * share) ** 2 * np.sin(6 * np.pi * share)
            moved = np.outer(3 * share**2 - 2 * share**3, rng.normal(0, 0.02, 2))
            parts.append(parts[-1][-1] + np.outer(swing, [0.4, 0.3]) + moved)
    angle = gaussian_filter1d(np.concatenate(parts), 0.1 * RATE, axis=0)
    roll, pitch = angle.T
    up = np.stack(
        (-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)), axis=1
    )
    turn = np.gradient(angle, 1 / RATE, axis=0)
    rate = np.stack((turn[:, 0], turn[:, 1] * np.cos(roll), -turn[:, 1] * np.sin(roll)), axis=1)
    return Recording(
        time=np.arange(len(angle)) / RATE,
        accel=GRAVITY * up + rng.normal(0, 0.02, up.shape),
        gyro=rate + 0.01 + rng.normal(0, 0.0015, rate.shape),
        clock="device",
    )


@pytest.mark.parametrize(("degrees", "seed"), [(0.02, 6), (0.02, 10), (0.05, 11), (0.1, 10)])
def test_a_body_that_sways_is_no_warm_up(degrees: float, seed: int) -> None:
    found = diagnose_recording(standing(seed, np.deg2rad(degrees)), gravity=GRAVITY)
    assert found.findings == ()


@pytest.mark.parametrize(("axis", "said"), [(1, True), (2, False)])
def test_in_one_pose_a_drift_across_gravity_may_be_a_lean(axis: int, said: bool) -> None:
    rng, time = np.random.default_rng(4), np.arange(12_000) / RATE
    accel = np.array([0.0, 0.0, GRAVITY]) + rng.normal(0, 0.02, (len(time), 3))
    accel[:, axis] += 0.05 * np.exp(-time / 30)
    recording = Recording(
        time=time, accel=accel, gyro=rng.normal(0, 0.0015, accel.shape), clock="device"
    )
    found = diagnose_recording(recording, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["accel_warm_up"]
    assert any("may lean" in need for need in found.missing) == said


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 3])
def test_a_table_does_not_lean_through_a_night(seed: int) -> None:
    """Rests of minutes: what is expected of a lean grows with their square, and what drifts does
    other things to a rest's start, middle and end than it would. It was a fluctuation."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=30, pose_duration=(60.0, 400.0))
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=12.5)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert not found.findings
    assert not [u for u in found.unexplained if u.follows.startswith("fluctuation")]
    # A few samples a turn may leave something of one.
    assert min((u.p_value for u in found.unexplained), default=1.0) > 1e-6


def test_a_body_that_sways_leans_all_the_same() -> None:
    shares = []
    for degrees in (0.02, 0.1):
        real = standing(10, np.deg2rad(degrees))
        grid = make_grid(real, find_poses(real))
        problem = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=True)
        shares.append(lean_share(problem.rows()))
    assert shares == [1.0, 1.0]
