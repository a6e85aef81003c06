"""The white noise of rests, shaken and quiet."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from scipy.signal import lfilter

from calib.effects.vibration import quiet_level
from calib.mismatch import diagnose_recording
from calib.mismatch.noise.sensornoise import (
    DRIFT_TIME,
    DriftKernels,
    flicker_covariance,
    sample_noise,
)
from calib.mismatch.rows.grid import make_grid
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from ..bench import GRAVITY, recording


def shaken(every: int, *, white: bool, rectified: float = 0.0, seed: int = 3) -> Recording:
    """Return a recording in which all rests but each `every`-th are shaken, by tones or by noise.

    The mean of x moves by `rectified` times the variance.
    """
    rng = np.random.default_rng(seed)
    real = recording(seed=seed, poses=24, rate=100.0)
    accel = real.accel.copy()
    poses = find_poses(real)
    for k, (a, b) in enumerate(zip(poses.start, poses.stop, strict=True)):
        if k % every == 0:
            continue
        size = 0.4 * rng.uniform(0.5, 1.0)
        time = real.time[a:b, None]
        if white:
            shake = rng.normal(size=(b - a, 3))
        else:
            shake = np.sqrt(2.0) * np.sin(2 * np.pi * 27.0 * time + rng.uniform(0, 6, 3))
        accel[a:b] += size * shake
        accel[a:b, 0] += rectified * size**2
    return replace(real, accel=accel)


def levels(real: Recording) -> np.ndarray:
    """Return the standard deviation of a sample's noise in each rest, (k, 3)."""
    grid = make_grid(real, find_poses(recording(seed=3, poses=24, rate=100.0)))
    noise = sample_noise(grid) * grid.count[:, None]
    return np.sqrt([noise[grid.pose == k, :3].mean(axis=0) for k in range(grid.n_poses)])


def test_the_quiet_level_is_that_of_rests_that_are_not_shaken() -> None:
    rng = np.random.default_rng(0)
    level = rng.chisquare(10, 24) / 10
    # Of rests that differ by chance alone, it is the median.
    assert quiet_level(level, 2.5) == np.median(level)
    for number in (12, 15):
        some = level.copy()
        some[:number] *= 30.0
        assert quiet_level(some, 2.5) == np.median(level[number:])
    assert quiet_level(np.array([3.0]), 2.0) == 3.0


@pytest.mark.parametrize("every", [2, 3])
def test_rests_that_are_not_shaken_keep_their_noise(every: int) -> None:
    quiet = levels(recording(seed=3, poses=24, rate=100.0))
    beside = levels(shaken(every, white=True))
    alike = np.median(beside[::every], axis=0) / np.median(quiet, axis=0)
    np.testing.assert_allclose(alike, 1.0, atol=0.25)
    assert (beside[1::every] > 3.0 * quiet[1::every]).all()


@pytest.mark.long
@pytest.mark.parametrize("rate", [25.0, 100.0, 200.0])
def test_white_noise_is_known_to_a_few_percent(rate: float) -> None:
    ratio = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        motion = bench_protocol(rng, poses=20, power_on=0.0)
        real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=rate)
        grid = make_grid(real, find_poses(real))
        found = (sample_noise(grid) * grid.count[:, None])[grid.pose >= 0].mean(axis=0)
        density = np.repeat([CONSUMER.accel_noise_density, CONSUMER.gyro_noise_density], 3)
        ratio.append(np.log(found / (density**2 * rate / 2)))
    # A variance of 400 differences of points alone is known to 0.09, and their median is 6 % less.
    assert abs(np.mean(ratio)) < 0.04
    assert np.std(ratio) < 0.07


@pytest.mark.parametrize("keep", [0.5, 0.8])
def test_noise_that_is_correlated_counts_as_it_does_in_means(keep: float) -> None:
    """Of a filter ``y = keep y + (1 - keep) x`` a mean has as much noise as of x."""
    rng = np.random.default_rng(5)
    real = recording(seed=3, poses=24, rate=100.0)
    poses = find_poses(real)
    made = {"accel": real.accel.copy(), "gyro": real.gyro.copy()}
    for name, size in (("accel", 0.03), ("gyro", 3e-3)):
        white = rng.normal(0.0, size, (len(real), 3))
        made[name] += lfilter([1 - keep], [1.0, -keep], white, axis=0)
    grid = make_grid(replace(real, **made), poses)
    found = np.sqrt((sample_noise(grid) * grid.count[:, None])[grid.pose >= 0].mean(axis=0))
    assert (found > 0.8 * np.repeat([0.03, 3e-3], 3)).all()
    assert (found < 1.6 * np.repeat([0.03, 3e-3], 3)).all()


@pytest.mark.parametrize("on", [False, True])
def test_a_turn_is_as_noisy_as_it_is_shaken(on: bool) -> None:
    real = shaken(2, white=True)
    poses = find_poses(recording(seed=3, poses=24, rate=100.0))
    accel = real.accel.copy()
    if on:
        # The bench shakes what a hand turns on it as well.
        for a, b in zip(poses.stop[:-1], poses.start[1:], strict=True):
            accel[a:b] += 0.2 * np.random.default_rng(a).normal(size=(b - a, 3))
    grid = make_grid(replace(real, accel=accel), poses)
    noise = np.sqrt((sample_noise(grid) * grid.count[:, None])[grid.near < 0, :3])
    quiet = levels(recording(seed=3, poses=24, rate=100.0)).mean()
    assert (np.median(noise) < 1.5 * quiet) is not on
    assert np.median(noise) < 0.3


def test_tones_average_out_faster_than_white_noise() -> None:
    quiet = levels(recording(seed=3, poses=24, rate=100.0))[1::2].mean()
    tones, white = (levels(shaken(2, white=w))[1::2].mean() - quiet for w in (False, True))
    # Noise of 0.2 to 0.4 is noise; a tone of that size is nearly gone in the mean of a rest.
    assert 0.2 < white < 0.35
    assert tones < 0.15 * white


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4])
def test_what_tones_rectify_is_named_where_most_rests_are_shaken(seed: int) -> None:
    real = shaken(3, white=False, rectified=0.1, seed=seed)
    named = [f.effect for f in diagnose_recording(real, gravity=GRAVITY).findings]
    assert named == ["accel_vibration_rectification"]


def test_flicker_of_means_is_that_of_their_moments() -> None:
    """Summed over moments, close to each other, of processes as they are."""
    start, stop = np.array([0.0, 0.5, 2.5, 30.0]), np.array([0.5, 2.5, 7.0, 38.0])
    middle, length = 0.5 * (start + stop), stop - start
    found = flicker_covariance(middle, length)
    fine = np.arange(0.0025, 38.0, 0.005)
    inside = ((fine >= start[:, None]) & (fine < stop[:, None])).astype(float)
    inside /= inside.sum(axis=1, keepdims=True)
    span = np.ptp(middle)
    density = np.zeros(len(fine))
    for time in 3 * span * 3.0 ** -np.arange(12.0):
        density += np.exp(-fine / time) * np.log(3.0) / np.pi
    every = linalg.toeplitz(density)
    np.testing.assert_allclose(found, inside @ every @ inside.T, rtol=2e-2, atol=1e-4)
    assert np.linalg.eigvalsh(found).min() > 0


def test_halves_of_a_turn_differ_as_drift_does() -> None:
    """Draws of 1/f noise and of a walk, sampled finely: half of what their halves differ by."""
    interval = np.array([[0.0, 2.0], [2.0, 10.0], [10.0, 13.0]])
    kernels = DriftKernels.of(interval, np.array([1]))
    assert [k.shape for k in kernels] == [(4, 4)] * 3
    plain = DriftKernels.of(interval)
    for with_halves, without in zip(kernels, plain, strict=True):
        np.testing.assert_array_equal(with_halves[:3, :3], without)
        assert not with_halves[3, :3].any()
    assert kernels.jitter[3, 3] == 0.0
    rng, number, step = np.random.default_rng(4), 400, 0.01
    n = round(8.0 / step)
    # By its spectrum, 1 / (pi f) one-sided per square of a bias instability of one.
    length = 64 * n
    f = np.fft.rfftfreq(length, step)[1:]
    size = np.sqrt(1.0 / (np.pi * f) * length / (4.0 * step))
    flicker, walk = [], []
    for _ in range(number):
        z = np.append(0.0, size * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))))
        pieces = np.fft.irfft(z, length)[: 8 * n].reshape(8, n)
        flicker += (
            0.5 * (pieces[:, n // 2 :].mean(axis=1) - pieces[:, : n // 2].mean(axis=1))
        ).tolist()
        path = np.cumsum(rng.normal(0.0, np.sqrt(step / DRIFT_TIME), n))
        walk.append(0.5 * (path[n // 2 :].mean() - path[: n // 2].mean()))
    assert kernels.flicker[3, 3] == pytest.approx(np.var(flicker), rel=0.1)
    assert kernels.walk[3, 3] == pytest.approx(np.var(walk), rel=0.25)
