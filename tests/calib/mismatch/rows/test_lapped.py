"""Means of rests that a machine shakes know no more of it than what it does to the sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.noise.sensornoise import sample_noise
from calib.mismatch.rows.grid import Grid, make_grid
from calib.mismatch.rows.lapped import lapped, point_noise
from calib.mismatch.samples.spectrum import LOUDER_THERE
from calib.mismatch.twin.selfmode import SelfProblem
from calib.poses import Poses
from calib.recording import Recording
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import GRAVITY, also_turned, recording
from .test_sway import laid, swaying

BAND = (15.0, 40.0)
"""Hz."""


@cache
def still() -> tuple[Recording, Poses]:
    """Return a recording that nothing shakes, and its rests."""
    real = recording(seed=3, poses=24, rate=100.0)
    return real, find_poses(real)


@dataclass(frozen=True)
class Band:
    """A shake of unit variance in a `BAND`, which is what many tones make of it."""

    frequency: FloatArray
    phase: FloatArray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Band:
        shape = (400, 3)
        return cls(rng.uniform(*BAND, shape), rng.uniform(0.0, 2 * np.pi, shape))

    def at(self, time: FloatArray) -> FloatArray:
        """Return it at times (n,), (n, 3)."""
        out = [
            np.sin(2 * np.pi * np.multiply.outer(time, f) + p).sum(axis=1)
            for f, p in zip(self.frequency.T, self.phase.T, strict=True)
        ]
        return np.stack(out, axis=1) * np.sqrt(2.0 / len(self.frequency))


def shaken(
    *,
    size: float = 2.0,
    rectified: float = 0.0,
    late: FloatArray | float = 0.0,
    seed: int = 1,
) -> Recording:
    """Return a recording of which every other rest is shaken from its beginning to its end.

    By up to ``size`` m/s², as it is `late` s after the times that are stated of the samples; means
    move by ``rectified`` times the variance.
    """
    rng = np.random.default_rng(seed)
    real, poses = still()
    accel, time = real.accel.copy(), real.time + late
    for a, b in zip(poses.start[::2], poses.stop[::2], strict=True):
        own = size * rng.uniform(0.5, 1.0)
        accel[a:b] += own * Band.drawn(rng).at(time[a:b]) + rectified * own**2
    return replace(real, accel=accel)


def grids(real: Recording) -> tuple[Grid, Grid]:
    """Return the grid with plain means, and with windows that fade."""
    plain = make_grid(real, still()[1])
    return plain, lapped(plain, real)


def of_rests(grid: Grid, values: FloatArray) -> FloatArray:
    """Return the means of points' values over rests, (k, 3)."""
    return np.stack(
        [
            np.average(values[grid.pose == k], axis=0, weights=grid.count[grid.pose == k])
            for k in range(grid.n_poses)
        ]
    )


def errors(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Return what means of shaken rests are off by, and are said to be, (k, 3).

    Bias drifts by a few hundredths of what the noise makes of them.
    """
    true = recording(seed=3, poses=24, rate=100.0, without_noise=True)
    quiet = make_grid(true, still()[1])
    off = of_rests(grid, grid.accel) - of_rests(quiet, quiet.accel)
    noise = of_rests(grid, (sample_noise(grid) * grid.count[:, None])[:, :3])
    number = np.bincount(grid.pose[grid.pose >= 0], grid.count[grid.pose >= 0])
    return off[::2], np.sqrt(noise / number[:, None])[::2]


def test_where_nothing_shakes_the_grid_stays() -> None:
    plain, made = grids(still()[0])
    assert made is plain


def test_white_noise_is_no_quieter_for_it() -> None:
    real, poses = still()
    accel = real.accel.copy()
    for a, b in zip(poses.start[::2], poses.stop[::2], strict=True):
        accel[a:b] += np.random.default_rng(a).normal(size=(b - a, 3))
    plain, made = grids(replace(real, accel=accel))
    assert made is plain


def test_points_stay_in_their_rests() -> None:
    plain, made = grids(shaken())
    assert made.lapped is not None
    assert made.lapped.plain is plain
    np.testing.assert_array_equal(np.flatnonzero(made.lapped.poses), np.arange(0, 24, 2))
    other = (made.pose < 0) | (made.pose % 2 == 1)
    for name in ("accel", "gyro", "count", "length"):
        np.testing.assert_array_equal(getattr(made, name)[other], getattr(plain, name)[other])
    # A window of a quarter of a second is flat but for its ends: half of either is lost.
    lost = [(plain.count - made.count)[plain.pose == k].sum() for k in range(0, 24, 2)]
    assert set(lost) == {26}


def test_what_shakes_a_rest_does_not_leak_into_its_mean() -> None:
    plain, made = grids(shaken(size=8.0))
    off, said = errors(made)
    leaked, _ = errors(plain)
    assert np.sqrt(np.mean(np.square(off))) < 0.2 * np.sqrt(np.mean(np.square(leaked)))
    assert 0.7 < np.sqrt(np.mean(np.square(off / said))) < 1.4
    # Points in turns are single samples, which it shakes.
    turn = made.pose < 0
    np.testing.assert_array_equal(sample_noise(made)[turn], sample_noise(plain)[turn])


def test_white_noise_counts_in_full() -> None:
    """Neighbours that overlap differ by less than others: by how much less is known."""
    rng = np.random.default_rng(8)
    found = []
    for _ in range(8):
        real = shaken(size=4.0)
        real = replace(real, accel=real.accel + rng.normal(0.0, 0.1, (len(real), 3)))
        _, made = grids(real)
        assert made.lapped is not None
        found.append(point_noise(made)[0][made.lapped.poses, :3])
    assert np.concatenate(found).mean() == pytest.approx(0.01, rel=0.1)


def test_samples_are_taken_at_their_times_if_these_are_true() -> None:
    """The same late samples with times that say so, and with times that do not."""
    real, _ = still()
    late = np.random.default_rng(2).uniform(-1e-3, 1e-3, len(real))
    unsaid = shaken(late=late)
    said = replace(unsaid, time=real.time + late)
    # Times that are said to be late, and are not, are not believed.
    wrong = replace(shaken(), time=real.time + late)
    size = [np.sqrt(np.mean(np.square(errors(grids(r)[1])[0]))) for r in (said, unsaid, wrong)]
    assert size[0] < 0.5 * size[1]
    assert size[2] < 0.5 * size[1]


def test_a_hand_keeps_plain_means() -> None:
    """How a hand has turned a sensor is told from one end of a rest to the other."""
    real = laid(1)
    real = also_turned(real, swaying(1, len(real.time), size=3e-3, back=1.5))
    poses = find_poses(real)
    rng, accel = np.random.default_rng(3), real.accel.copy()
    for a, b in zip(poses.start[::2], poses.stop[::2], strict=True):
        accel[a:b] += Band.drawn(rng).at(real.time[a:b])
    shaking = replace(real, accel=accel)
    grid = lapped(make_grid(shaking, poses), shaking)
    assert grid.lapped is not None
    problem = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=True)
    assert problem.grid.held is not None
    assert problem.grid.lapped is None


@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_band_rectifies_is_named(seed: int) -> None:
    """A shift of a tenth of what leaks into plain means over parts of a rest."""
    found = diagnose_recording(shaken(rectified=2e-3, seed=seed), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["accel_vibration_rectification"]
    assert LOUDER_THERE not in [u.follows for u in found.unexplained]
    for value in found.findings[0].parameters.values():
        assert abs(value.value - 2e-3) < 4.0 * value.sigma
        assert value.sigma < 8e-4


def test_a_shake_that_rectifies_nothing_has_no_name() -> None:
    for seed in range(3):
        assert not diagnose_recording(shaken(seed=seed), gravity=GRAVITY).findings
