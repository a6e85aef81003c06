"""Turns of a sensor in a hand: from its mean attitude in one rest to that in the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import expected_levels, find_levels, make_whitener
from calib.mismatch.rows.grid import Held, make_grid
from calib.mismatch.rows.held import Ends
from calib.mismatch.twin.selfmode import SelfProblem
from calib.recording import Recording
from calib.statics import find_poses

from ..bench import also_turned
from .test_sway import GRAVITY, laid, swaying


def held(seed: int, *, size: float = 3e-3, back: float = 1.5) -> Recording:
    recording = laid(seed)
    return also_turned(recording, swaying(seed, len(recording.time), size=size, back=back))


def problem(recording: Recording) -> SelfProblem:
    grid = make_grid(recording, find_poses(recording))
    return SelfProblem(grid, None, gravity=GRAVITY, full_gyro=True)


def test_the_angle_from_the_mean_attitude_is_what_rates_add_up_to() -> None:
    """``integral of s w dt`` is ``angle(T) - mean angle``, whatever cells a rest is cut into."""
    recording = laid(1, poses=8, lasts=(5.0, 30.0))
    angle = swaying(1, len(recording.time), size=3e-3, back=1.5)
    rate = np.gradient(angle, recording.time, axis=0)
    grid = make_grid(replace(recording, gyro=rate), find_poses(recording))
    assert np.bincount(grid.before[grid.is_rest]).max() > 1
    every = np.ones(grid.n_poses, bool)
    none = np.zeros(grid.n_poses)
    ends = Ends.of(replace(grid, held=Held(every, none, none)))
    rest = np.flatnonzero(grid.is_rest)
    mean = np.stack(
        [
            np.average(grid.gyro[a:b], axis=0, weights=grid.count[a:b])
            for a, b in zip(grid.first[rest], grid.last[rest], strict=True)
        ]
    )
    wanted, seen = [], []
    for k in range(grid.n_poses):
        cells = np.flatnonzero(grid.before[rest] == k)
        a, b = np.searchsorted(recording.time, grid.interval[rest[cells]][[0, -1], [0, 1]])
        wanted.append(angle[[b, a]] - angle[a : b + 1].mean(axis=0))
        seen.append(ends.turned[k] + ends.weights[:, cells] @ mean[cells])
    size, off = np.std(wanted), np.std(np.array(seen) - wanted)
    assert size > 1e-3
    assert off < 0.05 * size


def test_nothing_is_told_of_rests_that_nobody_holds() -> None:
    recording = laid(2)
    grid = make_grid(recording, find_poses(recording))
    some = np.arange(grid.n_poses) % 2 == 0
    none = np.zeros(grid.n_poses)
    ends = Ends.of(replace(grid, held=Held(some, none, none)))
    place = grid.before[grid.is_rest]
    assert not ends.turned[~some].any()
    assert not ends.weights[:, ~some[place]].any()
    assert ends.turned[some].any(axis=1).all()
    assert problem(recording).grid.held is None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_turns_of_a_held_sensor_err_by_no_more_than_is_said(seed: int) -> None:
    """Whitened, and without what is fitted, their squares are one on average, or a little less.

    The hand is out of them: they are known to a few tenths of its three milliradians.
    """
    found = problem(held(seed))
    assert found.grid.held is not None
    assert found.grid.held.poses.mean() > 0.8
    rows = found.rows()
    fitted = np.hstack((rows.baseline, rows.nuisance))
    levels = find_levels(rows, fitted, expected_levels(rows)).values
    whitener = make_whitener(rows, levels, contrast_variance(rows), fitted)
    left = whitener.project(rows.residual)[: rows.n_dense]
    freedom = rows.n_dense - whitener.basis.shape[1]
    assert 0.3 < np.square(left).sum() / freedom < 1.2
    ends = np.eye(len(rows.residual))[:, rows.ends[:, :2].ravel()]
    known = 1.0 / np.linalg.norm(whitener.whiten(ends), axis=0)
    assert np.median(known) < 6e-4


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_a_small_effect_is_found_in_a_hand(seed: int) -> None:
    recording = held(seed)
    size = np.array([0.0, 3e-3, -2e-3])
    bent = replace(recording, gyro=recording.gyro + size * np.abs(recording.gyro))
    found = diagnose_recording(bent, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["gyro_scale_asymmetry"]
    assert found.unexplained == ()
    for name, true in zip("xyz", size, strict=True):
        said = found.findings[0].parameters.get(f"k{name}")
        if said is not None:
            assert abs(said.value - true) < 4 * said.sigma
            assert said.sigma < 1e-3
