"""What drift within a rest has to do with drift from rest to rest."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.mismatch.noise import noise
from calib.mismatch.noise.contrast import contrast_variance, telling
from calib.mismatch.noise.coupling import _drifts, drift_in_contrasts, foretold
from calib.mismatch.noise.noise import estimate_levels, expected_levels, make_whitener
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.ranking import make_stack, rank
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.recording import CHANNELS
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import GRAVITY, drawn, problem


@cache
def slow() -> Rows:
    """Rows of long rests."""
    rng = np.random.default_rng(5)
    motion = bench_protocol(rng, poses=20, first_pose=20.0, pose_duration=(30.0, 60.0))
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=25.0)
    grid = make_grid(real, find_poses(real))
    return SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False).rows()


def drifting(rows: Rows, rng: np.random.Generator, size: float, *, first: int = 0) -> FloatArray:
    """Return white noise, and flicker of all channels as Gauss-Markov processes at the points."""
    dense, time = rows.n_dense, rows.state.time
    white = np.linalg.cholesky(rows.white + 1e-30 * np.eye(dense)) @ rng.normal(size=dense)
    rest = np.sqrt(rows.white_diagonal) * rng.normal(size=len(rows.white_diagonal))
    out = np.concatenate((white, rest))
    level = {c.name: c.expected for c in rows.components}
    for correlation in 2.0 * 4.0 ** np.arange(first, 7):
        kept = np.exp(-np.diff(time) / correlation)
        drift = rng.normal(size=(len(time), 6))
        drift[1:] *= np.sqrt(1 - kept**2)[:, None]
        for k in range(1, len(drift)):
            drift[k] += kept[k - 1] * drift[k - 1]
        drift *= np.sqrt(size * np.log(4.0) / np.pi)
        for c, name in enumerate(CHANNELS):
            out += rows.functional[c] @ (drift[:, c] * np.sqrt(level[f"{name} flicker"]))
    return out


@pytest.mark.long
def test_nothing_is_left_in_contrasts_of_what_means_have_said() -> None:
    rows, rng = slow(), np.random.default_rng(1)
    y = np.stack([drifting(rows, rng, 9.0) for _ in range(40)], axis=1)
    levels = np.array(
        [9.0 * c.expected if c.name.endswith("flicker") else 1e-30 for c in rows.components]
    )
    ahead, raw, left = [], [], []
    for known in foretold(rows, levels)[3:]:
        means, changes = y[known.mean], y[rows.n_dense + known.contrast]
        # The second contrast of each rest: its last half against the third before.
        ahead.append(means[2:] - means[:-2])
        raw.append(changes[1::2][1:-1])
        left.append((changes - known.weight @ means)[1::2][1:-1])
    before, after = (np.corrcoef(np.ravel(ahead), np.ravel(v))[0, 1] for v in (raw, left))
    assert abs(before) > 0.1
    assert abs(after) < 0.5 * abs(before)


@pytest.mark.long
def test_drift_within_rests_is_as_large_as_levels_say() -> None:
    rows, rng = slow(), np.random.default_rng(9)
    levels = np.array(
        [9.0 * c.expected if c.name.endswith("flicker") else 1e-30 for c in rows.components]
    )
    y = np.stack([drifting(rows, rng, 9.0, first=-1) for _ in range(40)], axis=1)
    variance = rows.white_diagonal.copy()
    for known in foretold(rows, levels):
        variance[known.contrast] = known.variance
    whitener = make_whitener(rows, levels, variance, rows.baseline[:, :0])
    for triad in (0, 1):
        own = rows.n_dense + np.flatnonzero(rows.channel[rows.n_dense :] // 3 == triad)
        beside = np.square(y[own]).mean(axis=1) / rows.white_diagonal[own - rows.n_dense]
        assert beside.mean() > 1.2
        # The drift that is drawn is a sum of other processes.
        assert np.square(whitener.whiten(y)[own]).mean() == pytest.approx(1.0, abs=0.12)


@pytest.mark.long
def test_what_drifts_slowly_is_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a drift is three times as large as most parts'; what it is in rests is no news."""
    rows, rng = slow(), np.random.default_rng(2)
    draws = [replace(rows, residual=drifting(rows, rng, 9.0)) for _ in range(6)]

    start, stack = expected_levels(rows), make_stack(rows, skip=(), reference=False)

    def claimed(real: Rows) -> bool:
        return bool(rank(real, stack, [], start).claims)

    assert not any(map(claimed, draws))
    monkeypatch.setattr(noise, "foretold", lambda rows, levels: ())
    assert any(map(claimed, draws))


def test_transposed_and_restricted_whiteners_are_those_of_the_whole() -> None:
    rows, rng = slow(), np.random.default_rng(3)
    contrast = contrast_variance(rows)
    whitener = make_whitener(rows, 4 * expected_levels(rows), contrast, rows.baseline)
    assert len(whitener.foretold) == 6
    one, other = rng.normal(size=(2, len(rows.residual), 3))
    there, back = whitener.whiten(one), whitener.unwhiten_transposed(other)
    assert np.allclose(there.T @ other, one.T @ back, rtol=1e-9)
    own = np.flatnonzero((rows.channel == 4) | (rows.channel < 0))
    alone = np.zeros_like(one)
    alone[own] = one[own]
    whole = whitener.whiten(alone)
    assert np.allclose(whole[own], whitener.restricted(own).whiten(one[own]), rtol=1e-9)
    assert not np.delete(whole, own, axis=0).any()


def test_short_rests_of_a_noisy_sensor_are_left_as_they_are() -> None:
    rows = problem()[1].rows()
    drift = _drifts(rows, 0)
    assert drift is not None
    assert foretold(rows, 0.01 * expected_levels(rows)) == ()


def logs_of_flicker(rows: Rows) -> FloatArray:
    """Return the logarithms of the levels of flicker, as multiples of the usual."""
    levels = estimate_levels(rows, fitted(rows, []), expected_levels(rows)).values
    own = [c.name.endswith("flicker") for c in rows.components]
    return np.log(levels / expected_levels(rows))[own]


def test_what_changes_within_rests_says_how_much_a_bias_flickers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Of a gyroscope a lean looks much the same, and would be taken for news of both triads.
    monkeypatch.setattr(noise, "PACKAGE", 0.0)
    rows, rng = problem()[1].rows(), np.random.default_rng(4)
    real = drawn(rows, expected_levels(rows), rng)
    white = rng.normal(size=len(rows.white_diagonal)) * np.sqrt(rows.white_diagonal)
    found = []
    for size in (0.9, 1.2):
        residual = real.residual.copy()
        residual[rows.n_dense :] = size * white
        found.append(logs_of_flicker(replace(real, residual=residual)))
    # Of means alone it is the same.
    assert np.mean((found[1] - found[0])[:3]) > 0.2
    # Without a clock nobody knows what changes within rests have to do with those between them.
    unknown = replace(real, components=tuple(replace(c, spread=4.0) for c in rows.components))
    assert not drift_in_contrasts(unknown).any()
    assert drift_in_contrasts(real).any()


def test_a_knock_in_one_rest_does_not_say_how_a_bias_drifts_in_all() -> None:
    plain = problem()[1].rows()
    rows = drawn(plain, expected_levels(plain), np.random.default_rng(6))
    rest = np.flatnonzero(rows.is_rest)[5]
    knocked = (rows.segment == rest) & (rows.kind == Kind.CONTRAST)
    residual = rows.residual.copy()
    residual[knocked] += 30.0 * np.sqrt(rows.white_diagonal[knocked[rows.n_dense :]])
    other = replace(rows, residual=residual)
    assert np.abs(logs_of_flicker(other) - logs_of_flicker(rows)).max() < 0.7


def test_where_drift_is_most_of_what_changes_within_rests_means_tell_of_it() -> None:
    drifts = np.array([9.0 * c.expected for c in slow().components])
    assert not len(telling(drawn(slow(), drifts, np.random.default_rng(7))))
    plain = problem()[1].rows()
    usual = telling(drawn(plain, expected_levels(plain), np.random.default_rng(7)))
    assert len(usual) > 0.95 * (len(plain.residual) - plain.n_dense)
