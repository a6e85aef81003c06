"""Turns are integrated while they are under way, and no longer."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.underway import KEPT, under_way
from calib.model import SensorModel
from calib.poses import Poses
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

BEGIN, END = 3.0, 4.5
"""s, of a turn between two rests."""

NOISE = np.array([0.02] * 3 + [2e-3] * 3)


def true_rate(time: FloatArray, power: int) -> FloatArray:
    """Return the rate of the turn, which grows and falls with a power of time, rad/s."""
    share = np.clip((time - BEGIN) / (END - BEGIN), 0.0, 1.0)
    return 2.0 * (4 * share * (1 - share)) ** power


def turned(rng: np.random.Generator, *, creep: float = 0.0, power: int = 2) -> Recording:
    """Return a turn between two rests, whose rate grows with a power of time; white noise.

    ``creep`` is a rate (rad/s) at which it turns for 0.4 s before.
    """
    time = 0.01 * np.arange(800)
    rate = true_rate(time, power) + creep * ((time > 2.6) & (time < BEGIN))
    signals = NOISE * rng.normal(size=(800, 6))
    signals[:, 2] += 9.8
    signals[:, 4] += rate
    return Recording(time, signals[:, :3], signals[:, 3:], "device")


def rests(recording: Recording, *, late: float = 0.4) -> Poses:
    """Return the rests, that end and begin by so many seconds too early and late."""
    whole = find_poses(recording)
    stop, start = (np.searchsorted(recording.time, t) for t in (BEGIN - late, END + late))
    return replace(
        whole.select(np.array([0, -1])),
        start=np.array([0, start]),
        stop=np.array([stop, len(recording)]),
    )


@pytest.mark.parametrize("power", [1, 2, 3])
def test_a_turn_is_integrated_from_where_it_began(power):
    lengths = []
    for seed in range(20):
        recording = turned(np.random.default_rng(seed), power=power)
        ((start, stop),) = under_way(recording, rests(recording))
        before, after = recording.time[start], recording.time[stop - 1]
        left_out = recording.gyro[:start, 1].mean(), recording.gyro[stop:, 1].mean()
        assert np.abs(left_out).max() < 5 * NOISE[4] / np.sqrt(250)
        lengths.append(after - before)
        # What is left out of the angle is less than noise adds to it.
        rate = true_rate(recording.time, power)
        outside = rate[:start].sum() + rate[stop:].sum()
        assert outside < 0.3 * NOISE[4] * np.sqrt(stop - start)
    # From rest to rest it was 2.3 s.
    assert np.median(lengths) < 1.5 + 2 * KEPT + 0.1


def test_what_creeps_before_a_turn_is_part_of_it():
    for seed in range(5):
        recording = turned(np.random.default_rng(seed), creep=2.5 * NOISE[4])
        ((start, _),) = under_way(recording, rests(recording))
        assert recording.time[start] <= 2.6 + 0.05


def test_where_samples_are_missing_nothing_is_left_out():
    recording = turned(np.random.default_rng(1))
    poses = rests(recording)
    time = recording.time.copy()
    time[poses.stop[0] + 5 :] += 0.1
    holed = replace(recording, time=time)
    np.testing.assert_array_equal(under_way(holed, poses), [[poses.stop[0], poses.start[1]]])
    # Where times mean nothing there are no gaps.
    unclocked = replace(holed, clock="invalid")
    assert under_way(unclocked, poses)[0, 0] > poses.stop[0]


def test_nothing_but_noise_between_two_rests_stays_whole():
    recording = turned(np.random.default_rng(2))
    still = replace(recording, gyro=recording.gyro * 0.0 + NOISE[3:])
    poses = rests(recording)
    np.testing.assert_array_equal(under_way(still, poses), [[poses.stop[0], poses.start[1]]])


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_turns_of_a_bench_are_shorter_and_whole(rate):
    rng = np.random.default_rng(4)
    motion = bench_protocol(rng, poses=20, power_on=0.0)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=rate)
    poses = find_poses(real)
    turns = under_way(real, poses)
    whole, short = make_grid(real, poses), make_grid(real, poses, turns=turns)
    assert (turns[:, 0] >= poses.stop[:-1]).all()
    assert (turns[:, 1] <= poses.start[1:]).all()
    before, after = (np.ptp(g.interval[~g.is_rest], axis=1) for g in (whole, short))
    assert (after <= before).all()
    assert np.median(after / before) < 0.85
    # The rests have what they lack, but for three samples at either end.
    assert (short.interval[1:, 0] - short.interval[:-1, 1] < 1.5 / rate).all()
    long, shorter = (np.ptp(g.interval[g.is_rest], axis=1) for g in (short, whole))
    assert (long >= shorter).all()
    assert 0.2 < np.median(long - shorter) < 0.7
    # What the sensor turns while no turn is under way is less than noise makes of a turn.
    true = motion.state(real.time).rate / rate
    inside = np.zeros(len(real), bool)
    for a, b in turns:
        inside[a:b] = True
    for k in range(len(turns)):
        between = slice(int(poses.stop[k]), int(poses.start[k + 1]))
        missed = np.linalg.norm(true[between][~inside[between]].sum(axis=0))
        assert missed < 0.3 * CONSUMER.gyro_noise_density * np.sqrt(after[k])
