"""Recordings without noise."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.noise.hush import HUSHED, audible, count_of, least_noise, silent
from calib.mismatch.samples.thin import thin
from calib.recording import Recording

from ..bench import GRAVITY
from ..bench import recording as simulated


def noiseless(seed: int) -> Recording:
    return simulated(seed=seed, rate=100.0, without_noise=True)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.long
def test_a_recording_without_noise_shows_nothing(seed: int) -> None:
    found = diagnose_recording(noiseless(seed), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == []
    assert not found.unexplained
    assert found.summary["silent"].startswith("accel.x")


def test_a_channel_that_stays_on_a_count_is_not_silent_however_its_file_rounds() -> None:
    """Decimals make steps that are a count within a thousandth, and a hundred counts are not."""
    real = simulated(seed=4, rate=50.0)
    count = 0.00106526
    still = np.abs(real.gyro) < 0.02
    coarse = np.round(count * np.round(np.where(still, 0.0, real.gyro) / count), 6)
    assert audible(replace(real, gyro=coarse)).notes.get(HUSHED) is None


def test_only_channels_that_are_silent_get_noise() -> None:
    real = simulated(seed=1, rate=100.0)
    assert audible(real) is real
    still = noiseless(1)
    mixed = replace(real, gyro=still.gyro)
    heard = audible(mixed)
    assert heard.notes[HUSHED] == "gyro.x, gyro.y, gyro.z"
    np.testing.assert_array_equal(heard.accel, mixed.accel)
    added = (heard.gyro - mixed.gyro).std(axis=0)
    np.testing.assert_allclose(added, least_noise(mixed.interval)[3:], rtol=0.03)
    np.testing.assert_array_equal(audible(mixed).gyro, heard.gyro)


def test_coarse_counts_are_not_silent() -> None:
    still = noiseless(1)
    counted = 1e-3 * np.round(np.hstack((still.accel, still.gyro)) / 1e-3)
    assert not silent(counted, still.interval).any()


def test_what_samples_show_is_looked_for_before_noise_is_added() -> None:
    still = noiseless(1)
    limit = 0.8 * np.abs(still.gyro).max()
    clipped = replace(still, gyro=np.clip(still.gyro, -limit, limit))
    seen = thin(lambda: (clipped,)).seen
    assert [f.effect for f in seen.findings] == ["saturation"]


def test_what_rounding_of_numbers_leaves_is_no_count() -> None:
    values = np.stack((1e-310 * np.arange(50.0), np.sin(np.arange(50.0))), axis=1)
    values[:, 0] += 0.5 * (np.arange(50) > 20)
    assert not count_of(values).any()
    counts = 0.01 * np.random.default_rng(1).integers(-3, 4, (500, 1))
    assert count_of(counts) == pytest.approx([0.01])
