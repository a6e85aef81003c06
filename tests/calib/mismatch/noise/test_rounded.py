"""Coarse counts: the noise before rounding, and how far means are off."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch.noise.rounded import look_at_counts

LSB = 0.02


def rests(level: np.ndarray, sigma: float, rng: np.random.Generator) -> list[np.ndarray]:
    return [LSB * np.rint(rng.normal(each, sigma, 800)) for each in level]


@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.2, 0.3, 0.45])
@pytest.mark.parametrize("where", [(-0.5, 0.5), (0.2, 0.3), (0.45, 0.5), (0.1, 0.35)])
def test_means_err_as_much_as_is_said(sigma: float, where: tuple[float, float]) -> None:
    """Wherever the rests are: spread over a count, or all at one place between two."""
    rng = np.random.default_rng(3)
    level = rng.uniform(*where, 60)
    samples = rests(level, sigma, rng)
    found = look_at_counts(samples, LSB)
    off = np.mean(samples, axis=1) - LSB * level - found.error
    if sigma > 0.1 and where != (0.45, 0.5):
        assert found.sigma == pytest.approx(sigma * LSB, rel=0.1)
    seen = [np.var(own) / len(own) for own in samples]
    whole = found.covariance + np.diag(found.variance + seen)
    assert off @ np.linalg.solve(whole, off) < 2.0 * len(off)
    # And in each mode, but for the mean: that is a bias.
    centred = np.linalg.svd(np.ones((1, len(off))))[2][1:]
    values, modes = np.linalg.eigh(centred @ whole @ centred.T)
    assert (np.square(centred @ off @ modes) < 20.0 * values).all()


def test_what_is_expected_of_the_error_is_most_of_it() -> None:
    """Noise of a quarter of a count: means lean towards the nearest count, all in one way."""
    rng = np.random.default_rng(6)
    level = rng.uniform(-0.5, 0.5, 60)
    samples = rests(level, 0.25, rng)
    found = look_at_counts(samples, LSB)
    off = np.mean(samples, axis=1) - LSB * level
    assert np.std(off - found.error) < 0.4 * np.std(off)


def test_a_shaken_rest_says_nothing_of_the_others() -> None:
    rng = np.random.default_rng(5)
    quiet = rests(rng.uniform(-0.5, 0.5, 20), 0.2, rng)
    shaken = [LSB * np.rint(rng.normal(0.0, 1.0, 800)) for _ in range(3)]
    found, alone = look_at_counts([*quiet, *shaken], LSB), look_at_counts(quiet, LSB)
    assert found.sigma == pytest.approx(alone.sigma, rel=0.02)
    np.testing.assert_allclose(found.total[:20], alone.total, rtol=0.1)


def test_levels_that_never_leave_their_counts_are_anywhere_in_them() -> None:
    found = look_at_counts([np.full(300, 1.5), np.full(200, 2.0)], 0.5)
    assert found.sigma < 0.25 * 0.5
    np.testing.assert_allclose(found.total, 0.5**2 / 12, rtol=0.7)


def test_samples_between_counts_are_not_rounded() -> None:
    rng = np.random.default_rng(4)
    some = [rng.normal(0.0, 0.4, 2000) + rng.uniform(-0.5, 0.5, 2000) for _ in range(5)]
    found = look_at_counts(some, 1.0)
    assert found.sigma == pytest.approx(np.hypot(0.4, 12**-0.5), rel=0.05)
    assert (found.total < 1e-4).all()
