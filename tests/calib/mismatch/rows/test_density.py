"""Noise density between what hands do: right beside a hand, and not too small beside a filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from calib.mismatch.rows.density import quiet_density
from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.types import FloatArray

DENSITY = np.array([2e-3, 2e-3, 4e-3, 1e-4, 1e-4, 2e-4])


def rests(values: FloatArray, rate: float, *, lasts: float = 6.0) -> tuple[Recording, Poses]:
    time = np.arange(len(values)) / rate
    recording = Recording(time, values[:, :3] + [0.0, 0.0, 9.8], values[:, 3:], clock="host")
    start = np.arange(0, len(values) - int(lasts * rate), int((lasts + 2.0) * rate))
    return recording, average_poses(recording, start, start + int(lasts * rate))


def white(rng: np.random.Generator, rate: float, seconds: float = 240.0) -> FloatArray:
    return DENSITY * np.sqrt(rate / 2.0) * rng.normal(size=(int(rate * seconds), 6))


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
def test_it_is_that_of_white_noise(rate: float) -> None:
    found = quiet_density(*rests(white(np.random.default_rng(1), rate), rate))
    assert found is not None
    np.testing.assert_allclose(np.sqrt(found), DENSITY, rtol=0.15)


@pytest.mark.parametrize("rate", [100.0, 200.0])
def test_a_hand_is_not_in_it(rate: float) -> None:
    """It sways by thirty times the noise, and trembles by as much."""
    rng = np.random.default_rng(2)
    noise = white(rng, rate)
    for low, high, size in ((0.05, 0.8, 30.0), (8.0, 12.0, 30.0)):
        band = signal.butter(4, [low, high], "band", fs=rate, output="sos")
        moved = signal.sosfiltfilt(band, rng.normal(size=noise.shape), axis=0)
        noise += size * DENSITY * moved / moved.std(axis=0) * np.sqrt(rate / 2.0)
    found = quiet_density(*rests(noise, rate))
    assert found is not None
    assert (np.sqrt(found) < 2.0 * DENSITY).all()
    assert (np.sqrt(found) > 0.8 * DENSITY).all()


def test_noise_that_is_low_passed_is_that_of_the_band_it_is_in() -> None:
    rng = np.random.default_rng(3)
    low = signal.butter(2, 5.0, fs=100.0, output="sos")
    found = quiet_density(*rests(signal.sosfilt(low, white(rng, 100.0), axis=0), 100.0))
    assert found is not None
    np.testing.assert_allclose(np.sqrt(found), DENSITY, rtol=0.35)


def test_none_is_told_of_rests_that_are_too_short() -> None:
    noise = white(np.random.default_rng(4), 100.0, 60.0)
    assert quiet_density(*rests(noise, 100.0, lasts=1.5)) is None
