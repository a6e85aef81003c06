"""A channel that is alone with a disturbance so large that it hides rests."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.samples.spectrum import LINE
from calib.mismatch.samples.unrest import find_unrest
from calib.model import SensorModel
from calib.recording import CHANNELS, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

from ..bench import GRAVITY
from ..bench import recording as simulated

RATE = 100.0


def values_of(recording: Recording) -> np.ndarray:
    return np.hstack((recording.accel, recording.gyro))


def humming(
    real: Recording, channel: str, *, frequency: float, noises: float, window: tuple[float, float]
) -> Recording:
    values, c = values_of(real), CHANNELS.index(channel)
    noise = np.std(np.diff(values[:100, c])) / np.sqrt(2.0)
    inside = (real.time >= window[0]) & (real.time < window[1])
    values[:, c] += inside * noises * noise * np.sin(2 * np.pi * frequency * real.time)
    return replace(real, accel=values[:, :3], gyro=values[:, 3:])


@pytest.mark.parametrize(
    ("channel", "frequency", "noises"),
    [
        ("accel.y", 1.5, 60.0),
        ("accel.x", 0.33, 300.0),
        ("gyro.z", 0.23, 300.0),
        ("gyro.y", 2.2, 60.0),
        ("gyro.x", 18.0, 40.0),
    ],
)
def test_what_hides_rests_is_said_with_its_channel_and_window(
    channel: str, frequency: float, noises: float
) -> None:
    window = (20.0, 60.0)
    real = humming(simulated(rate=RATE), channel, frequency=frequency, noises=noises, window=window)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert left.channels == (channel,)
    # Turns are between its ends and those of the rests that it hides.
    ((start, stop),) = left.intervals
    assert start > window[0] - 1.0
    assert stop < window[1] + 1.0
    assert stop - start > 0.6 * (window[1] - window[0])


def test_what_hums_all_along_is_to_be_mended_first() -> None:
    real = humming(simulated(rate=RATE), "gyro.z", frequency=20.0, noises=100.0, window=(0.0, 1e3))
    found = diagnose_recording(real, gravity=GRAVITY)
    assert found.verdict == "unexplained"
    assert not found.findings
    (left,) = found.unexplained
    assert left.channels == ("gyro.z",)
    assert left.follows.startswith(LINE)
    assert "a channel that is still at rest" in found.missing[-1]


@pytest.mark.parametrize("vibration", [0.0, 2.0])
@pytest.mark.parametrize("hold_tremor", [0.0, 0.3])
def test_benches_and_hands_that_shake_disturb_no_channel(
    vibration: float, hold_tremor: float
) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        motion = bench_protocol(rng, poses=20, vibration=vibration, hold_tremor=hold_tremor)
        real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=RATE)
        assert find_unrest(values_of(real), real.interval) == []


@pytest.mark.parametrize("amplitude", [0.05, 0.5])
def test_what_swings_about_the_vertical_on_each_face_is_no_disturbance(amplitude: float) -> None:
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 60.0, 0.01)
    face = (time // 10).astype(int)
    axis, sign = face % 3, np.where(face < 3, 1.0, -1.0)
    accel, gyro = np.zeros((2, len(time), 3))
    accel[np.arange(len(time)), axis] = sign * GRAVITY
    inside = (time % 10 > 2) & (time % 10 < 8)
    rate = inside * amplitude * np.sin(2 * np.pi * (time - 2.0) / 3.0)
    gyro[np.arange(len(time)), axis] = sign * rate
    accel += rng.normal(0, 0.01, accel.shape)
    gyro += rng.normal(0, 1e-3, gyro.shape)
    assert find_unrest(np.hstack((accel, gyro)), 0.01) == []


@pytest.mark.parametrize("seed", range(6))
def test_slow_turns_that_hardly_move_gravity_are_no_disturbance(seed: int) -> None:
    # A turn by 30 degrees a second or so, about an axis that is nearly vertical, begins and ends
    # while the accelerometer and the other gyroscopes are as quiet as at rest.
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 240.0, 1.0 / RATE)
    up, values = np.zeros((len(time), 3)), np.zeros((len(time), 6))
    axes = np.random.default_rng(100 + seed).integers(3, size=20)
    for k, axis in enumerate(axes):
        inside = slice(k * 1200, (k + 1) * 1200)
        since = time[inside] - time[inside.start]
        length = rng.uniform(5.0, 9.0)
        part = np.clip((since - 3.0) / length, 0.0, 1.0)
        angle = rng.uniform(1.0, 2.0) * rng.choice([-1.0, 1.0])
        turned = angle * (10 * part**3 - 15 * part**4 + 6 * part**5)
        tilt = rng.uniform(0.05, 0.4)
        across, beside = (axis + 1) % 3, (axis + 2) % 3
        up[inside, axis] = np.cos(tilt)
        up[inside, across] = np.sin(tilt) * np.cos(turned)
        up[inside, beside] = -np.sin(tilt) * np.sin(turned)
        values[inside, 3 + axis] = np.gradient(turned, time[inside])
    values[:, :3] = 9.80665 * up + rng.normal(size=up.shape) * 0.02
    values[:, 3:] += rng.normal(size=up.shape) * 7e-4 + [0.001, 0.02, -0.01]
    assert find_unrest(values, 1.0 / RATE) == []


def test_short_and_unclocked_recordings_have_none() -> None:
    real = simulated(rate=RATE)
    assert find_unrest(values_of(real)[:90], real.interval) == []
    assert find_unrest(values_of(real), 0.0) == []


def test_beside_a_dead_accelerometer_nobody_can_tell() -> None:
    real = humming(simulated(rate=RATE), "gyro.x", frequency=5.0, noises=60.0, window=(20.0, 60.0))
    assert find_unrest(values_of(replace(real, accel=0.0 * real.accel)), real.interval) == []
