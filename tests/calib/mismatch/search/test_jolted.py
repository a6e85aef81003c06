"""Turns of which samples miss more than of most."""

from functools import cache

import numpy as np
import pytest

from calib.effects import get_effect
from calib.mismatch.engine import diagnose_recording
from calib.mismatch.hypotheses.families import effect_columns
from calib.mismatch.noise.noise import (
    covariance,
    expected_levels,
    find_levels,
    make_whitener,
)
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.jolted import FACTORS, jolted
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from ..bench import GRAVITY, problem


@cache
def brisk(seed: int = 5, rate: float = 25.0) -> Recording:
    """Turns of a quiet sensor in half a second, of a dozen samples each."""
    rng = np.random.default_rng(seed)
    hands = bench_protocol(
        rng, poses=30, first_pose=2.0, pose_duration=(2.0, 3.0), turn_duration=(0.5, 0.8)
    )
    return simulate(hands, SensorModel(), CONSUMER.scaled(0.2), rng=rng, rate=rate)


@cache
def rows_of(recording: Recording) -> Rows:
    grid = make_grid(recording, find_poses(recording))
    return SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False).rows()


def drawn(rows: Rows, factors: np.ndarray, seed: int) -> Rows:
    """Return rows that err by what is expected of them, with factors on what samples miss."""
    rng = np.random.default_rng(seed)
    cov = covariance(rows.jolted(factors), expected_levels(rows))
    values, vectors = np.linalg.eigh(cov)
    residual = np.sqrt(rows.white_diagonal) * rng.normal(size=len(rows.white_diagonal))
    dense = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(cov)))
    return rows.with_residual(np.concatenate((dense, residual)))


def test_where_samples_resolve_turns_nothing_is_asked():
    _, self_mode = problem()
    noisy = simulate(
        bench_protocol(np.random.default_rng(1), poses=12),
        SensorModel(),
        CONSUMER,
        rng=np.random.default_rng(2),
        rate=200.0,
    )
    assert jolted(rows_of(noisy), skip=()) is None
    # Nor where there are no turns.
    rows = self_mode.rows()
    assert jolted(rows.without(rows.kind >= Kind.ATTITUDE), skip=()) is None


def test_a_factor_is_on_what_samples_miss_of_its_own_segment():
    rows = rows_of(brisk())
    turn = int(rows.segment[rows.turns.index[3, 0]])
    factors = np.ones(len(rows.interval))
    factors[turn] = 9.0
    levels = expected_levels(rows)
    before, after = covariance(rows, levels), covariance(rows.jolted(factors), levels)
    missed = before - covariance(rows.jolted(np.zeros(len(factors))), levels)
    own = rows.segment[: rows.n_dense] == turn
    np.testing.assert_allclose(after[own][:, own], (before + 8.0 * missed)[own][:, own], rtol=1e-9)
    np.testing.assert_allclose(after[~own], before[~own], rtol=1e-9, atol=1e-30)
    assert np.trace(missed[own][:, own]) > 0
    # Rows that are left out before or after are so either way.
    drop = rows.segment == int(rows.segment[rows.turns.index[1, 0]])
    one, other = rows.without(drop).jolted(factors), rows.jolted(factors).without(drop)
    np.testing.assert_allclose(covariance(one, levels), covariance(other, levels), rtol=1e-12)
    assert one.unresolved
    assert not rows.unresolved


def farthest(rows: Rows) -> float:
    """Return the square of what the worst turn errs by, in units of its covariance."""
    mean = np.hstack((rows.baseline, rows.nuisance))
    levels = find_levels(rows, mean, expected_levels(rows)).values
    whitener = make_whitener(rows, levels, rows.white_diagonal, mean)
    square = np.square(whitener.project(rows.residual))[: rows.n_dense]
    turns = rows.kind[: rows.n_dense] >= Kind.ATTITUDE
    return float(np.bincount(rows.segment[: rows.n_dense][turns], square[turns]).max())


@pytest.mark.parametrize("seed", [1, 4])
@pytest.mark.long
def test_turns_that_err_by_more_than_others_stand_out_no_more(seed: int):
    rows = rows_of(brisk())
    segments = rows.segment[rows.turns.index[:, 0]]
    factors = np.ones(len(rows.interval))
    factors[segments[[4, 17]]] = 100.0
    made = drawn(rows, factors, seed)
    found = jolted(made, skip=())
    assert found is not None
    assert set(found) <= set(FACTORS)
    # Either they have a factor, or all turns have higher levels.
    assert farthest(made.jolted(found)) < 25.0
    assert farthest(made) > farthest(made.jolted(found))
    assert np.median(found[segments]) == 1.0
    assert (found[np.setdiff1d(np.arange(len(found)), segments)] == 1.0).all()


@pytest.mark.long
def test_turns_alike_have_hardly_a_factor():
    rows = rows_of(brisk())
    segments = rows.segment[rows.turns.index[:, 0]]
    for seed in range(3):
        found = jolted(drawn(rows, np.ones(len(rows.interval)), 10 + seed), skip=())
        assert found is not None
        assert np.median(found[segments]) == 1.0
        assert (found < 3.0).mean() > 0.9
        assert found.max() < 8.0


def test_vibration_that_goes_with_what_samples_miss_is_judged_at_rest():
    rows = rows_of(brisk())
    effect = get_effect("accel_vibration_rectification")
    turns = rows.kind >= Kind.ATTITUDE
    assert any(v[turns].any() for v in effect_columns(effect, rows, {}, reference=False).values())
    blurred = rows.jolted(np.ones(len(rows.interval)))
    for values in effect_columns(effect, blurred, {}, reference=False).values():
        assert not values[turns].any()


@pytest.mark.long
@pytest.mark.parametrize("seed", [12, 17])
def test_turns_of_a_dozen_samples_are_no_disturbance(seed: int):
    found = diagnose_recording(brisk(seed), gravity=GRAVITY)
    assert found.verdict == "consistent"
