import numpy as np
import pytest

from calib.mismatch.reference.flicker import Slow, flicker_levels, flicker_of, slow_left
from calib.recording import CHANNELS
from calib.simulation.noise import flicker

STEP = 0.01
"""s between points."""


def windows(n: int, instability: float, white: float, seed: int, count: int = 60) -> np.ndarray:
    """Return (count, n) points of one channel, 1/f noise that goes on between them."""
    rng = np.random.default_rng(seed)
    whole = np.arange(count * n) * STEP
    values = flicker(whole, instability, rng=rng)[:, 0] + rng.normal(0.0, white, len(whole))
    return values.reshape(count, n)


def seen_in(values: np.ndarray, shapes: np.ndarray) -> Slow:
    n = len(values)
    mean = np.full(n, n**-0.5)
    rest = values - mean * (mean @ values)
    return slow_left(rest - shapes @ (shapes.T @ rest), mean, shapes)


def level_of(slow: list[Slow], white: float) -> float:
    every = [dict(enumerate(slow)), *({} for _ in CHANNELS[1:])]
    found = flicker_levels(every, np.full((len(slow), 6), white**2), np.full(len(slow), STEP))
    assert not found[1:].any()
    return float(found[0])


def orthonormal(n: int, *shapes: np.ndarray) -> np.ndarray:
    columns = np.stack(shapes, axis=1) - np.mean(shapes, axis=1)
    return np.linalg.qr(columns)[0].reshape(n, -1)


def test_projections_on_slow_shapes_vary_as_much_as_is_said():
    """Of 1/f noise that is simulated by processes in time, not by cosines."""
    n = 400
    at = np.linspace(-1.0, 1.0, n)
    shapes = orthonormal(n, at, at**2, np.sin(20 * at))
    values = np.concatenate([windows(n, 1.0, 0.0, seed, 200) for seed in range(6)])
    seen = np.square(values @ shapes).mean(axis=0)
    said = flicker_of(list(shapes.T))
    # A recording is no period: of its slowest cosine there is a fifth less.
    assert (seen < 1.05 * said).all()
    assert (seen[:2] > 0.7 * said[:2]).all()
    # Flicker is most of what is slow, and little of what is fast.
    assert said[0] > 5 * said[2]


@pytest.mark.parametrize(
    ("instability", "n"), [(0.3, 100), (3.0, 100), (0.1, 1000), (0.3, 1000), (3.0, 1000)]
)
def test_the_instability_is_found_beside_shapes_that_take_the_slowest(instability: float, n: int):
    at = np.linspace(-1.0, 1.0, n)
    shapes = orthonormal(n, at, at**3)
    white = 0.3
    found = []
    for seed in range(8):
        slow = [seen_in(v, shapes) for v in windows(n, instability, white, seed)]
        found.append(level_of(slow, white))
    # A straight line takes the slowest cosine.
    assert len(slow[0].square) < 8
    assert np.exp(np.mean(np.log(found))) == pytest.approx(instability**2, rel=0.3)


def test_what_happens_in_one_window_is_no_flicker():
    n, white = 300, 0.3
    none = np.zeros((n, 0))
    values = windows(n, 0.1, white, 1)
    calm = level_of([seen_in(v, none) for v in values], white)
    values[7] += 100.0 * np.linspace(0.0, 1.0, n)
    assert level_of([seen_in(v, none) for v in values], white) < 1.5 * calm


def test_without_anything_to_tell_it_is_what_is_expected():
    """Shapes that leave nothing slow: only what data sheets have says what to expect."""
    n, white = 60, 0.3
    at = np.arange(n) + 0.5
    shapes = orthonormal(n, *(np.cos(np.pi * k * at / n) for k in range(1, 9)))
    slow = [seen_in(v, shapes) for v in windows(n, 5.0, white, 2, 10)]
    assert all(not len(s.square) for s in slow)
    density = 2 * white**2 * STEP
    assert level_of(slow, white) == pytest.approx(0.15**2 * density, rel=0.06)
