"""Orientations at rest are taken as one, or as a line, as far as that is what the body does."""

import numpy as np
import pytest

from calib.mismatch.reference.steadied import LONGEST, steadied
from calib.rotation import mat_from_rotvec, rotvec_from_mat

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
    """Return the rates of angles (n, 3), as differences of neighbours on both sides say."""
    return np.gradient(angle, STEP, axis=0)


def seen(angle: np.ndarray, at: np.ndarray, time: np.ndarray | None = None):
    time = STEP * np.arange(len(angle)) if time is None else time
    return steadied(time, rate_of(angle), at, angle=DENSITY, interval=STEP, band=BAND)


def test_a_rest_takes_the_noise_of_angles_away():
    at = rests(30)
    angle = white(62 * REST)
    found = seen(angle, at)
    assert found.noise == pytest.approx(DENSITY, rel=0.1)
    assert found.sway < 0.2 * DENSITY
    assert found.inside.sum() == 30 * REST
    np.testing.assert_allclose((found.lines.T @ found.lines).toarray(), np.eye(30), atol=1e-12)
    blocks = (angle + found.moved)[at[0, 0] : at[0, 1]].reshape(-1, 20, 3).mean(axis=1)
    assert blocks.std(axis=0).max() < 0.3 * angle.std() / np.sqrt(20)


def test_forces_feel_angles_as_they_were_captured_and_rates_what_they_add_up_to():
    """Noise turns about itself as it comes and goes, which a sum of rates keeps."""
    at, large = rests(12), 30.0
    angle = large * white(26 * REST)
    mat = mat_from_rotvec(angle)
    step = rotvec_from_mat(np.swapaxes(mat[:-1], 1, 2) @ mat[1:]) / STEP
    rate = np.zeros_like(angle)
    rate[1:-1] = 0.5 * (step[:-1] + step[1:])
    time = STEP * np.arange(len(angle))
    found = steadied(time, rate, at, mat, angle=large * DENSITY, interval=STEP, band=BAND)
    summed = np.cumsum(0.5 * (rate[1:] + rate[:-1]), axis=0) * STEP
    drift = np.zeros((len(at), 2))
    for k, (a, b) in enumerate(at):
        own = angle[a:b] - angle[a:b].mean(axis=0)
        left = own + found.tilted[a:b]
        assert np.abs(left).max() < 0.02 * np.abs(own).max()
        added = summed[a - 1 : b - 1] - summed[a - 1 : b - 1].mean(axis=0)
        np.testing.assert_allclose(added, -found.moved[a:b], atol=1e-12)
        ends = (x[-80:].mean(axis=0) - x[:80].mean(axis=0) for x in (own, added))
        drift[k] = [end @ end for end in ends]
    assert drift[:, 1].mean() > 4.0 * drift[:, 0].mean()


def test_short_rests_sway_no_more_than_long_ones():
    """Of three blocks a line leaves one, and their steps are not those of white ones."""
    found = seen(white(122 * 85), rests(60, 85))
    assert found.inside.sum() == 60 * 85
    assert found.sway < 0.25 * found.noise
    assert found.noise == pytest.approx(DENSITY, rel=0.15)


def swaying(time: np.ndarray, size: float) -> np.ndarray:
    return size * np.sin(2 * np.pi * 0.4 * time)[:, None] * [1.0, 0.5, 0.2]


def test_what_a_body_sways_by_less_than_noise_is_noise():
    at = rests(30)
    time = STEP * np.arange(62 * REST)
    found = seen(white(len(time)) + swaying(time, 4e-4), at)
    assert 0.2 * DENSITY < found.sway <= found.noise < 1.5 * DENSITY


def test_a_rest_in_which_a_held_body_sways_is_seen_as_it_is():
    at = rests(30)
    time = STEP * np.arange(62 * REST)
    assert seen(white(len(time)) + swaying(time, 4e-3), at) is None
    # From some moment on it lies on a table.
    early = time < time[at[10, 0] - 1]
    found = seen(white(len(time)) + early[:, None] * swaying(time, 4e-3), at)
    assert not found.inside[: at[9, 1]].any()
    assert not found.moved[: at[9, 1]].any()
    assert found.inside[at[10, 0] :].sum() == 20 * REST
    assert found.sway < 0.3 * DENSITY


@pytest.mark.parametrize("turning", [slice(3, 4), slice(None)])
def test_a_body_that_turns_slowly_at_rest_is_followed(turning):
    at = rests(10)
    time = STEP * np.arange(22 * REST)
    slow = np.zeros((len(time), 3))
    for a, b in at[turning]:
        slow[a:b] = (time[a:b] - time[a])[:, None] * np.array([1e-3, -2e-4, 0.0])
    found = seen(white(len(time)) + slow, at)
    assert found.lines.shape[1] == 10 + len(at[turning])
    left = (white(len(time)) + slow + found.moved)[at[3, 0] : at[3, 1]].reshape(4, 100, 3)
    rate = (left[-1] - left[0]).mean(axis=0) / (300 * STEP)
    np.testing.assert_allclose(rate, [1e-3, -2e-4, 0.0], atol=2e-4)
    assert found.noise == pytest.approx(DENSITY, rel=0.15)


def test_all_rests_have_slopes_where_together_they_turn_by_more_than_noise():
    at = rests(60)
    time = STEP * np.arange(122 * REST)
    slope = DENSITY / np.sqrt(2 * REST * STEP) * np.sqrt(12.0) / (REST * STEP)
    rng = np.random.default_rng(3)
    slow = np.zeros((len(time), 3))
    for a, b in at:
        slow[a:b] = (time[a:b] - time[a])[:, None] * rng.normal(0.0, 0.8 * slope, 3)
    assert seen(white(len(time)), at).lines.shape[1] < 63
    assert seen(white(len(time)) + slow, at).lines.shape[1] == 120


def test_long_rests_are_seen_in_parts():
    found = seen(white(4 * 2000), np.array([[1000, 1000 + 4 * int(LONGEST / STEP)]]))
    assert found.lines.shape[1] == 4


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
