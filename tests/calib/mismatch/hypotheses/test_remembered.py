"""What a residual may remember of what was before, that no catalogue has a name for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from calib.mismatch.hypotheses.remembered import (
    FORGETS,
    LOADED,
    PASSES,
    Stretches,
    after_turns,
    creeping,
    lag_of,
    lately,
    side_of,
)
from calib.recording import Recording
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import left_of, motion_of, problem, recording, with_added


def _last_turns(real: Recording, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the time since the last turn, and the largest rate in it, (n,); 0 in turns."""
    poses = find_poses(real)
    since, peak = np.full(len(real), np.inf), np.zeros(len(real))
    for k in range(1, len(poses)):
        rest = slice(int(poses.start[k]), int(poses.stop[k]))
        turn = rate[int(poses.stop[k - 1]) : int(poses.start[k])]
        since[rest] = real.time[rest] - real.time[rest.start]
        peak[rest] = turn[np.argmax(np.abs(turn))]
    return since, peak


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.long
def test_a_gyroscope_that_forgets_turns_slowly_has_no_asymmetry(signed: bool) -> None:
    real = recording(seed=8, poses=24)
    since, peak = _last_turns(real, motion_of(real).rate[:, 1])
    fading = 4e-4 * (peak if signed else np.abs(peak)) * np.exp(-since / 2.5)
    assert left_of(with_added(real, {"gyro.y": fading})) == [
        ("time since the last turn", ("gyro.y",))
    ]


def test_after_turns_nothing_is_left_before_the_first_and_while_it_turns() -> None:
    grid, made = problem()
    rows = made.rows()
    found = list(after_turns(rows, Stretches.of(rows), 4))
    assert len(found) == len(FORGETS) + len(PASSES)
    for _, values in found[: len(FORGETS)]:
        assert not values[grid.turning].any()
        assert not values[grid.pose == 0].any()
        rest = (grid.pose == 3) & ~grid.turning
        assert (np.diff(values[rest, 0]) < 0).all()
        np.testing.assert_allclose(np.abs(values[rest, 1]), values[rest, 2])


@pytest.mark.long
@pytest.mark.parametrize("creeps", [False, True])
def test_an_accelerometer_that_takes_a_load_slowly_remembers_it(creeps: bool) -> None:
    real = recording(seed=8, poses=24)
    since, _ = _last_turns(real, np.zeros(len(real)))
    own, memory = load(real, 0), 1.3
    error = np.exp(-since / memory) * own
    if creeps:
        step = real.interval / memory
        behind = own - lfilter([step], [1.0, step - 1.0], own, zi=[(1.0 - step) * own[0]])[0]
        error = np.asarray(behind)
    follows = "the pose before" if creeps else "time since the last turn"
    assert left_of(with_added(real, {"accel.x": 0.02 * error})) == [(follows, ("accel.x",))]


def test_a_load_is_forgotten_in_rests_and_there_is_none_before_the_first_turn() -> None:
    grid, made = problem()
    rows = made.rows()
    found = [values for _, values in creeping(rows, Stretches.of(rows), 1)]
    assert len(found) == 2 * len(FORGETS)
    up = rows.state.force[:, 1]
    for values in found:
        np.testing.assert_allclose(values[(grid.pose == 0) & ~grid.turning], 0.0, atol=1e-3)
        for pose in range(1, 6):
            rest = (grid.pose == pose) & ~grid.turning
            assert (np.diff(np.abs(values[rest, 0])) < 1e-6).all()
    for values in found[len(FORGETS) :]:
        assert not values[grid.turning].any()
        assert (np.sign(values[~grid.turning, 0]) * np.sign(up[~grid.turning]) >= 0).all()


def stuck(load: FloatArray, most: float) -> FloatArray:
    """Return how far something is behind its load that friction holds back, sample by sample."""
    lag = [0.0]
    for step in np.diff(load).tolist():
        lag.append(min(max(lag[-1] + step, -most), most))
    return np.array(lag)


def lain(load: FloatArray, least: float) -> FloatArray:
    """Return the side that what has play lies on, sample by sample."""
    side = [0.0]
    for value in load.tolist():
        side.append(float(np.sign(value)) if abs(value) > least else side[-1])
    return np.array(side[1:])


def load(real: Recording, axis: int) -> FloatArray:
    """Return what an axis is loaded by, in g."""
    return np.asarray(motion_of(real).gravity_direction[:, axis])


@pytest.mark.parametrize("seed", range(4))
def test_what_remembers_its_load_is_as_sample_by_sample(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way = np.clip(np.cumsum(0.1 * rng.normal(size=500)), -1.0, 1.0)
    way[100:150] = way[100]
    for size in (0.0, 0.1, 0.5):
        assert side_of(way, size) == pytest.approx(lain(way, size))
        assert lag_of(way, size) == pytest.approx(stuck(way, size), abs=1e-12)
    assert not lag_of(np.full(7, 0.3), 0.1).any()


@pytest.mark.long
@pytest.mark.parametrize(
    ("channel", "made"),
    [
        ("accel.x", lambda way: 0.02 * lain(way, 0.25)),
        ("accel.z", lambda way: 0.05 * stuck(way, 0.25)),
        ("gyro.y", lambda way: 4e-4 * lain(way, 0.15)),
    ],
)
def test_what_has_play_or_sticks_follows_its_load_before(
    channel: str, made: Callable[[FloatArray], FloatArray]
) -> None:
    real = recording(seed=8, poses=18)
    own = made(load(real, "xyz".index(channel[-1])))
    assert left_of(with_added(real, {channel: own})) == [(LOADED, (channel,))]


def late(real: Recording, signal: FloatArray, memory: float) -> FloatArray:
    """Return a signal (n,) through a low-pass of first order, sample by sample."""
    kept, out = float(np.exp(-real.interval / memory)), [float(signal[0])]
    for value in signal[1:].tolist():
        out.append(value + kept * (out[-1] - value))
    return np.array(out)


def test_what_is_known_of_late_is_a_low_pass_sample_by_sample() -> None:
    rows, memories = problem()[1].rows(), np.array([0.7, 5.0, 60.0])
    time, signal = rows.state.time, rows.state.gravity_direction
    known = [np.repeat(signal[None, 0], len(memories), axis=0)]
    for k in range(1, len(time)):
        kept = np.exp(-(time[k] - time[k - 1]) / memories)[:, None]
        known.append(signal[k] + kept * (known[-1] - signal[k]))
    found = lately(rows, signal, memories)
    assert found == pytest.approx(np.stack(known, axis=1), abs=1e-9)


def test_a_turn_belongs_by_halves_to_the_rests_beside_it() -> None:
    rows = problem()[1].rows()
    start, stop = rows.interval[rows.is_rest].T
    pose = Stretches.of(rows).pose
    for k in range(1, len(start)):
        inside = (rows.state.time > stop[k - 1]) & (rows.state.time < start[k])
        early = rows.state.time < 0.5 * (stop[k - 1] + start[k])
        assert inside.any()
        assert (pose[inside & early] == k - 1).all()
        assert (pose[inside & ~early] == k).all()


@pytest.mark.long
@pytest.mark.parametrize(
    ("channel", "made"),
    [
        ("gyro.z", lambda real, rate: -2e-3 * late(real, rate[:, 2], 30.0)),
        ("gyro.x", lambda real, rate: 2e-3 * late(real, np.linalg.norm(rate, axis=1), 20.0)),
        ("accel.y", lambda real, rate: 0.05 * late(real, np.linalg.norm(rate, axis=1), 8.0)),
    ],
)
def test_what_turns_leave_behind_follows_the_time_since_them(
    channel: str, made: Callable[[Recording, FloatArray], FloatArray]
) -> None:
    real = recording(seed=8, poses=24)
    left = made(real, motion_of(real).rate)
    assert left_of(with_added(real, {channel: left})) == [("time since the last turn", (channel,))]


@pytest.mark.long
@pytest.mark.parametrize(("channel", "size"), [("accel.x", 0.012), ("gyro.y", 5e-4)])
def test_what_goes_by_the_way_of_the_last_turn_follows_that(channel: str, size: float) -> None:
    real = recording(seed=8, poses=24)
    rate, poses = motion_of(real).rate[:, 2], find_poses(real)
    way, value = np.zeros(len(real)), 0.0
    for k in range(1, len(poses)):
        turn = slice(int(poses.stop[k - 1]), int(poses.start[k]))
        value = float(np.sign(rate[turn].sum()))
        way[(turn.start + turn.stop) // 2 :] = value
    assert left_of(with_added(real, {channel: size * way})) == [("the turn before", (channel,))]


@pytest.mark.long
@pytest.mark.parametrize(("channel", "size"), [("gyro.y", 3e-4), ("accel.z", 5e-3)])
def test_what_follows_a_temperature_late_follows_that(channel: str, size: float) -> None:
    real = recording(seed=8, poses=30)
    course = 25.0 + 4.0 * np.sin(2.0 * np.pi * real.time / 90.0) + 2.0 * np.cos(real.time / 37.0)
    warm = replace(real, temperature=course)
    own = size * late(real, course - course.mean(), 30.0)
    assert left_of(with_added(warm, {channel: own})) == [("temperature", (channel,))]


@pytest.mark.long
def test_what_is_warmer_in_one_place_than_in_another_follows_the_temperature() -> None:
    real = recording(seed=8, poses=30)
    course = 25.0 + 4.0 * np.sin(2.0 * np.pi * real.time / 90.0) + 2.0 * np.cos(real.time / 37.0)
    warm = replace(real, temperature=course)
    apart = course - late(real, course, 30.0)
    found = left_of(with_added(warm, {"gyro.x": 3e-4 * apart}))
    assert found == [("temperature", ("gyro.x",))]
