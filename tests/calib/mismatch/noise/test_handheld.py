"""Means of forces in a hand err by what its velocity changes by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from calib.mismatch.noise.handheld import held_by_hand, noise_of_held
from calib.mismatch.noise.sensornoise import sample_noise
from calib.mismatch.rows.grid import Grid, make_grid
from calib.statics import find_poses
from calib.types import FloatArray

from ..rows.test_sway import RATE, laid


def moved(seed: int, *, velocity: float) -> tuple[Grid, FloatArray]:
    """Return a recording that a hand moves at some velocity (m/s), and its poses' sizes."""
    recording = laid(seed, lasts=(3.0, 9.0))
    rng = np.random.default_rng(seed)
    band = signal.butter(2, [0.1, 1.0], "band", fs=RATE, output="sos")
    path = signal.sosfiltfilt(band, rng.normal(size=recording.accel.shape), axis=0)
    speed = velocity * path / path.std(axis=0)
    accel = recording.accel + np.gradient(speed, 1 / RATE, axis=0)
    grid = make_grid(replace(recording, accel=accel), find_poses(recording))
    return grid, np.ones(grid.n_poses)


@pytest.mark.parametrize("seed", range(3))
def test_means_err_by_as_much_as_is_said(seed: int) -> None:
    velocity = 5e-3
    grid, size = moved(seed, velocity=velocity)
    still = moved(seed, velocity=1e-9)[0]
    every = np.ones(grid.n_poses, bool)
    held = held_by_hand(grid, every, size)
    assert np.sqrt(held.velocity) == pytest.approx(velocity * size, rel=0.5)
    noise = noise_of_held(replace(grid, held=held), sample_noise(grid))
    rest = grid.pose >= 0
    share = grid.count[rest] / np.bincount(grid.pose[rest], grid.count[rest])[grid.pose[rest]]
    said = np.bincount(grid.pose[rest], np.square(share) * noise[rest, 0])
    off = (grid.accel - still.accel)[rest]
    means = np.stack([np.bincount(grid.pose[rest], share * a) for a in off.T], axis=1)
    assert 0.4 < (np.square(means) / said[:, None]).mean() < 1.5
    # As white noise it would be more.
    usual = sample_noise(grid)
    assert np.bincount(grid.pose[rest], np.square(share) * usual[rest, 0]).mean() > 2 * said.mean()


def test_what_nobody_holds_has_the_noise_that_it_shows() -> None:
    grid, size = moved(1, velocity=5e-3)
    some = np.arange(grid.n_poses) < 12
    usual = sample_noise(grid)
    found = noise_of_held(replace(grid, held=held_by_hand(grid, some, size)), usual)
    beside = ~(some[grid.before] & some[grid.after])[grid.segment]
    assert (found[beside] >= usual[beside]).all()
    assert (found[~beside, 3:] <= 2.0 * usual[~beside, 3:]).all()
