"""Rests in which a sensor is moved without a turn: what is pushed is no rest, what sways is."""

import numpy as np
import pytest

from calib import Recording
from calib.statics import find_poses
from calib.types import FloatArray

GRAVITY = 9.80665
REST, TURN, NUMBER = 9.0, 2.0, 8


def smooth(s: FloatArray) -> FloatArray:
    """Return a smooth step from 0 to 1 over 0..1, at rest at both ends."""
    s = np.clip(s, 0.0, 1.0)
    return np.asarray(s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3))


def turned(time: FloatArray) -> FloatArray:
    """Return the angle about x, rad: `NUMBER` rests with a turn between each two."""
    begins = REST + (REST + TURN) * np.arange(NUMBER - 1)
    sizes = np.array([1.1, -2.0, 1.4, 0.9, -1.6, 2.1, -0.8])
    return np.asarray(
        sum(a * smooth((time - t) / TURN) for a, t in zip(sizes, begins, strict=True))
    )


def clock(rate: float = 100.0) -> FloatArray:
    return np.arange(round((NUMBER * REST + (NUMBER - 1) * TURN) * rate)) / rate


def record(
    time: FloatArray,
    *,
    acceleration: FloatArray | float = 0.0,
    tilt: FloatArray | float = 0.0,
    accel: FloatArray | float = 0.0,
    gyro: FloatArray | float = 0.0,
    seed: int = 0,
    unit: float = 1.0,
) -> Recording:
    """Return what a sensor reads that turns about x, is accelerated, and errs by `accel`, `gyro`.

    ``acceleration`` (n, 3) is along its x, which stays level, level across that, and up.
    """
    rng = np.random.default_rng(seed)
    interval = time[1] - time[0]
    angle = turned(time) + tilt
    force = np.zeros((len(time), 3)) + acceleration
    force[:, 2] += GRAVITY
    c, s = np.cos(angle), np.sin(angle)
    in_frame = np.column_stack(
        (force[:, 0], c * force[:, 1] + s * force[:, 2], c * force[:, 2] - s * force[:, 1])
    )
    rate = np.zeros_like(in_frame)
    rate[:, 0] = np.gradient(angle, interval)
    scale = np.sqrt(0.01 / interval)
    in_frame += accel + 0.02 * scale * rng.standard_normal(rate.shape)
    rate += gyro + 0.002 * scale * rng.standard_normal(rate.shape)
    rate += (0.01, -0.02, 0.005)
    return Recording(time, in_frame * unit, rate, "nominal")


def carried(time: FloatArray, begin: float, duration: float, to: tuple[float, ...]) -> FloatArray:
    """Return the acceleration (n, 3) of what is carried along `to`, m."""
    interval = time[1] - time[0]
    path = smooth((time - begin) / duration)
    return np.outer(np.gradient(np.gradient(path, interval), interval), to)


def there_and_back(time: FloatArray, begin: float, duration: float, up: float) -> FloatArray:
    """Return the acceleration (n, 3) of what is lifted by so much, m, and put back."""
    interval = time[1] - time[0]
    s = np.clip((time - begin) / duration, 0.0, 1.0)
    path = up * (4 * s * (1 - s)) ** 4
    return np.outer(np.gradient(np.gradient(path, interval), interval), (0.0, 0.0, 1.0))


def inside(made: Recording, begin: float, stop: float) -> float:
    """Return how many s from `begin` to `stop` are in rests that were found."""
    first, last = find_poses(made).interval.T
    return float(np.clip(np.minimum(last, stop) - np.maximum(first, begin), 0.0, None).sum())


def begin_of(rest: int) -> float:
    return rest * (REST + TURN)


@pytest.mark.parametrize("rate", [25.0, 100.0, 400.0])
@pytest.mark.parametrize(("size", "duration"), [(0.02, 1.0), (0.05, 0.7), (0.1, 2.0), (0.1, 3.0)])
def test_push_is_left_out_of_a_rest(rate: float, size: float, duration: float) -> None:
    time = clock(rate)
    begins = [begin_of(2) + 3.0, begin_of(5) + 4.0]
    acceleration = sum(carried(time, t, duration, (size, -0.5 * size, 0.0)) for t in begins)
    made = record(time, acceleration=acceleration)
    poses = find_poses(made)
    assert len(poses) == NUMBER + 2
    for begin in begins:
        assert inside(made, begin + 0.2 * duration, begin + 0.8 * duration) == 0.0
    assert inside(made, 0.0, time[-1]) > 0.8 * NUMBER * REST


@pytest.mark.parametrize(("height", "duration"), [(0.02, 1.0), (0.05, 2.0), (0.1, 3.0)])
def test_lift_is_left_out_of_a_rest(height: float, duration: float) -> None:
    time, begin = clock(), begin_of(3) + 3.0
    made = record(
        time, acceleration=there_and_back(time, begin, duration, height), unit=1 / GRAVITY
    )
    assert len(find_poses(made)) == NUMBER + 1
    assert inside(made, begin + 0.25 * duration, begin + 0.75 * duration) == 0.0


def test_push_that_turns_by_a_degree_is_left_out() -> None:
    time, begin = clock(), begin_of(4) + 3.5
    tilt = np.radians(0.9) * smooth((time - begin) / 1.5)
    made = record(time, acceleration=carried(time, begin, 1.5, (0.06, 0.06, 0.0)), tilt=tilt)
    assert len(find_poses(made)) == NUMBER + 1
    assert inside(made, begin + 0.3, begin + 1.2) == 0.0


def test_push_is_left_out_where_hands_sway() -> None:
    time, begin = clock(), begin_of(3) + 3.0
    acceleration = sway(time, 0.05, seed=1) + carried(time, begin, 1.2, (0.1, 0.0, 0.0))
    made = record(time, acceleration=acceleration)
    assert len(find_poses(made)) == NUMBER + 1
    assert inside(made, begin + 0.3, begin + 0.9) == 0.0


def sway(time: FloatArray, size: float, *, seed: int) -> FloatArray:
    """Return acceleration (n, 3) of a hand, m/s² rms: most is at a few Hz; it never stops."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(len(time), time[1] - time[0])
    shape = frequency / (1.0 + (frequency / 2.0) ** 3)
    noise = rng.standard_normal((len(frequency), 3)) + 1j * rng.standard_normal((len(frequency), 3))
    made = np.fft.irfft(noise * shape[:, None], len(time), axis=0)
    return np.asarray(size * made / made.std(axis=0))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", [0.03, 0.1, 0.2])
def test_hand_that_sways_keeps_its_rests(size: float, seed: int) -> None:
    time = clock()
    made = record(time, acceleration=sway(time, size, seed=seed), seed=seed)
    assert len(find_poses(made)) == NUMBER
    assert inside(made, 0.0, time[-1]) > 0.85 * NUMBER * REST


@pytest.mark.parametrize("seed", range(4))
def test_one_rest_in_a_hand_is_kept(seed: int) -> None:
    time = clock()
    held = (time >= begin_of(4) - 0.5 * TURN) & (time < begin_of(4) + REST + 0.5 * TURN)
    made = record(time, acceleration=sway(time, 0.1, seed=seed) * held[:, None], seed=seed)
    assert len(find_poses(made)) == NUMBER


def disturbances() -> dict[str, dict[str, FloatArray | float]]:
    time = clock()
    at = begin_of(3) + 4.5
    since = np.clip(time - at, 0.0, None)
    ring = np.where(time > at, np.exp(-since / 0.1) * np.sin(2 * np.pi * 18 * since), 0.0)
    fan = 0.5 * np.sin(2 * np.pi * 43.7 * time)
    axis = (0.3, 1.0, -0.5)
    return {
        "nothing": {},
        "a knock": {"acceleration": np.outer(1.5 * ring, axis)},
        "a fan": {"acceleration": np.outer(fan, axis)},
        "a fan that is switched on": {"acceleration": np.outer(fan * (time > at), axis)},
        "a step of the bias": {"accel": np.outer(0.08 * (time > at), axis)},
        "a bias for a while": {"accel": np.outer(0.08 * (abs(time - at) < 1.0), axis)},
        "a step of the gyroscope's bias": {"gyro": np.outer(0.004 * (time > at), axis)},
        "a table that is bumped": {"tilt": np.radians(0.4) * (time > at)},
        "a table that gives way": {"tilt": np.radians(0.2) * (1 - np.exp(-since))},
    }


@pytest.mark.parametrize("what", disturbances())
def test_what_is_no_push_stays_in_its_rest(what: str) -> None:
    made = record(clock(), **disturbances()[what])
    assert len(find_poses(made)) == NUMBER
    assert inside(made, begin_of(3) + 1.0, begin_of(4) - TURN - 1.0) == pytest.approx(REST - 2.0)
