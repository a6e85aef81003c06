"""What differences are seen through: in a frame that does not turn, where angles were captured."""

import numpy as np
import pytest
from scipy import sparse

from calib.mismatch.reference.colour import (
    WHITE,
    Blur,
    Colour,
    explained_by,
    find_colour,
    whitening,
)
from calib.mismatch.reference.filters import smoothed
from calib.recording import CHANNELS
from calib.rotation import integrate_rate, mat_from_quat

STEP, BAND = 0.01, 10.0


def turning(n: int) -> np.ndarray:
    """Return orientations (n, 3, 3) of a body that is waved at 4 rad/s."""
    time = STEP * np.arange(n)
    rate = 4.0 * np.stack(
        [np.sin(3.0 * time), np.cos(2.3 * time), np.sin(1.7 * time + 1.0)], axis=1
    )
    return mat_from_quat(integrate_rate(time, rate))


def blur(n: int, mat: np.ndarray | None) -> Blur:
    return whitening(STEP * np.arange(n), [WHITE, Colour(4.0, 0.0)], STEP, (BAND, BAND), mat)


def test_one_frame_is_that_of_the_room() -> None:
    rng, n = np.random.default_rng(1), 900
    mat, signals = turning(n), rng.normal(size=(n, 6))
    seen = blur(n, mat)
    found = seen.see(signals)
    body = blur(n, None)
    room = np.einsum("nij,nj->ni", mat, signals[:, 3:])
    through = body.matrices[1] @ room
    expected = np.einsum("nji,nj->ni", mat[seen.seen], through)
    np.testing.assert_allclose(found[:, 3:], expected, atol=1e-12)
    np.testing.assert_allclose(found[:, :3], body.see(signals)[:, :3], atol=1e-12)


@pytest.mark.parametrize("framed", [False, True])
def test_rows_of_what_is_seen_are_rows_of_the_signals(framed: bool) -> None:
    rng, n = np.random.default_rng(2), 900
    signals = rng.normal(size=(n, 6))
    own = blur(n, turning(n) if framed else None)
    weights = sparse.random(7, len(own.seen), density=0.1, random_state=3, format="csr")
    for channel in range(6):
        parts = own.seen_by(weights, channel)
        found = sum(part @ signals[:, c] for c, part in parts.items())
        np.testing.assert_allclose(found, weights @ own.see(signals)[:, channel], atol=1e-12)


def test_forces_may_be_seen_less_far_up_than_rates() -> None:
    """Noise beyond is in neither what is seen nor its level, and what is slow is as it was."""
    rng, n = np.random.default_rng(7), 6000
    time, noise = STEP * np.arange(n), rng.normal(size=(n, 6))
    passed = smoothed(time, noise, BAND)
    both = whitening(time, [WHITE, WHITE], STEP, (BAND, BAND))
    own = whitening(time, [WHITE, WHITE], STEP, (0.4 * BAND, BAND))
    seen = own.see(passed)
    same = both.see(passed)[np.isin(both.seen, own.seen), 3:]
    np.testing.assert_allclose(seen[:, 3:], same, atol=1e-3)
    np.testing.assert_allclose(
        seen[:, :3], smoothed(time, passed, 0.4 * BAND)[own.seen, :3], atol=0.02
    )
    for triad, power in zip((seen[:, :3], seen[:, 3:]), own.power, strict=True):
        assert np.square(triad).mean() == pytest.approx(power, rel=0.05)
    assert own.power[0] == pytest.approx(0.4 * own.power[1])
    slow = np.sin(2 * np.pi * 0.3 * time)
    np.testing.assert_allclose(own.matrices[0] @ slow, slow[own.seen], atol=2e-3)


def test_what_captured_angles_err_by_is_white_in_one_frame() -> None:
    """In the body's their noise times the rate is slow noise beside: a misalignment was in it."""
    rng, n, angle = np.random.default_rng(4), 12000, 4e-4
    mat, time = turning(n), STEP * np.arange(n)
    errors = rng.normal(0.0, angle / np.sqrt(2.0 * STEP), (n, 3))
    room = smoothed(time, np.gradient(errors, STEP, axis=0), BAND)
    body = np.einsum("nji,nj->ni", mat, room)
    framed = find_colour(time, np.einsum("nij,nj->ni", mat, body), STEP, BAND, long=True)
    own = find_colour(time, body, STEP, BAND, long=True)
    assert framed.density < 0.3 * own.density
    assert framed.density * np.sqrt(framed.square) == pytest.approx(2 * np.pi * angle, rel=0.1)
    assert find_colour(time, room, STEP, BAND, least=1e-3).density >= 1e-3
    # Unless there is less of everything.
    assert find_colour(time, room, STEP, BAND, least=1.0).density < 0.1


@pytest.mark.parametrize("power", [1, 2])
def test_slow_noise_is_found_below_what_grows_with_frequency(power: int) -> None:
    """With both powers open what is slow was left to chance."""
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        white, fast = rng.normal(size=(2, 9600, 3)) / np.sqrt(2.0 * STEP)
        for _ in range(power):
            fast = np.gradient(fast, STEP, axis=0) / (2 * np.pi)
        time = STEP * np.arange(len(white))
        found.append(find_colour(time, smoothed(time, white + 0.4 * fast, 5.0), STEP, 5.0))
    assert np.mean([c.density for c in found]) == pytest.approx(1.0, rel=0.15)
    assert np.std([c.density for c in found]) < 0.15
    assert np.median([[c.square, c.fourth][2 - power] for c in found]) == 0.0


@pytest.mark.parametrize("framed", [False, True])
def test_what_columns_explain_is_no_noise(framed: bool) -> None:
    rng, n = np.random.default_rng(5), 3000
    own = blur(n, turning(n) if framed else None)
    columns = [(name, rng.normal(size=n)) for name in CHANNELS for _ in range(2)]
    sizes = rng.normal(size=len(columns))
    signals = np.zeros((n, 6))
    for (name, values), size in zip(columns, sizes, strict=True):
        signals[:, CHANNELS.index(name)] += size * values
    # A column twice is as good as once.
    found = explained_by(signals, [*columns, columns[0]], own)
    np.testing.assert_allclose(found, signals, atol=1e-2)
    assert not explained_by(signals, [], own).any()
