"""Rows are what they claim: their derivatives agree with differences of the rows themselves."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects import get_effect
from calib.effects.base import Term
from calib.mismatch.noise.noise import covariance, estimate_levels, expected_levels
from calib.mismatch.rows import grid
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.rows import Kind
from calib.mismatch.twin.residuals import build_rows
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.poses import Poses
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from ..bench import problem, recording

STEP = 1e-6


def test_functional_is_the_derivative_by_the_signals():
    grid, self_mode = problem()
    rows = self_mode.rows()
    change = np.random.default_rng(0).normal(size=(len(grid.time), 6))
    moved = replace(
        grid, accel=grid.accel + STEP * change[:, :3], gyro=grid.gyro + STEP * change[:, 3:]
    )
    seen = build_rows(moved, self_mode.twin, self_mode.noise).residual - rows.residual
    expected = sum(f @ change[:, c] for c, f in enumerate(rows.functional))
    np.testing.assert_allclose(seen / STEP, expected, atol=2e-3 * np.abs(expected).max())


def test_baseline_columns_are_derivatives_by_the_parameters():
    grid, self_mode = problem()
    rows = self_mode.rows()
    still = np.zeros((grid.n_poses, 2))
    for j, name in enumerate(rows.names):
        twin = self_mode.twin.moved({name: STEP}, still)
        seen = (build_rows(grid, twin, self_mode.noise).residual - rows.residual) / STEP
        scale = np.abs(rows.baseline[:, j]).max()
        np.testing.assert_allclose(seen, -rows.baseline[:, j], atol=1e-2 * scale, err_msg=name)


def test_nuisance_columns_are_derivatives_by_the_attitudes():
    grid, self_mode = problem()
    rows = self_mode.rows()
    for j in range(4):
        angles = np.zeros((grid.n_poses, 2))
        angles.ravel()[j] = STEP
        twin = self_mode.twin.moved({}, angles)
        seen = (build_rows(grid, twin, self_mode.noise).residual - rows.residual) / STEP
        scale = np.abs(rows.nuisance[:, j]).max()
        np.testing.assert_allclose(seen, -rows.nuisance[:, j], atol=1e-4 * scale)


def test_a_delay_in_the_model_is_taken_out_of_turns_and_leaves_rests_alone() -> None:
    grid, self_mode = problem()
    rows, twin = self_mode.rows(), self_mode.twin
    late = Term("time_offset", {"gyro_delay": 0.05})
    moved = replace(twin, model=replace(twin.model, terms=(late,)))
    change = build_rows(grid, moved, self_mode.noise).residual - rows.residual
    rests = rows.kind <= Kind.CONTRAST
    np.testing.assert_array_equal(change[rests], 0.0)
    column = rows.column(get_effect("time_offset").columns(rows.state, {})["gyro_delay"])
    # The first order of 50 ms is most of it.
    left = change[~rests] + 0.05 * column[~rests]
    assert np.linalg.norm(left) < 0.3 * np.linalg.norm(change[~rests])


def test_rows_without_some_segments_keep_their_own():
    _, self_mode = problem()
    rows = self_mode.rows()
    drop = rows.segment == rows.segment[rows.kind == Kind.ATTITUDE][0]
    fewer = rows.without(drop)
    assert len(fewer.residual) == len(rows.residual) - drop.sum()
    assert fewer.white.shape == (fewer.n_dense, fewer.n_dense)
    np.testing.assert_array_equal(fewer.residual, rows.residual[~drop])
    levels = expected_levels(rows)
    kept = ~drop[: rows.n_dense]
    np.testing.assert_allclose(
        covariance(fewer, levels), covariance(rows, levels)[np.ix_(kept, kept)], rtol=1e-12
    )
    np.testing.assert_allclose(rows.expected_variance(), np.diag(covariance(rows, levels)))


def test_a_common_lever_arm_drops_out_of_the_velocity_closure():
    from calib.effects import get_effect

    _, self_mode = problem()
    rows = self_mode.rows()
    columns = get_effect("accel_lever_arm").columns(rows.state, {})
    arm = rows.column(columns["rx"])[rows.kind == Kind.VELOCITY]
    size = rows.column({"accel.x": columns["rx"]["accel.x"]})[rows.kind == Kind.VELOCITY]
    assert np.abs(arm).max() < 0.03 * np.abs(size).max()


def test_long_recordings_are_thinned():
    real = recording(poses=6)
    grid = make_grid(real, find_poses(real))
    assert grid.count.sum() <= len(real)
    assert (grid.count > 5).any()
    assert (np.diff(grid.time) > 0).all()


def long_rest() -> tuple[Recording, Poses]:
    rng = np.random.default_rng(2)
    motion = bench_protocol(rng, poses=12, first_pose=60.0, pose_duration=(3.0, 4.0))
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=50.0)
    return real, find_poses(real)


def test_a_cell_that_is_much_longer_than_others_has_a_mean_and_no_contrast():
    real, poses = long_rest()
    one = make_grid(real, poses, shortest_cell=90.0)
    rows = SelfProblem(one, None, gravity=9.80665, full_gyro=False).rows()
    assert (rows.kind[rows.segment == 0] == Kind.MEAN).all()
    assert (rows.segment == 0).sum() == 6
    assert (rows.kind[rows.segment == 2] == Kind.CONTRAST).sum() == 12


def test_rests_are_cut_into_no_more_cells_than_the_rows_allow(monkeypatch):
    real, poses = long_rest()
    assert make_grid(real, poses).is_rest.sum() > 20
    monkeypatch.setattr(grid, "ROWS", 6 * 15 + 5 * 11)
    assert len(poses) == 12
    assert 12 < make_grid(real, poses).is_rest.sum() <= 15


@pytest.mark.parametrize("rate", [33.0, 50.0])
def test_turns_too_fast_for_their_samples_close_within_what_is_allowed(rate: float) -> None:
    rng = np.random.default_rng(5)
    hands = bench_protocol(
        rng, poses=24, first_pose=2.0, pose_duration=(2.0, 3.0), turn_duration=(0.5, 0.8)
    )
    real = simulate(hands, SensorModel(), CONSUMER.scaled(0.2), rng=rng, rate=rate)
    grid = make_grid(real, find_poses(real))
    rows = SelfProblem(grid, None, gravity=9.80665, full_gyro=False).rows()
    own = rows.kind[: rows.n_dense] == Kind.VELOCITY
    square = np.square(rows.residual[: rows.n_dense])[own]
    mean = np.hstack((rows.baseline, rows.nuisance))
    levels = estimate_levels(rows, mean, expected_levels(rows)).values
    allowed = np.diag(covariance(rows, levels))[own]
    plain = replace(
        rows, components=tuple(c for c in rows.components if "by sampling" not in c.name)
    ).expected_variance()[own]
    assert (square / plain).mean() > 4.0
    assert 0.2 < (square / allowed).mean() < 3.0


def test_what_is_unknown_has_a_level_wherever_the_twin_stands() -> None:
    """Levels go from one linearisation to the next: none may come or go with a turn."""
    rng = np.random.default_rng(6)
    real = simulate(
        bench_protocol(rng, poses=8, turn_duration=(0.5, 0.8)),
        SensorModel(),
        CONSUMER,
        rng=rng,
        rate=50.0,
    )
    grid = make_grid(real, find_poses(real))
    problem = SelfProblem(grid, None, gravity=9.80665, full_gyro=False)
    before = problem.rows().components
    # With less noise, more of what samples do is beyond it.
    problem.noise = 1e-6 * problem.noise
    after = problem.rows().components
    assert [c.name for c in before] == [c.name for c in after]
    own = [c.name for c in before].index("force by sampling")
    assert np.trace(after[own].matrix) > np.trace(before[own].matrix)


def test_settling_shows_in_the_contrasts_of_a_rest():
    grid, self_mode = problem()
    rows = self_mode.rows()
    contrast = np.arange(len(rows.residual)) >= rows.n_dense
    fading = np.exp(-rows.state.since_turn / 0.7)
    seen = rows.columns(2, fading[:, None])[:, 0]
    rest = grid.pose >= 0
    weight = grid.count[rest] * 1.0
    # Of what it varies by within rests, most is in their two contrasts.
    total = np.bincount(grid.segment[rest], weight * fading[rest])
    number = np.bincount(grid.segment[rest], weight)
    mean = (total / np.maximum(number, 1.0))[grid.segment[rest]]
    varies = np.bincount(grid.segment[rest], weight * np.square(fading[rest] - mean))
    own = np.bincount(rows.segment[contrast], np.square(seen[contrast]), len(varies))
    settled = varies > 0.1 * varies.max()
    assert np.median((own * number)[settled] / varies[settled]) > 0.8


def test_rows_stay_linear_in_a_bias_that_the_rests_show():
    grid, self_mode = problem()
    rows = self_mode.rows()
    names = [f"gyro.bias.{a}" for a in "xyz"]
    shift = np.array([0.02, -0.03, 0.01])  # thousands of times what rests tell
    still = np.zeros((grid.n_poses, 2))
    twin = self_mode.twin.moved(dict(zip(names, shift, strict=True)), still)
    seen = build_rows(grid, twin, self_mode.noise).residual - rows.residual
    columns = rows.baseline[:, [rows.names.index(n) for n in names]]
    scale = np.abs(columns @ shift)[rows.kind == Kind.VELOCITY].max()
    np.testing.assert_allclose(seen, -columns @ shift, atol=1e-4 * scale)
