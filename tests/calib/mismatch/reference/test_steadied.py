"""Orientations at rest are taken as lines, as far as that is what the body does."""

import numpy as np
import pytest

from calib.mismatch.reference.steadied import LONGEST, steadied

STEP, BAND = 0.02, 8.0
DENSITY = 3e-4
REST = 400


def rests(number: int, length: int = REST) -> np.ndarray:
    """Return so many rests, with as many points between them."""
    start = np.arange(number) * 2 * length + length
    return np.stack((start, start + length), axis=1)


def white(n: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, DENSITY / np.sqrt(2.0 * STEP), (n, 3))


def rate_of(angle: np.ndarray) -> np.ndarray:
    """Return rates that the trapezoidal rule makes of steps of the angles."""
    return np.gradient(angle, STEP, axis=0)


def seen(angle: np.ndarray, at: np.ndarray, time: np.ndarray | None = None):
    time = STEP * np.arange(len(angle)) if time is None else time
    return steadied(time, rate_of(angle), at, interval=STEP, band=BAND)


def test_lines_take_the_noise_of_angles_away():
    at = rests(30)
    angle = white(62 * REST)
    found = seen(angle, at)
    assert found.noise == pytest.approx(DENSITY, rel=0.1)
    assert found.sway < 0.2 * DENSITY
    assert found.inside.sum() == 30 * REST
    gram = (found.lines.T @ found.lines).toarray()
    np.testing.assert_allclose(gram, np.eye(60), atol=1e-12)
    # What is left is a line: all but two of the degrees of freedom have moved.
    left = (angle + found.moved)[at[0, 0] + 1 : at[0, 1] - 1]
    assert np.abs(np.diff(left, n=2, axis=0)).max() < 3.0 * np.abs(angle).max()
    blocks = left[:375].reshape(-1, 15, 3).mean(axis=1)
    assert np.diff(blocks, axis=0).std() < 0.3 * np.sqrt(2.0 / 15) * angle.std()


@pytest.mark.parametrize(("size", "some"), [(0.0, False), (3e-4, False), (3e-3, True)])
def test_what_a_held_body_sways_by_is_noise(size, some):
    at = rests(30)
    time = STEP * np.arange(62 * REST)
    sway = size * np.sin(2 * np.pi * 0.4 * time)[:, None] * [1.0, 0.5, 0.2]
    found = seen(white(len(time)) + sway, at)
    assert (found.sway > 0.5 * DENSITY) == some
    assert found.sway <= found.noise


def test_a_body_that_turns_slowly_at_rest_is_followed():
    at = rests(10)
    time = STEP * np.arange(22 * REST)
    leaning = time[:, None] * np.array([1e-3, -2e-4, 0.0])
    still, turning = (seen(white(len(time)) + own, at) for own in (0.0 * leaning, leaning))
    np.testing.assert_allclose(turning.moved, still.moved, atol=1e-9)
    assert turning.noise == pytest.approx(still.noise)


def test_long_rests_have_several_lines():
    found = seen(white(4 * 2000), np.array([[1000, 1000 + 4 * int(LONGEST / STEP)]]))
    assert found.lines.shape[1] == 8


def test_rests_that_are_short_or_have_a_gap_are_left_as_they_are():
    angle = white(40 * REST)
    assert seen(angle, np.zeros((0, 2), np.int64)) is None
    assert seen(angle, rests(5, 40)) is None
    time = STEP * np.arange(len(angle))
    at = rests(2)
    time[at[1, 0] + 50 :] += 1.0
    found = seen(angle, at, time)
    assert found.inside[at[0, 0] : at[0, 1]].all()
    assert not found.inside[at[1, 0] : at[1, 1]].any()
    assert not found.moved[~found.inside].any()


def test_a_motion_without_noise_needs_no_lines():
    assert seen(np.zeros((22 * REST, 3)), rests(10)) is None
