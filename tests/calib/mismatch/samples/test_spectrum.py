"""Lines and bursts in the samples at rest."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.samples import spectrum
from calib.mismatch.samples.hand import trembling
from calib.mismatch.samples.power import CLAIM, LENGTH, above
from calib.mismatch.samples.spectrum import look_at_spectrum
from calib.model import SensorModel
from calib.poses import Poses
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

RATE = 100.0
SECONDS = 8.0
POSES = 20


def rests(seed: int, loud: FloatArray) -> tuple[Recording, Poses]:
    """Return rests with turns of 90 degrees between them; `loud` multiplies the noise of each."""
    rng = np.random.default_rng(seed)
    still, turn = int(SECONDS * RATE), int(RATE)
    n = POSES * still + (POSES - 1) * turn
    accel, gyro = np.zeros((n, 3)), np.zeros((n, 3))
    scale = np.ones(n)
    for k in range(POSES):
        a = k * (still + turn)
        accel[a : a + still, k % 3] = 9.8
        scale[a : a + still] = loud[k]
        if k + 1 < POSES:
            wave = np.sin(np.pi * np.arange(turn) / turn)[:, None]
            gyro[a + still : a + still + turn, (k + 2) % 3] = (np.pi**2 / 4 * wave)[:, 0]
            part = slice(a + still, a + still + turn)
            blend = np.linspace(0, np.pi / 2, turn)
            accel[part, k % 3] = 9.8 * np.cos(blend)
            accel[part, (k + 1) % 3] = 9.8 * np.sin(blend)
    accel += 0.015 * scale[:, None] * rng.normal(size=(n, 3))
    gyro += 1e-3 * rng.normal(size=(n, 3))
    recording = Recording(np.arange(n) / RATE, accel, gyro, "device")
    poses = find_poses(recording)
    assert len(poses) == POSES
    return recording, poses


def test_rests_that_are_shaken_at_several_levels_have_no_line() -> None:
    for seed in range(6):
        loud = np.random.default_rng(seed).permutation(
            np.repeat([1.0, 5.0, 10.0, 17.0], [9, 4, 2, 5])
        )
        for item in look_at_spectrum(*rests(seed, loud)):
            assert "one frequency" not in item.follows
            assert "line" not in item.follows


def test_a_rest_that_rounding_leaves_constant_hides_no_burst_in_another() -> None:
    loud = np.ones(POSES)
    loud[7] = 4.0
    recording, poses = rests(3, loud)
    accel = recording.accel.copy()
    accel[poses.start[2] : poses.stop[2], 0] = 0.0
    (burst,) = look_at_spectrum(replace(recording, accel=accel), poses)
    assert burst.follows == "the time: noise is louder there"
    assert burst.channels == ("accel.x", "accel.y", "accel.z")
    assert burst.intervals == (tuple(poses.interval[7]),)


def test_rests_far_apart_that_are_shaken_are_two_places() -> None:
    loud = np.ones(POSES)
    loud[[2, 15, 16]] = 4.0
    recording, poses = rests(3, loud)
    found = look_at_spectrum(recording, poses)
    assert [item.channels for item in found] == [("accel.x", "accel.y", "accel.z")] * 2
    assert [item.intervals for item in found] == [
        (tuple(poses.interval[2]),),
        ((poses.interval[15, 0], poses.interval[16, 1]),),
    ]


def test_a_line_in_some_rests_is_said_to_be_there() -> None:
    recording, poses = rests(7, np.ones(POSES))
    start, stop = poses.interval[8, 0], poses.interval[13, 1]
    inside = (recording.time >= start) & (recording.time <= stop)
    accel = np.array(recording.accel)
    accel[:, 1] += 0.02 * inside * np.sin(2 * np.pi * 21.0 * recording.time)
    found = look_at_spectrum(Recording(recording.time, accel, recording.gyro, "device"), poses)
    (line,) = found
    assert line.channels == ("accel.y",)
    assert abs(line.intervals[0][0] - start) < 1.0
    assert abs(line.intervals[0][1] - stop) < 1.0
    assert line.follows in ("a line at 21 Hz", "the time: power at one frequency there")


@pytest.mark.parametrize("frequency", [21.0, 25.0, 27.4, 49.3, 49.7])
def test_a_line_far_above_the_noise_is_at_its_frequency(frequency: float) -> None:
    """Where every p-value beside it is zero, too."""
    recording, poses = rests(7, np.ones(POSES))
    accel = np.array(recording.accel)
    accel[:, 2] += 0.3 * np.sin(2 * np.pi * frequency * recording.time)
    (line,) = look_at_spectrum(replace(recording, accel=accel), poses)
    assert line.p_value == 0.0
    assert float(line.follows.split()[3]) == pytest.approx(frequency, abs=0.15)


@pytest.mark.parametrize(("share", "seen"), [(0.35, True), (0.15, False)])
def test_a_line_of_a_third_of_the_noise_is_seen_and_one_that_matters_to_nobody_is_not(
    share: float, seen: bool
) -> None:
    recording, poses = rests(7, np.ones(POSES))
    accel = np.array(recording.accel)
    accel[:, 1] += share * 0.015 * np.sin(2 * np.pi * 34.2 * recording.time)
    found = look_at_spectrum(replace(recording, accel=accel), poses)
    assert [item.channels for item in found] == [("accel.y",)] * seen


def test_an_arm_that_swings_and_a_wrist_that_trembles_are_motion() -> None:
    """Each triad shows another, on several axes: there is no frequency that both have."""
    recording, poses = rests(7, np.ones(POSES))
    accel, gyro = np.array(recording.accel), np.array(recording.gyro)
    for c, phase in ((0, 0.0), (1, 1.0)):
        accel[:, c] += 0.015 * np.sin(2 * np.pi * 5.5 * recording.time + phase)
        gyro[:, c] += 1e-3 * np.sin(2 * np.pi * 9.5 * recording.time + phase)
    held = replace(recording, accel=accel, gyro=gyro)
    assert not any("line" in item.follows for item in look_at_spectrum(held, poses))
    # What one axis has alone is none.
    alone = replace(recording, accel=np.column_stack((accel[:, 0], recording.accel[:, 1:])))
    assert [item.channels for item in look_at_spectrum(alone, poses)] == [("accel.x",)]


def test_a_hand_that_trembles_less_the_faster_is_no_line() -> None:
    recording, poses = rests(3, np.ones(POSES))
    rng = np.random.default_rng(4)
    n = len(recording)
    f = np.fft.rfftfreq(n, 1 / RATE)
    gain = np.where((f > 0.5) & (f < 8.0), 1 / np.maximum(f, 0.5), 0.0)
    shake = np.fft.irfft(np.fft.rfft(rng.normal(size=n)) * gain, n)
    accel = np.array(recording.accel)
    accel[:, 0] += 0.02 * shake / shake.std()
    held = Recording(recording.time, accel, recording.gyro, "device")
    assert not any("line" in item.follows for item in look_at_spectrum(held, poses))


def test_a_tremor_that_both_triads_follow_is_motion_and_what_one_has_alone_is_not() -> None:
    recording, poses = rests(5, np.ones(POSES))
    angle = 1e-3 * np.sin(2 * np.pi * 7.8 * recording.time)
    gyro, accel = np.array(recording.gyro), np.array(recording.accel)
    gyro[:, 0] += np.gradient(angle, recording.time)
    alone = Recording(recording.time, accel, gyro, "device")
    assert any("line" in item.follows for item in look_at_spectrum(alone, poses))
    # Turned by that angle about x, gravity swings in y and z.
    accel[:, 1] += accel[:, 2] * angle
    accel[:, 2] -= recording.accel[:, 1] * angle
    held = Recording(recording.time, accel, gyro, "device")
    assert not look_at_spectrum(held, poses)


def test_a_hand_that_sways_and_shakes_is_no_line_and_a_tone_beside_its_sway_is() -> None:
    recording, poses = rests(9, np.ones(POSES))
    rng = np.random.default_rng(6)
    n = len(recording)
    f = np.fft.rfftfreq(n, 1 / RATE)
    band = (f > 0.5) & (f < 8.0)
    rate = np.fft.irfft(np.fft.rfft(rng.normal(size=(n, 3)), axis=0) * band[:, None], n, axis=0)
    force = np.fft.irfft(
        np.fft.rfft(rng.normal(size=(n, 3)), axis=0) * (f**2 * band)[:, None], n, axis=0
    )
    gyro = recording.gyro + 0.01 * rate / rate.std()
    tone = 0.05 * np.sin(2 * np.pi * 5.5 * recording.time)
    for shake, lines in ((0.1 * force / force.std(), False), (tone[:, None], True)):
        held = Recording(recording.time, recording.accel + shake, gyro, "device")
        found = look_at_spectrum(held, poses)
        assert any("line" in item.follows for item in found) is lines


@pytest.mark.parametrize(("tone", "lines"), [(0.0, False), (0.15, True)])
def test_a_tremor_that_falls_off_above_what_hands_do_is_no_line(tone: float, lines: bool) -> None:
    """A tone on its slope is one."""
    recording, poses = rests(9, np.ones(POSES))
    rng = np.random.default_rng(8)
    n = len(recording)
    s = np.fft.rfftfreq(n, 1 / RATE) / 12.5
    gain = np.square(s / (1 - s**2 + 0.2j * s) / (1 + s**2))[:, None]
    noise = np.fft.irfft(np.fft.rfft(rng.normal(size=(n, 6)), axis=0) * gain, n, axis=0)
    noise /= noise.std()
    accel = recording.accel + 0.3 * noise[:, :3]
    accel[:, 2] += tone * np.sin(2 * np.pi * 22.0 * recording.time)
    held = Recording(recording.time, accel, recording.gyro + 0.02 * noise[:, 3:], "device")
    found = look_at_spectrum(held, poses)
    assert [item.channels for item in found if "line" in item.follows] == [("accel.z",)] * lines


@pytest.mark.parametrize("seed", [12, 13])
def test_a_hand_trembles_at_other_frequencies_about_each_axis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=30, hold_tremor=0.1)
    held = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=RATE)
    found = look_at_spectrum(held, find_poses(held))
    assert not any("line" in item.follows for item in found)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_tremor_so_wide_that_nothing_in_it_stands_out_is_held(seed: int) -> None:
    """A hump of forces falls off as slowly as an arm does, and its own floor scatters by that."""
    rng = np.random.default_rng(seed)
    interval, bins = 1.0 / 200.0, LENGTH // 2 - 2
    f = (np.arange(bins) + 2) / (LENGTH * interval)
    accel = 12.0 / np.square(1.0 + np.square((f - 10.0) / 9.0)) + 1e-3
    gyro = 0.16 / (1.0 + np.square((f - 8.0) / 2.5)) ** 2 + 1e-3
    mean = np.repeat(np.stack((accel, gyro)), 3, axis=0).T
    power = mean[:, None] * rng.exponential(size=(bins, 120, 6))
    assert above(power[:, :, 3])[2].min() < CLAIM
    assert trembling(power, interval, 9.8)[3:6].all()
    # The same of the gyroscope alone is no motion.
    power[:, :, :3] = 1e-3 * rng.exponential(size=(bins, 120, 3))
    assert not trembling(power, interval, 9.8).any()


def test_rests_of_one_periodogram_have_no_line_by_chance() -> None:
    """Their floor is seen by that alone, and its median is below its mean."""
    rng = np.random.default_rng(11)
    count = np.array([1] * 8 + [5] * 12)
    rest = np.repeat(np.arange(20), count)
    window = np.hanning(spectrum.LENGTH)[:, None]
    least = []
    for _ in range(200):
        noise = window * rng.normal(size=(spectrum.LENGTH, len(rest)))
        power = np.square(np.abs(np.fft.rfft(noise, axis=0)))[2:-1]
        mean = np.stack([power[:, rest == k].mean(axis=1) for k in range(20)], axis=1)
        floor, p = spectrum._peaks(mean, count)
        least.append(p.min() / 6)  # of six channels
    # The floor is that of the noise: squares of the window, in every bin.
    np.testing.assert_allclose(floor.mean(), np.square(window).sum(), rtol=0.1)
    assert np.mean(np.array(least) < 0.1) < 0.1


def test_a_knock_at_the_bench_is_no_burst_and_no_line() -> None:
    recording, poses = rests(5, np.ones(POSES))
    rng = np.random.default_rng(6)
    accel, gyro = recording.accel.copy(), recording.gyro.copy()
    for k in (4, 11):
        at = int(rng.integers(poses.start[k] + 100, poses.stop[k] - 100))
        since = np.arange(80) / RATE
        ring = np.exp(-since / 0.1) * np.sin(2 * np.pi * 22.0 * since)
        accel[at : at + 80] += 2.0 * ring[:, None] * rng.normal(size=3)
        gyro[at : at + 80] += 0.1 * ring[:, None] * rng.normal(size=3)
    shaken = replace(recording, accel=accel, gyro=gyro)
    assert look_at_spectrum(shaken, poses) == ()
    # On one channel it may be a disturbance, and a rest that is loud throughout is one.
    alone = np.column_stack((accel[:, 0], recording.accel[:, 1:]))
    assert look_at_spectrum(replace(recording, accel=alone), poses)
    loud = np.ones(POSES)
    loud[4] = 4.0
    assert look_at_spectrum(*rests(5, loud))


def test_coarse_counts_are_not_louder_where_a_signal_is_between_two() -> None:
    real, poses = rests(5, np.ones(POSES))
    noise = np.random.default_rng(5).standard_normal((len(real), 3))
    gyro = np.zeros((len(real), 3))
    for k, (a, b) in enumerate(zip(poses.start, poses.stop, strict=True)):
        gyro[a:b] = 0.49 if k == 4 else 0.1 * (k % 3)
    counted = replace(real, gyro=2e-3 * np.round(gyro + 0.2 * noise))
    assert not [u for u in look_at_spectrum(counted, poses) if "gyro.x" in u.channels]
    a, b = int(poses.start[7]), int(poses.stop[7])
    gyro[a:b] += 3 * noise[a:b]
    shaken = replace(real, gyro=2e-3 * np.round(gyro + 0.2 * noise))
    (found,) = [u for u in look_at_spectrum(shaken, poses) if "gyro.x" in u.channels]
    assert found.intervals[0][0] < real.time[b]
    assert found.intervals[0][1] > real.time[a]


def test_noise_that_goes_with_the_pose_is_said_and_rests_that_differ_by_chance_are_not() -> None:
    recording, poses = rests(5, np.ones(POSES))
    rng = np.random.default_rng(1)
    gyro, random = recording.gyro.copy(), recording.gyro.copy()
    for a, b, accel in zip(poses.start, poses.stop, poses.accel, strict=True):
        gyro[a:b, 2] *= 1.0 + 1.2 * abs(accel[1]) / 9.8
        random[a:b, 2] *= rng.uniform(1.0, 2.2)
    (found,) = look_at_spectrum(replace(recording, gyro=gyro), poses)
    assert found.channels == ("gyro.z",)
    assert found.follows == "gravity along y, either way: the level of noise follows it"
    assert look_at_spectrum(replace(recording, gyro=random), poses) == ()


@pytest.mark.parametrize("fades", [True, False])
def test_what_rings_after_a_turn_is_no_power_at_one_frequency(fades: bool) -> None:
    real, poses = rests(3, np.ones(POSES))
    gyro = real.gyro.copy()
    sigma = np.std(np.diff(gyro[poses.start[0] : poses.stop[0], 1])) / np.sqrt(2.0)
    for a, b in zip(poses.start[5:7], poses.stop[5:7], strict=True):
        since = real.time[a:b] - real.time[a]
        size = 40.0 * np.exp(-since / 0.25) if fades else 1.5
        gyro[a:b, 1] += sigma * size * np.sin(2 * np.pi * 6.25 * since)
    found = look_at_spectrum(replace(real, gyro=gyro), poses)
    assert [u.channels for u in found] == ([] if fades else [("gyro.y",)])


def many_rests(
    seed: int, *, brief: bool = False, count: float = 0.0, flicker: float = 0.0
) -> tuple[Recording, Poses]:
    """Return rests of a few periodograms each, at any rate; `count` and `flicker` in noises."""
    rng = np.random.default_rng(seed)
    rate, number = float(rng.choice([50.0, 80.0, 125.0, 200.0, 400.0])), int(rng.integers(30, 45))
    seconds = rng.uniform(2.0, 3.5, number) if brief else rng.uniform(4.0, 7.0, number)
    length = np.round(seconds * max(rate, 100.0)).astype(np.int64)
    stop = np.cumsum(length + 100) - 100
    start, n = stop - length, int(stop[-1])
    f = np.maximum(np.fft.rfftfreq(n), 1.0 / n)[:, None]
    wander = np.fft.irfft(np.fft.rfft(rng.normal(size=(n, 6)), axis=0) / np.sqrt(f), n, axis=0)
    up = rng.normal(size=(number, 3))
    up *= 9.8 / np.linalg.norm(up, axis=1, keepdims=True)
    scale = np.repeat([0.015, 1e-3], 3)
    values = scale * (rng.normal(size=(n, 6)) + flicker * wander)
    for k, (a, b) in enumerate(zip(start, stop, strict=True)):
        values[a:b, :3] += up[k]
    if count:
        values = count * scale * np.round(values / (count * scale))
    time = np.arange(n) / rate
    recording = Recording(time, values[:, :3], values[:, 3:], "device")
    interval = np.stack((time[start], time[stop - 1]), axis=1)
    mean = np.stack([values[a:b].mean(axis=0) for a, b in zip(start, stop, strict=True)])
    chance = np.tile(1e-6 * np.eye(3), (number, 1, 1))
    return recording, Poses(start, stop, interval, mean[:, :3], mean[:, 3:], chance, chance)


@pytest.mark.parametrize("brief", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_a_line_in_a_window_is_judged_by_the_noise_of_that(seed: int, brief: bool) -> None:
    """Of all rests' noise it has less than a line that is said."""
    recording, poses = many_rests(seed, brief=brief)
    rng = np.random.default_rng(seed + 100)
    frequency = rng.uniform(0.18, 0.45) / recording.interval
    start, stop = poses.interval[4, 0], poses.interval[8 if brief else 7, 1]
    inside = (recording.time >= start) & (recording.time <= stop)
    accel = np.array(recording.accel)
    accel[:, 1] += 0.015 * 0.6 * inside * np.sin(2 * np.pi * frequency * recording.time)
    (line,) = look_at_spectrum(replace(recording, accel=accel), poses)
    assert line.channels == ("accel.y",)
    assert line.follows.startswith("a line at ")
    apart = 1.0 / (LENGTH * recording.interval)
    assert float(line.follows.split()[3]) == pytest.approx(frequency, abs=apart)
    (a, b), *_ = line.intervals
    rest = float(np.ptp(poses.interval, axis=1).max()) + 100 * recording.interval
    assert abs(a - start) < 1.5 * rest
    assert abs(b - stop) < 1.5 * rest


def test_a_line_that_one_rest_of_a_window_has_is_none_in_a_window() -> None:
    recording, poses = many_rests(0)
    accel = np.array(recording.accel)
    here = slice(poses.start[8], poses.stop[8])
    tone = np.sin(2 * np.pi * 0.3 * np.arange(poses.stop[8] - poses.start[8]))
    accel[here, 1] += 0.015 * 0.6 * tone
    assert look_at_spectrum(replace(recording, accel=accel), poses) == ()


def test_a_line_that_hands_have_in_a_window_is_motion() -> None:
    recording, poses = many_rests(6)
    start, stop = poses.interval[4, 0], poses.interval[7, 1]
    inside = (recording.time >= start) & (recording.time <= stop)
    wave = inside * np.sin(2 * np.pi * 9.0 * recording.time)
    accel, gyro = np.array(recording.accel), np.array(recording.gyro)
    gyro[:, 0] += 5e-4 * wave
    shaken = replace(recording, gyro=gyro)
    assert any("line" in item.follows for item in look_at_spectrum(shaken, poses))
    accel[:, 1] += 0.0075 * wave
    assert look_at_spectrum(replace(shaken, accel=accel), poses) == ()


@pytest.mark.parametrize("brief", [True, False])
@pytest.mark.parametrize(("count", "flicker"), [(0.0, 0.0), (1.0, 0.0), (0.0, 0.1), (0.5, 0.1)])
def test_noise_has_no_line_in_any_window(count: float, flicker: float, brief: bool) -> None:
    for seed in range(15):
        assert look_at_spectrum(*many_rests(seed, brief=brief, count=count, flicker=flicker)) == ()


@pytest.mark.parametrize("louder", [1.0, 500.0])
def test_where_one_rest_is_all_of_the_mean_it_tells_no_more_than_one(louder: float) -> None:
    """A shaken one was said to have a line, by a p-value as of all of the rests."""
    rng = np.random.default_rng(12)
    least = []
    for _ in range(400):
        power = rng.exponential(size=(LENGTH // 2 - 2, 40))
        power[:, 7] *= louder**2
        least.append(above(power)[2].min() / 6)  # of six channels
    assert np.mean(np.array(least) < 0.01) < 0.02
    # A line that is in all of them is found, be it the one that shakes or not.
    power[20] *= 20.0
    assert int(np.argmin(above(power)[2])) == 20
