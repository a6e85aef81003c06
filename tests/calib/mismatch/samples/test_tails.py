"""How far means of a few samples go by chance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri

from calib.mismatch.samples.tails import beyond, tails, usual_of


def noise(freedom: float, n: int = 400_000) -> np.ndarray:
    rng = np.random.default_rng(5)
    return rng.standard_t(freedom, (n, 6)) if np.isfinite(freedom) else rng.normal(size=(n, 6))


@pytest.mark.parametrize("freedom", [5.0, 8.0, 20.0])
def test_the_tails_of_noise_are_found(freedom: float) -> None:
    found = tails(np.abs(noise(freedom)), np.zeros(6))
    assert found == pytest.approx(np.full(6, freedom), rel=0.15)


def test_normal_noise_has_none() -> None:
    values = noise(np.inf, 20_000)
    found = tails(np.abs(values), np.zeros(6))
    assert np.isinf(found).all()
    assert beyond(found, 4, 1e-4) == pytest.approx(np.full(6, -ndtri(1e-4)))


@pytest.mark.parametrize("width", [1, 4, 16])
def test_means_go_as_far_as_they_are_said_to(width: int) -> None:
    """Of normal noise one in 2000 is beyond; of means of t noise not more than twice as many."""
    values = noise(6.0, 480_000)
    mean = values.reshape(-1, width, 6).mean(axis=1)
    limit = beyond(np.full(6, 6.0), width, 5e-4)
    share = (mean / usual_of(mean, np.zeros(6)) > limit).mean()
    assert 2.5e-4 < share < 1e-3
    plain = (mean / usual_of(mean, np.zeros(6)) > -ndtri(5e-4)).mean()
    assert plain > share


def test_a_channel_without_noise_shows_nothing() -> None:
    assert np.isinf(usual_of(np.zeros((9, 6)), np.zeros(6))).all()
