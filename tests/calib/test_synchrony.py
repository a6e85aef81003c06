"""A gyroscope that is late, or early, against the accelerometer."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from calib import calibrate
from calib.errors import NoCommonMotionError
from calib.mismatch import diagnose_recording
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.library import MOTIONS, make_motion
from calib.simulation.noise import CONSUMER
from calib.synchrony import LEAST, _averaged, gyro_delay

GRAVITY = 9.80665


@cache
def recorded(name: str = "bench", seed: int = 41) -> Recording:
    rng = np.random.default_rng(seed)
    motion = make_motion(name, rng=rng, duration=120.0, gravity=GRAVITY)
    model = SensorModel(Triad(rng.normal(0, 0.2, 3)), Triad(rng.normal(0, 0.01, 3)))
    return simulate(motion, model, CONSUMER, rng=rng, rate=50.0)


def shifted(recording: Recording, delay: float) -> Recording:
    k, n = round(delay / recording.interval), len(recording)
    if k >= 0:
        return replace(recording.slice(k, n), gyro=recording.gyro[: n - k])
    return replace(recording.slice(0, n + k), gyro=recording.gyro[-k:])


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("seed", [42, 43])
def test_a_sensor_that_is_whole_is_not_late(name: str, seed: int) -> None:
    assert gyro_delay(recorded(name, seed)) is None


@pytest.mark.parametrize("delay", [0.3, -0.3, 1.0, -1.0, 6.0])
@pytest.mark.parametrize("seed", [44, 45])
def test_a_delay_is_found(delay: float, seed: int) -> None:
    found = gyro_delay(shifted(recorded(seed=seed), delay))
    assert found == pytest.approx(delay, abs=0.05)


def test_what_a_low_pass_may_be_is_left_to_the_rows() -> None:
    assert gyro_delay(shifted(recorded(), 0.6 * LEAST)) is None


def test_what_only_one_half_shows_is_no_delay() -> None:
    whole, late = recorded(), shifted(recorded(), 1.0)
    n = len(late)
    gyro = np.where(np.arange(n)[:, None] < n // 2, whole.gyro[:n], late.gyro)
    assert gyro_delay(replace(whole.slice(0, n), gyro=gyro)) is None


@pytest.mark.parametrize("delay", [1.0, -3.0])
def test_a_late_gyroscope_is_named_and_not_calibrated(delay: float) -> None:
    late = shifted(recorded(seed=46), delay)
    found = diagnose_recording(late, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["time_offset"]
    value = found.findings[0].parameters["gyro_delay"]
    assert value.sigma is not None
    assert value.value == pytest.approx(delay, abs=3 * value.sigma)
    assert "one clock" in found.missing[-1]
    said = "late" if delay > 0 else "early"
    with pytest.raises(NoCommonMotionError, match=rf"{abs(delay):.0f}\.\d\d s {said}|s {said}"):
        calibrate.calibrate(late, gravity=GRAVITY)


@pytest.mark.parametrize("width", [1, 2, 5, 8])
def test_neighbours_are_averaged_and_mirrored_at_the_ends(width):
    values = np.random.default_rng(2).normal(size=(40, 3))
    expected = uniform_filter1d(values, width, axis=0)
    np.testing.assert_allclose(_averaged(values, width), expected, atol=1e-14)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_who_walks_is_not_late(seed: int) -> None:
    """With every step the specific force changes its length and its direction; turns go along."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 90.0, 0.01)
    moves = np.clip((time - 4.0) / 2.0, 0.0, 1.0) * np.clip((86.0 - time) / 2.0, 0.0, 1.0)
    step = 2 * np.pi * 0.9 * time
    late = rng.uniform(0.0, 2 * np.pi, 3)
    rate = np.stack(
        (
            0.34 * np.cos(step + late[0]) + 0.25 * np.cos(3 * step),
            0.45 * np.cos(2 * step + late[1]) + 0.27 * np.cos(4 * step),
            0.51 * np.cos(step + late[2]) + 0.34 * np.cos(3 * step),
        ),
        axis=1,
    )
    force = np.stack(
        (
            0.5 * np.sin(step) + 0.2 * np.sin(3 * step),
            0.6 * np.sin(step + 1.0),
            2.5 * np.cos(2 * step) + 2.0 * np.cos(4 * step + 1.0) + 1.3 * np.cos(6 * step + 0.4),
        ),
        axis=1,
    )
    still = np.array([0.0, 2.0, GRAVITY])
    walker = Recording(time, still + moves[:, None] * force, moves[:, None] * rate, "device")
    assert gyro_delay(walker) is None
