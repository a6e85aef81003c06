"""Stamps that scatter: of samples that were taken so, and of samples that were not."""

import numpy as np
import pytest

from calib.mismatch.stamps import with_even_stamps
from calib.recording import Recording
from calib.types import FloatArray

RATE = 100.0


def recorded(taken: FloatArray, stamps: FloatArray) -> Recording:
    """Return turns of two seconds, and rests as long between them, seen when they were taken."""
    rng = np.random.default_rng(4)
    part = np.clip(np.mod(taken, 4.0) / 2.0, 0, 1)
    rate = np.outer(np.sin(np.pi * part) ** 2, [1.5, -1.0, 0.5])
    turned = np.floor(taken / 4.0) + part - np.sin(2 * np.pi * part) / (2 * np.pi)
    tilt = turned[:, None]
    force = 9.8 * np.hstack((np.sin(tilt), np.cos(tilt), 0.1 * np.sin(tilt)))
    return Recording(
        stamps,
        force + 0.01 * rng.normal(size=force.shape),
        rate + 1e-3 * rng.normal(size=rate.shape),
        "device",
    )


def scatter(stamps: FloatArray, taken: FloatArray) -> float:
    return float(np.std(np.diff(stamps - taken)))


@pytest.mark.parametrize("epoch", [0.0, 1.7e9])
def test_scatter_that_signals_do_not_follow_goes(epoch: float) -> None:
    taken = np.arange(6000) / RATE
    late = 1e-3 * np.random.default_rng(1).uniform(-1, 1, len(taken))
    stamps = epoch + taken + late
    mended = with_even_stamps(recorded(taken, stamps)).time - epoch
    assert scatter(mended, taken) < 0.1 * scatter(stamps - epoch, taken)


def test_scatter_that_signals_follow_stays() -> None:
    taken = np.arange(6000) / RATE
    taken += 1e-3 * np.random.default_rng(1).uniform(-1, 1, len(taken))
    assert np.array_equal(with_even_stamps(recorded(taken, taken)).time, taken)


def test_a_gap_and_the_rate_of_a_clock_stay() -> None:
    taken = np.delete(np.arange(6000) / RATE, [700, 701, 702])
    late = 1e-3 * np.random.default_rng(2).uniform(-1, 1, len(taken))
    stamps = 1.001 * taken + late
    mended = with_even_stamps(recorded(taken, stamps)).time
    assert np.abs(mended - 1.001 * taken).max() < 1.1e-3
    assert scatter(
        np.delete(mended, slice(690, 710)), np.delete(1.001 * taken, slice(690, 710))
    ) < (0.2 * scatter(stamps, 1.001 * taken))


def test_a_recording_that_never_moves_keeps_its_stamps() -> None:
    rng = np.random.default_rng(3)
    stamps = np.arange(500) / RATE + 1e-3 * rng.uniform(-1, 1, 500)
    still = Recording(stamps, rng.normal(size=(500, 3)), rng.normal(size=(500, 3)), "device")
    assert with_even_stamps(still) is still
