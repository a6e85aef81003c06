"""Rests that end swings: what swings is none, however long; its end, once still, is one."""

import numpy as np
import pytest

from calib import Recording
from calib.statics import find_poses
from calib.types import FloatArray

GRAVITY, RATE = 9.80665, 100.0


def smooth(s: FloatArray) -> FloatArray:
    """Return a smooth step from 0 to 1 over 0..1, at rest at both ends."""
    s = np.clip(s, 0.0, 1.0)
    return np.asarray(s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3))


def record(
    *, rests: tuple[float, ...], swing: float = 0.0, fades: float = 8.0, seed: int = 0
) -> tuple[Recording, list[tuple[float, float]]]:
    """Return rests of so many s, the turns between them, and where the sensor is still, s.

    From its third turn it comes back hanging on a string, and swings with a rate of `swing`, rad/s:
    its specific force stays along the string.
    """
    rng = np.random.default_rng(seed)
    ends = np.cumsum([r + 2.0 for r in rests]) - 2.0
    time = np.arange(round(ends[-1] * RATE)) / RATE
    angle = sum(
        (1.2 if k % 2 else -1.7) * smooth((time - end) / 2.0) for k, end in enumerate(ends[:-1])
    )
    rate = np.zeros((len(time), 3))
    rate[:, 0] = np.gradient(angle, 1 / RATE)
    force = GRAVITY * np.column_stack((np.zeros_like(time), np.sin(angle), np.cos(angle)))
    since = time - (ends[3] - rests[3])
    hangs = (since > -1.0) & (time < ends[3] + 1.0)
    size = swing * np.exp(-np.maximum(since, 0.0) / fades) * smooth(since + 1.0) * hangs
    rate[:, 0] += size * np.sin(2 * np.pi * 0.7 * since)
    force += 0.02 * rng.standard_normal(rate.shape)
    rate += (0.01, -0.02, 0.005)
    rate += 0.002 * rng.standard_normal(rate.shape)
    still = [(float(end - r), float(end)) for end, r in zip(ends, rests, strict=True)]
    return Recording(time, force, rate, "nominal"), still


def inside(made: Recording, begin: float, stop: float) -> float:
    """Return how many s from `begin` to `stop` are in rests that were found."""
    first, last = find_poses(made).interval.T
    return float(np.clip(np.minimum(last, stop) - np.maximum(first, begin), 0.0, None).sum())


RESTS = (6.0, 8.0, 7.0, 40.0, 6.0, 9.0, 7.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("swing", [0.06, 0.1, 0.15])
def test_swing_is_no_rest_until_it_has_died_away(swing: float, seed: int) -> None:
    fades = 5.0
    made, still = record(rests=RESTS, swing=swing, fades=fades, seed=seed)
    begin, stop = still[3]
    # There is noise of 0.0006 rad/s in a mean over 0.1 s.
    loud, dead = fades * np.log(swing / np.array([0.006, 0.001]))
    assert inside(made, begin, begin + loud) == 0.0
    assert inside(made, begin + dead, stop) > 0.85 * (stop - begin - dead)
    assert len(find_poses(made)) == len(RESTS)


@pytest.mark.parametrize("swing", [0.06, 0.12])
def test_what_swings_throughout_is_no_rest(swing: float) -> None:
    made, still = record(rests=RESTS, swing=swing, fades=1e3)
    assert inside(made, *still[3]) == 0.0
    assert len(find_poses(made)) == len(RESTS) - 1


def test_without_a_swing_all_are_rests() -> None:
    made, still = record(rests=RESTS)
    assert len(find_poses(made)) == len(RESTS)
    assert all(inside(made, *span) > 0.85 * (span[1] - span[0]) for span in still)


@pytest.mark.parametrize("seed", range(4))
def test_hand_that_trembles_is_at_rest(seed: int) -> None:
    """It tilts, and is moved as well: 0.03 rad/s and 0.1 m/s² rms."""
    made, still = record(rests=RESTS, seed=seed)
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(len(made), 1 / RATE)
    shape = frequency / (1.0 + (frequency / 2.0) ** 3)
    noise = rng.standard_normal((len(frequency), 6)) + 1j * rng.standard_normal((len(frequency), 6))
    hand = np.fft.irfft(noise * shape[:, None], len(made), axis=0)
    hand /= hand.std(axis=0)
    begin, stop = still[3]
    inner = (made.time > begin - 1.0) & (made.time < stop + 1.0)
    rate = 0.03 * hand[:, 3:] * inner[:, None]
    tilt = np.cumsum(rate, axis=0) / RATE
    accel = made.accel + np.cross(made.accel, tilt) + 0.1 * hand[:, :3] * inner[:, None]
    shaken = Recording(made.time, accel, made.gyro + rate, "nominal")
    assert inside(shaken, begin, stop) > 0.85 * (stop - begin)


@pytest.mark.parametrize("size", [0.005, 0.015])
def test_gyroscope_that_is_disturbed_is_at_rest(size: float) -> None:
    made, still = record(rests=RESTS)
    begin, stop = still[3]
    wave = size * np.sin(2 * np.pi * 0.8 * made.time) * (abs(made.time - begin - 20.0) < 12.0)
    made = Recording(made.time, made.accel, made.gyro + np.outer(wave, (1.0, 0.0, 0.0)), "nominal")
    assert inside(made, begin, stop) > 0.85 * (stop - begin)
