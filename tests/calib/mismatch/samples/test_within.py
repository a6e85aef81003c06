"""Disturbances within rests: found on the channel that has them, where they are, and not elsewhere.

A hand, a bench that shakes and coarse counts are none, nor are few single samples off course.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.faults import values_of
from calib.mismatch import diagnose_recording
from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.hypotheses.places import joined
from calib.mismatch.samples.found import RESTLESS
from calib.mismatch.samples.within import (
    OFF_COURSE,
    PULSES,
    _off_course,
    look_beside,
    look_within,
)
from calib.model import SensorModel
from calib.recording import CHANNELS, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import GRAVITY
from ..bench import recording as simulated

SIGMA = np.array([CONSUMER.accel_noise_density, CONSUMER.gyro_noise_density]) * np.sqrt(25.0)
"""White noise of one sample at 50 Hz."""


def hum(time: FloatArray, rng: np.random.Generator) -> FloatArray:
    return (1 + np.sin(2 * np.pi * time / 3)) * np.sin(2 * np.pi * 13 * time)


def telegraph(time: FloatArray, rng: np.random.Generator) -> FloatArray:
    return 3.0 * (np.cumsum(rng.random(len(time)) < 0.05) % 2)


def louder(time: FloatArray, rng: np.random.Generator) -> FloatArray:
    return 1.5 * rng.normal(size=len(time))


def pulses(time: FloatArray, rng: np.random.Generator) -> FloatArray:
    near = np.abs(time[:, None] - rng.uniform(time[0], time[-1], 40)).min(axis=1)
    return 12.0 * (near < 0.06)


def disturbed(
    real: Recording, channels: list[int], make: Callable[..., FloatArray], seed: int
) -> tuple[Recording, tuple[float, float]]:
    """Return a recording with a disturbance in 30 % of it, in units of white noise."""
    rng = np.random.default_rng(seed)
    both = np.hstack((real.accel, real.gyro))
    start = rng.uniform(0.2, 0.5) * real.time[-1]
    inside = (real.time >= start) & (real.time < start + 0.3 * real.time[-1])
    extra = make(real.time[inside], rng)
    for c in channels:
        both[inside, c] += SIGMA[c // 3] * extra
    out = Recording(real.time, both[:, :3], both[:, 3:], "device", temperature=real.temperature)
    return out, (start, start + 0.3 * real.time[-1])


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    common = min(one[1], other[1]) - max(one[0], other[0])
    return max(common, 0.0) / (max(one[1], other[1]) - min(one[0], other[0]))


@pytest.mark.parametrize("make", [hum, telegraph, louder, pulses])
def test_what_one_channel_has_in_some_rests_is_placed(make: Callable[..., FloatArray]) -> None:
    real = simulated(seed=61, poses=24)
    for c in (1, 5):
        recording, where = disturbed(real, [c], make, 61 + c)
        (item,) = look_within(recording, find_poses(recording))
        assert item.channels == (CHANNELS[c],)
        assert overlap(item.intervals[0], where) > 0.5
        assert item.p_value <= 1e-4


def test_few_pulses_are_told_from_noise_and_a_knock_is_none() -> None:
    real = simulated(seed=67, poses=24)
    poses = find_poses(real)
    start, stop = poses.interval[8, 0], poses.interval[17, 1]
    both = np.hstack((real.accel, real.gyro))
    for k in range(8, 18):
        at = int(poses.start[k] + poses.stop[k]) // 2
        both[at : at + 6, 3] += 8.0 * SIGMA[1]
    recording = Recording(real.time, both[:, :3], both[:, 3:], "device")
    (item,) = look_within(recording, poses)
    assert item.follows == "the time: pulses there"
    assert item.channels == ("gyro.x",)
    assert overlap(item.intervals[0], (start, stop)) > 0.5
    for k in range(8, 18):
        at = int(poses.start[k] + poses.stop[k]) // 2
        both[at : at + 6, 1] += 8.0 * SIGMA[0]
    assert not look_within(Recording(real.time, both[:, :3], both[:, 3:], "device"), poses)


def heavy(seed: int, freedom: float) -> Recording:
    """Return a recording at 200 Hz with noise of Student's t."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=30, pose_duration=(5.0, 8.0))
    real = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=200.0)
    extra = 2.0 * rng.standard_t(freedom, (len(real), 6)) * np.repeat(SIGMA, 3)
    return replace(real, accel=real.accel + extra[:, :3], gyro=real.gyro + extra[:, 3:])


@pytest.mark.parametrize("freedom", [5.0, 6.0, 10.0])
def test_noise_with_heavy_tails_has_no_pulses(freedom: float) -> None:
    """Two samples that are large by chance are often side by side."""
    for seed in range(3):
        recording = heavy(seed, freedom)
        assert PULSES not in {u.follows for u in look_within(recording, find_poses(recording))}


def test_pulses_are_found_in_such_noise() -> None:
    recording = heavy(7, 6.0)
    poses = find_poses(recording)
    gyro = recording.gyro.copy()
    for k in range(8, 18):
        at = int(poses.start[k] + poses.stop[k]) // 2
        gyro[at : at + 8, 0] += 12.0 * SIGMA[1]
    (item,) = look_within(replace(recording, gyro=gyro), poses)
    assert (item.follows, item.channels) == (PULSES, ("gyro.x",))
    assert overlap(item.intervals[0], (poses.interval[8, 0], poses.interval[17, 1])) > 0.5


@pytest.mark.long
def test_a_disturbance_in_the_samples_alone_is_unexplained_and_has_no_name() -> None:
    recording, where = disturbed(simulated(seed=68, poses=18), [4], louder, 68)
    found = diagnose_recording(recording, gravity=GRAVITY)
    assert not found.findings
    (item,) = found.unexplained
    assert item.channels == ("gyro.y",)
    assert overlap(item.intervals[0], where) > 0.5


def test_what_several_channels_do_at_once_may_be_motion() -> None:
    real = simulated(seed=62, poses=24)
    for make in (louder, pulses):
        recording, _ = disturbed(real, [0, 1, 2], make, 62)
        assert not look_within(recording, find_poses(recording))


MOTIONS = {
    "a hand that trembles": {"tremor": 4.0},
    "a hand that holds": {"hold_tremor": 0.3},
    "a hand that sways": {"sway": 0.5, "swayed": 0.4},
    "a bench that shakes": {"vibration": 0.3, "vibrated": 0.4},
}


@pytest.mark.parametrize("what", MOTIONS)
def test_motion_is_no_disturbance(what: str) -> None:
    for seed in range(3):
        rng = np.random.default_rng([63, seed])
        motion = bench_protocol(rng, poses=20, pose_duration=(3.0, 4.0), **MOTIONS[what])
        recording = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=50.0)
        assert not look_within(recording, find_poses(recording))


@pytest.mark.parametrize("rate", [25.0, 100.0, 400.0])
def test_noise_that_drifts_and_settles_is_no_disturbance(rate: float) -> None:
    noise = replace(
        CONSUMER,
        accel_bias_instability=5 * CONSUMER.accel_bias_instability,
        gyro_bias_instability=5 * CONSUMER.gyro_bias_instability,
        accel_random_walk=5 * CONSUMER.accel_random_walk,
        gyro_random_walk=5 * CONSUMER.gyro_random_walk,
    )
    settling = Term("accel_settling", {"kx": 0.02, "ky": -0.03, "kz": 0.03, "tau": 1.0})
    rng = np.random.default_rng(int(rate))
    motion = bench_protocol(rng, poses=20, pose_duration=(3.0, 4.0))
    recording = simulate(motion, SensorModel(terms=(settling,)), noise, rng=rng, rate=rate)
    assert not look_within(recording, find_poses(recording))


def test_coarse_counts_are_no_disturbance() -> None:
    for seed in range(3):
        real = simulated(seed=65 + seed)
        for lsb in (0.3, 1.0, 1.3, 1.7, 1.9, 3.0):
            both = np.hstack((real.accel, real.gyro))
            step = lsb * np.repeat(SIGMA, 3)
            both = np.round(both / step) * step
            coarse = replace(real, accel=both[:, :3], gyro=both[:, 3:])
            assert not look_within(coarse, find_poses(coarse))


@pytest.mark.parametrize("lsb", [0.5, 1.5])
def test_noise_of_more_than_half_a_count_is_louder_where_it_is(lsb: float) -> None:
    recording, where = disturbed(simulated(seed=68, poses=24), [4], louder, 68)
    step = lsb * SIGMA[1]
    coarse = replace(recording, gyro=np.round(recording.gyro / step) * step)
    (item,) = look_within(coarse, find_poses(coarse))
    assert (item.follows, item.channels) == (RESTLESS, ("gyro.y",))
    assert overlap(item.intervals[0], where) > 0.5


@pytest.mark.parametrize(
    ("number", "size", "matter"), [(3, 2.0, False), (4, 0.3, False), (30, 2.0, True)]
)
def test_single_samples_off_course_anywhere_are_a_disturbance_if_they_matter(
    number: int, size: float, matter: bool
) -> None:
    for seed in range(3):
        real = simulated(seed=65 + seed)
        rng = np.random.default_rng(seed)
        accel = real.accel.copy()
        at = rng.choice(len(accel), number, replace=False)
        accel[at, 1] += rng.choice([-1.0, 1.0], number) * rng.uniform(0.5, 1.0, number) * size
        found = look_within(replace(real, accel=accel), find_poses(real))
        assert bool(found) is matter
        for item in found:
            assert (item.channels, item.follows) == (("accel.y",), OFF_COURSE)
            assert item.intervals == ((float(real.time[0]), float(real.time[-1])),)
            assert item.p_value < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_single_samples_off_course_by_twice_their_reach_are_one_in_a_part(seed: int) -> None:
    """Noise on either side hides no more than a few of them."""
    real = simulated(seed=70 + seed, poses=18)
    rng = np.random.default_rng(seed)
    begin, end = 0.25 * real.time[-1], 0.6 * real.time[-1]
    at = rng.choice(np.flatnonzero((real.time > begin) & (real.time < end)), 40, replace=False)
    accel = real.accel.copy()
    accel[at, 2] += 12.0 * rng.choice([-1.0, 1.0], len(at)) * SIGMA[0]
    (found,) = look_within(replace(real, accel=accel), find_poses(real))
    assert (found.channels, found.follows) == (("accel.z",), OFF_COURSE)
    assert overlap(found.intervals[0], (begin, end)) > 0.6


@pytest.mark.parametrize("elsewhere", [0, 6])
def test_single_samples_off_course_in_one_part_are_a_disturbance_there(elsewhere: int) -> None:
    real = simulated(seed=64, poses=18)
    rng = np.random.default_rng(elsewhere)
    begin, end = 0.3 * real.time[-1], 0.55 * real.time[-1]
    inside = np.flatnonzero((real.time > begin) & (real.time < end))
    at = np.append(rng.choice(inside, 30, replace=False), rng.choice(len(real), elsewhere))
    gyro = real.gyro.copy()
    gyro[at, 2] += rng.choice([-1.0, 1.0], len(at)) * rng.uniform(15, 30, len(at)) * SIGMA[1]
    spiky = replace(real, gyro=gyro)
    (found,) = look_within(spiky, find_poses(real))
    assert found.channels == ("gyro.z",)
    assert found.follows == OFF_COURSE
    assert overlap(found.intervals[0], (begin, end)) > 0.7


def test_rests_that_a_machine_shakes_have_no_samples_off_course() -> None:
    real = simulated(seed=64, poses=18)
    poses, rng = find_poses(real), np.random.default_rng(3)
    accel = real.accel.copy()
    for a, b in list(zip(poses.start, poses.stop, strict=True))[8:14]:
        accel[a:b] += SIGMA[0] * np.array([2.0, 6.0, 8.0]) * rng.normal(size=(b - a, 3))
    assert not look_within(replace(real, accel=accel), poses)


def test_a_hand_that_lets_go_late_makes_no_samples_off_course() -> None:
    """It trembles with five samples a swing in the first second of a rest."""
    real = simulated(seed=66, poses=18)
    poses, rng = find_poses(real), np.random.default_rng(4)
    gyro = real.gyro.copy()
    for a in poses.start[6:12]:
        at = slice(a, a + int(rng.uniform(0.5, 1.1) / real.interval))
        swing = 2 * np.pi * rng.uniform(10.0, 11.5) * real.time[at] + rng.uniform(0, 6)
        gyro[at, 1] += 60.0 * SIGMA[1] * np.sin(swing)
    assert not any(u.follows == OFF_COURSE for u in look_within(replace(real, gyro=gyro), poses))


def test_counts_that_flip_by_one_are_not_off_course_whatever_decimals_say_of_them() -> None:
    """Of a count and a half, a thousandth more is no more."""
    real = simulated(seed=67, poses=18)
    poses = find_poses(real)
    flips = np.zeros(len(real))
    flips[20::50], flips[21::50], flips[22::50] = 1.0, -1.0, -1.0
    values = values_of(real)
    values[:, 5] = np.round(0.00106526 * (flips + np.arange(len(flips)) // 50), 6)
    _, alone, _ = _off_course(values, poses)
    assert not alone[:, 5].any()


def test_a_rest_of_which_parts_were_left_out_has_no_jumps_there() -> None:
    real = simulated(seed=66)
    poses = find_poses(real)
    # Half a second is missing from each rest, over which a bias has moved.
    keep, bias = np.ones(len(real), bool), np.zeros(len(real))
    for k, (a, b) in enumerate(zip(poses.start, poses.stop, strict=True)):
        middle = (a + b) // 2
        keep[middle : middle + 25] = False
        bias[middle:] += (-1) ** k * 10 * SIGMA[1]
    gyro = real.gyro.copy()
    gyro[:, 0] += bias
    cut = Recording(real.time[keep], real.accel[keep], gyro[keep], "device")
    kept = np.concatenate(([0], np.cumsum(keep)))
    rests = replace(poses, start=kept[poses.start], stop=kept[poses.stop])
    assert not look_within(cut, rests)


def test_what_rows_and_samples_show_of_one_disturbance_is_one_item() -> None:
    slow = Unexplained(("gyro.x",), ((30.0, 60.0),), "fluctuation in a window", 1e-2)
    fast = Unexplained(("gyro.x",), ((40.0, 65.0),), "the time: it is restless there", 1e-9)
    trend = Unexplained(
        ("gyro.x",), ((0.0, 90.0),), "the time: the level of noise follows it", 1e-6
    )
    one, other = joined([slow, trend, fast])
    assert one == replace(fast, intervals=((30.0, 65.0),))
    assert other == trend


def test_counts_that_flip_in_one_part_are_not_off_course_there() -> None:
    real = simulated(seed=4, poses=24)
    count = 20 * SIGMA[0]
    noise = 0.15 * np.random.default_rng(4).standard_normal(len(real))
    half = real.time > 0.6 * real.time[-1]
    accel = real.accel.copy()
    accel[:, 0] = count * np.round(0.15 * half + noise + np.round(accel[:, 0] / count))
    assert look_within(replace(real, accel=accel), find_poses(real)) == ()
    accel[half & (np.arange(len(real)) % 61 == 0), 0] += 3 * count
    (found,) = look_within(replace(real, accel=accel), find_poses(real))
    assert found.channels == ("accel.x",)


def shorts(channels: list[int], seed: int) -> tuple[FloatArray, FloatArray]:
    """Return times and noise of one, with shorts of a tenth of a second from 20 to 40 s."""
    rng = np.random.default_rng(seed)
    time = 5.0 + 0.01 * np.arange(6000)
    left = rng.normal(size=(6000, 6))
    for moment in rng.uniform(20.0, 40.0, 12):
        left[np.ix_((time >= moment) & (time < moment + 0.1), channels)] += 4.0
    return time, left


@pytest.mark.parametrize("channel", [1, 5])
def test_pulses_beside_a_truth_are_found_on_their_channel_and_where_they_are(channel: int) -> None:
    time, left = shorts([channel], channel)
    (found,) = look_beside(time, left * SIGMA.repeat(3))
    assert found.channels == (CHANNELS[channel],)
    assert found.follows == "the time: pulses there"
    ((start, stop),) = found.intervals
    assert 17.0 < start < 24.0 < 36.0 < stop < 43.0


def test_a_stretch_that_is_restless_beside_a_truth_is_found_where_it_is() -> None:
    rng = np.random.default_rng(8)
    time, left = 0.01 * np.arange(6000), rng.normal(size=(6000, 6))
    inside = (time >= 15.0) & (time < 30.0)
    left[inside, 3] *= 1.6
    (found,) = look_beside(time, left)
    assert found.channels == ("gyro.x",)
    assert found.follows == "the time: it is restless there"
    assert found.intervals[0] == pytest.approx((15.0, 30.0), abs=2.0)
    # What shakes several channels may well be motion.
    left[inside, :3] *= 1.6
    assert look_beside(time, left) == ()


@pytest.mark.parametrize(("quiet", "loud"), [(0.58, 1.8), (0.76, 1.5)])
def test_a_stretch_that_is_restless_is_found_where_another_is_quieter(
    quiet: float, loud: float
) -> None:
    """By more standard errors than the one is louder: of how likely places are it is no part."""
    rng = np.random.default_rng(5)
    time, left = 0.01 * np.arange(20_000), rng.normal(size=(20_000, 6))
    left[(time >= 38.0) & (time < 88.0), 3] *= quiet
    left[(time >= 145.0) & (time < 157.0), 3] *= loud
    (found,) = look_beside(time, left)
    assert found.channels == ("gyro.x",)
    assert found.intervals[0] == pytest.approx((145.0, 157.0), abs=5.0)


@pytest.mark.parametrize("seed", range(5))
def test_noise_beside_a_truth_and_what_all_channels_show_are_no_pulses(seed: int) -> None:
    assert look_beside(*shorts([], seed)) == ()
    assert look_beside(*shorts([0, 1, 2, 3, 4, 5], seed)) == ()
    assert look_beside(*(part[:1] for part in shorts([], seed))) == ()


def test_a_channel_of_which_nothing_is_left_says_nothing_beside_a_truth() -> None:
    time, left = shorts([2], 3)
    left[:, 4] = 0.0
    (found,) = look_beside(time, left)
    assert found.channels == ("accel.z",)
    left[:, 2] = 0.0
    assert look_beside(time, left) == ()
    left[1000:1100, 2] = 1.0
    assert look_beside(time, left) == ()


def test_one_jolt_beside_an_exact_truth_is_said_with_all_channels_that_show_it() -> None:
    """A table that slipped by 1.5 degrees in one sample was "explained"."""
    time = np.arange(0.0, 60.0, 0.01)
    left = np.random.default_rng(2).normal(size=(len(time), 6))
    assert not look_beside(time, left, exact=True)
    left[3000, 3:] += [40.0, 70.0, -30.0]
    assert not look_beside(time, left)
    (found,) = look_beside(time, left, exact=True)
    assert found.follows == "the time: a jolt there"
    assert found.channels == ("gyro.x", "gyro.y", "gyro.z")
    ((start, stop),) = found.intervals
    assert start <= 30.0 <= stop < start + 2.0
    assert found.p_value < 1e-50


def test_corners_that_a_truth_does_not_follow_are_no_jolts() -> None:
    time = np.arange(0.0, 60.0, 0.01)
    left = np.random.default_rng(2).normal(size=(len(time), 6))
    left[500::600, 3] += 100.0
    assert all("jolt" not in u.follows for u in look_beside(time, left, exact=True))


@pytest.mark.parametrize("jump", [1e5, 1.7e9])
def test_a_clock_that_is_set_between_takes_no_memory_for_what_was_not_recorded(jump: float) -> None:
    # Nor do pulses after it fall on other channels than those before.
    real = simulated(seed=61, poses=24)
    after = np.arange(len(real)) > 0.5 * len(real)
    for recording in (real, disturbed(real, [4], pulses, 65)[0]):
        late = replace(recording, time=recording.time + jump * after)
        plain, far = (look_within(one, find_poses(one)) for one in (recording, late))
        assert [(u.follows, u.channels) for u in far] == [(u.follows, u.channels) for u in plain]


@pytest.mark.parametrize("fades", [True, False])
def test_what_rings_after_turns_about_one_axis_is_no_restless_output(fades: bool) -> None:
    real = simulated(seed=4, poses=20, rate=100.0)
    poses = find_poses(real)
    gyro, rng = real.gyro.copy(), np.random.default_rng(1)
    sigma = CONSUMER.gyro_noise_density * np.sqrt(50.0)
    for a, b in zip(poses.start[7:12], poses.stop[7:12], strict=True):
        since = real.time[a:b] - real.time[a]
        size = 12.0 * np.exp(-since / 0.25) if fades else 4.0
        tone = np.sin(2 * np.pi * 5.5 * since + rng.uniform(0, 6))
        gyro[a:b, 2] += sigma * size * tone
    found = look_within(replace(real, gyro=gyro), poses)
    assert [u.channels for u in found] == ([] if fades else [("gyro.z",)])
