"""Heading carried by turns, and the Earth's rotation that is judged by it."""

from dataclasses import replace

import numpy as np

from calib.effects.base import Term
from calib.effects.earth_rate import RATE, components
from calib.mismatch import diagnose_recording
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.twin.heading import orient
from calib.mismatch.twin.selfmode import SelfProblem
from calib.mismatch.twin.twin import true_state
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import GRAVITY, problem


def _away_from(motion: Motion, real: Recording) -> FloatArray:
    """Return what takes the true orientation to that of the twin, (n, 3, 3)."""
    grid = make_grid(real, find_poses(real))
    twin = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False).twin
    mat, truth = true_state(grid, twin).mat_ns, motion.state(grid.time).mat_ns
    assert mat is not None
    assert truth is not None
    return np.asarray(np.einsum("nij,nkj->nik", mat, truth))


def test_orientation_is_that_of_the_motion_but_for_one_heading() -> None:
    rng = np.random.default_rng(8)
    motion = bench_protocol(rng, poses=12, first_pose=2.0, pose_duration=(3.0, 4.0))
    away = _away_from(motion, simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0))
    # It is the same turn about the vertical everywhere.
    assert np.abs(away[:, 2, 2] - 1).max() < 1e-3
    assert np.abs(away - away[0]).max() < 0.03


def test_headings_of_a_slow_log_are_carried_as_turns_are_closed() -> None:
    """The trapezoid of 50 Hz alone is off by two milliradians in brisk turns."""
    rng = np.random.default_rng(8)
    motion = bench_protocol(
        rng, poses=18, first_pose=2.0, pose_duration=(3.0, 4.0), turn_duration=(0.6, 1.0)
    )
    away = _away_from(motion, simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=50.0))
    assert np.abs(away - away[0]).max() < 3e-4


def test_heading_is_lost_where_two_rests_are_not_joined() -> None:
    grid, known = problem()
    state = true_state(grid, known.twin)
    assert state.mat_ns is not None
    turn = int(np.flatnonzero(~grid.is_rest)[3])
    keep = np.delete(np.arange(len(grid.first)), turn)
    cut = replace(
        grid,
        first=grid.first[keep],
        last=grid.last[keep],
        interval=grid.interval[keep],
        before=grid.before[keep],
        after=grid.after[keep],
    )
    assert orient(cut, known.twin.up, state.rate) is None


def test_the_rotation_of_the_earth_is_no_g_sensitivity() -> None:
    # Seen against up alone, its part up is exactly that; headings tell.
    rng = np.random.default_rng(8)
    motion = bench_protocol(rng, poses=24, first_pose=8.0, pose_duration=(8.0, 9.0))
    sensor = SensorModel(terms=(Term("earth_rate", components(np.radians(50.0))),))
    real = simulate(motion, sensor, CONSUMER.scaled(0.5), rng=rng, rate=50.0)
    (found,) = diagnose_recording(real, gravity=GRAVITY).findings
    assert found.effect == "earth_rate"
    up = found.parameters["up"]
    assert up.sigma is not None
    assert abs(up.value - RATE * np.sin(np.radians(50.0))) < 4 * up.sigma
