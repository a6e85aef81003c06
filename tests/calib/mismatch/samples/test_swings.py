"""Lines that swing a few times in a rest."""

import numpy as np
import pytest

from calib.mismatch.samples import swings
from calib.mismatch.samples.resting import look_at_rests
from calib.mismatch.samples.swings import look_for_swings
from calib.model import SensorModel, Triad
from calib.poses import Poses, average_poses
from calib.recording import CHANNELS, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

RATE = 100.0
NOISE = np.array([0.04] * 3 + [2e-3] * 3)


def rests(
    seed: int, *, number: int = 24, length: tuple[float, float] = (4.5, 7.5), rate: float = RATE
) -> tuple[FloatArray, FloatArray, Poses]:
    """Return the time, white noise (n, 6), and rests with turns of 1.5 s between them."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum(np.stack((np.full(number, 1.5), rng.uniform(*length, number)), axis=1))
    start, stop = np.round(ends.reshape(number, 2) * rate).astype(np.int64).T
    time = np.arange(stop[-1]) / rate
    values = NOISE * rng.normal(size=(len(time), 6))
    values[:, 2] += 9.8
    return time, values, poses_of(time, values, start, stop)


def poses_of(time: FloatArray, values: FloatArray, start: FloatArray, stop: FloatArray) -> Poses:
    recording = Recording(time, values[:, :3], values[:, 3:], "device")
    return average_poses(recording, start, stop)


def look(time: FloatArray, values: FloatArray, poses: Poses) -> list[tuple[str, float, float]]:
    """Return the channel of each line, its frequency, and the share of the recording it is in."""
    recording = Recording(time, values[:, :3], values[:, 3:], "device")
    poses = average_poses(recording, poses.start, poses.stop)
    found = look_for_swings(recording, poses, ())
    return [
        (
            item.channels[0],
            float(item.follows.split(" at ")[1].split(" ")[0]),
            (item.intervals[0][1] - item.intervals[0][0]) / time[-1],
        )
        for item in found
    ]


@pytest.mark.parametrize("frequency", [0.25, 0.3, 0.45, 0.7, 1.0, 1.6, 2.4, 3.6])
@pytest.mark.parametrize("c", [1, 5])
def test_a_line_is_found_where_it_is(frequency: float, c: int) -> None:
    time, values, poses = rests(c)
    values[:, c] += 0.6 * NOISE[c] * np.sin(2 * np.pi * frequency * time + 1.0)
    ((channel, found, share),) = look(time, values, poses)
    assert channel == CHANNELS[c]
    assert found == pytest.approx(frequency, abs=1.5 / time[-1])
    assert share == 1.0


@pytest.mark.parametrize("rate", [20.0, 50.0, 400.0])
def test_at_any_rate(rate: float) -> None:
    """At 20 Hz rests have too few samples for a periodogram, and all lines are looked for here."""
    for frequency in (0.6, 1.5, *([] if rate > 40 else [7.0])):
        time, values, poses = rests(3, rate=rate)
        values[:, 3] += 1.2 * NOISE[3] * np.sin(2 * np.pi * frequency * time)
        ((channel, found, _),) = look(time, values, poses)
        assert (channel, found) == ("gyro.x", pytest.approx(frequency, abs=1.5 / time[-1]))


def test_a_faster_line_is_not_taken_for_a_slow_one() -> None:
    time, values, poses = rests(3, rate=50.0)
    values[:, 3] += 1.2 * NOISE[3] * np.sin(2 * np.pi * 2.1 * time)
    assert look(time, values, poses) == []


@pytest.mark.parametrize("frequency", [17.3, 23.4, 41.7])
@pytest.mark.parametrize(("c", "rate"), [(1, 100.0), (4, 250.0)])
def test_a_faint_line_is_found_where_it_is(frequency: float, c: int, rate: float) -> None:
    """A sixth of a sample's noise, of which a periodogram of a second shows nothing."""
    time, values, poses = rests(c, rate=rate)
    values[:, c] += 0.17 * NOISE[c] * np.sin(2 * np.pi * frequency * time + 1.0)
    ((channel, found, share),) = look(time, values, poses)
    assert (channel, share) == (CHANNELS[c], 1.0)
    assert found == pytest.approx(frequency, abs=1.5 / time[-1])


@pytest.mark.parametrize("seed", range(6))
def test_noise_has_no_faint_line(seed: int) -> None:
    assert look(*rests(100 + seed, number=30, rate=200.0)) == []


@pytest.mark.parametrize("seed", range(4))
def test_a_line_in_a_window_is_placed_there(seed: int) -> None:
    time, values, poses = rests(seed)
    inside = (time > 60.0) & (time < 120.0)
    values[:, 4] += inside * 1.5 * NOISE[4] * np.sin(2 * np.pi * 0.9 * time)
    recording = Recording(time, values[:, :3], values[:, 3:], "device")
    (item,) = look_for_swings(recording, poses, ())
    a, b = item.intervals[0]
    assert (min(b, 120.0) - max(a, 60.0)) / (max(b, 120.0) - min(a, 60.0)) > 0.7


@pytest.mark.parametrize("frequency", [0.4, 0.9, 2.2])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_faint_line_in_a_window_is_found_there(frequency: float, seed: int) -> None:
    """A quarter of a sample's noise: of the whole recording it would have an eighth."""
    time, values, poses = rests(seed, number=40)
    start, stop = 0.45 * time[-1], 0.7 * time[-1]
    inside = (time > start) & (time < stop)
    values[:, 4] += 0.25 * NOISE[4] * inside * np.sin(2 * np.pi * frequency * time)
    recording = Recording(time, values[:, :3], values[:, 3:], "device")
    (found,) = look_for_swings(recording, poses, ())
    assert found.channels == ("gyro.y",)
    ((first, last),) = found.intervals
    assert min(last, stop) - max(first, start) > 0.6 * (max(last, stop) - min(first, start))


def test_a_line_that_wanders_is_one() -> None:
    time, values, poses = rests(5)
    pace = 1.1 + 0.05 * np.sin(2 * np.pi * time / 70.0)
    values[:, 0] += 1.5 * NOISE[0] * np.sin(2 * np.pi * np.cumsum(pace) / RATE)
    ((channel, found, _),) = look(time, values, poses)
    assert (channel, found) == ("accel.x", pytest.approx(1.1, abs=0.06))


def test_a_line_of_several_channels_is_one() -> None:
    time, values, poses = rests(12)
    swing = np.sin(2 * np.pi * 0.7 * time)
    values[:, 4] += 1.0 * NOISE[4] * swing
    values[:, 5] -= 0.8 * NOISE[5] * swing
    values[:, 0] += 1.0 * NOISE[0] * np.sin(2 * np.pi * 1.9 * time)
    recording = Recording(time, values[:, :3], values[:, 3:], "device")
    found = look_for_swings(recording, poses, ())
    assert sorted(item.channels for item in found) == [("accel.x",), ("gyro.y", "gyro.z")]


def test_what_wanders_or_settles_is_no_line() -> None:
    """Flicker and walks, of all sizes; and a start that every rest of a robot has in common."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        length = (5.0, 5.0) if seed % 2 else (4.5, 7.5)
        time, values, poses = rests(100 + seed, length=length)
        n, size = len(time), NOISE * np.exp(rng.uniform(-3, 2, 6))
        frequency = np.fft.rfftfreq(n, 1 / RATE)[1:, None]
        shape = frequency ** -rng.uniform(0.5, 1.3, 6)
        phase = rng.normal(size=(2, *shape.shape))
        whole = np.zeros((n // 2 + 1, 6), complex)
        whole[1:] = (phase[0] + 1j * phase[1]) * shape
        wander = np.fft.irfft(whole, n, axis=0)
        values += size * wander / wander.std(axis=0)
        settles = rng.normal(size=6) * NOISE
        for a, b in zip(poses.start, poses.stop, strict=True):
            values[a:b] += settles * np.exp(-np.arange(b - a)[:, None] / RATE / 1.5)
        assert look(time, values, poses) == []


def test_chance_is_as_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of white noise no more than one recording in ten has a p-value of a tenth."""
    monkeypatch.setattr(swings, "CLAIM", 0.1)
    monkeypatch.setattr(swings, "SHARE", 0.0)
    monkeypatch.setattr(swings, "FAINTEST", 0.0)
    found = sum(len(look(*rests(1000 + seed))) > 0 for seed in range(60))
    assert found <= 12


@pytest.mark.parametrize("frequency", [0.35, 0.9])
def test_a_body_that_swings_is_no_line(frequency: float) -> None:
    """Hung up, or held by somebody who breathes: gravity turns by what the gyroscope says."""
    time, values, poses = rests(7)
    angle = 4e-3 / (2 * np.pi * frequency) * np.sin(2 * np.pi * frequency * time)
    values[:, 3] += np.gradient(angle, time)
    values[:, 1] += 9.8 * angle
    assert look(time, values, poses) == []
    # The same of the gyroscope alone is one.
    values[:, 1] -= 9.8 * angle
    assert [channel for channel, *_ in look(time, values, poses)] == ["gyro.x"]


def test_one_long_rest_tells_it_too() -> None:
    time, values, poses = rests(8, number=1, length=(300.0, 300.0))
    values[:, 2] += 0.5 * NOISE[2] * np.sin(2 * np.pi * 0.31 * time)
    ((channel, found, share),) = look(time, values, poses)
    assert (channel, found, share) == ("accel.z", pytest.approx(0.31, abs=0.005), 1.0)


def test_a_long_recording_has_the_mean_of_several_spectra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swings, "SECTION", 1000)
    time, values, poses = rests(9, number=40)
    values[:, 3] += 0.6 * NOISE[3] * np.sin(2 * np.pi * 0.8 * time)
    ((channel, found, _),) = look(time, values, poses)
    assert (channel, found) == ("gyro.x", pytest.approx(0.8, abs=0.02))


def test_few_rests_and_none_tell_nothing() -> None:
    time, values, poses = rests(10, number=7)
    values[:, 3] += NOISE[3] * np.sin(2 * np.pi * time)
    assert look(time, values, poses) == []
    assert look(time, values, poses.select(np.zeros(0, np.int64))) == []


def test_a_bench_is_clean_by_hand_too() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        model = SensorModel(Triad(rng.normal(0, 0.3, 3), rng.normal(0, 0.02, 3)))
        by_hand = float(seed % 2)
        motion = bench_protocol(rng, poses=20, hold_tremor=by_hand, sway=by_hand)
        recording = simulate(motion, model, CONSUMER, rng=rng, rate=RATE)
        assert look_for_swings(recording, find_poses(recording), ()) == []


def test_it_is_said_once() -> None:
    """Of a channel that has a line, or is restless, no more is said."""
    time, values, poses = rests(11)
    values[:, 3] += 2 * NOISE[3] * np.sin(2 * np.pi * 4.5 * time)
    recording = Recording(time, values[:, :3], values[:, 3:], "device")
    own = average_poses(recording, poses.start, poses.stop)
    assert len(look_at_rests(recording, own)) == 1


def test_a_bias_that_drifts_through_long_rests_is_no_line() -> None:
    """Cut into equal pieces it was a sawtooth, at one over their length."""
    time, values, poses = rests(3, number=12, length=(66.0, 75.0))
    values[:, 4] += 3.0 * NOISE[4] * np.sin(2 * np.pi * time / 1400.0)
    assert look(time, values, poses) == []
    values[:, 4] += 0.6 * NOISE[4] * np.sin(2 * np.pi * 0.2 * time)
    ((channel, frequency, _),) = look(time, values, poses)
    assert (channel, frequency) == ("gyro.y", pytest.approx(0.2, abs=0.005))
