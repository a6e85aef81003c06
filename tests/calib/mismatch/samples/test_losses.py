"""Samples lost in a turn, with a clock that counts samples."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.rows.closure import Spans, follow_turns, integrate_turns
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.samples.losses import (
    INCOMPLETE,
    MOST,
    PART,
    Loss,
    _Closures,
    _mended,
    _put_back,
    find_losses,
    leave_out_unwhole,
)
from calib.mismatch.twin.selfmode import SelfProblem
from calib.recording import Recording
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import GRAVITY, recording


def without(whole: Recording, at: int, count: int) -> Recording:
    keep = np.delete(np.arange(len(whole)), slice(at, at + count))
    assert whole.temperature is not None
    return Recording(
        whole.time[: len(keep)],
        whole.accel[keep],
        whole.gyro[keep],
        "device",
        temperature=whole.temperature[keep],
    )


def smoothed(values: FloatArray) -> FloatArray:
    """Return signals without what a hand does in less than a tenth of a second."""
    kernel = np.hanning(41)[1:-1] / np.hanning(41).sum()
    held = np.pad(values, ((19, 19), (0, 0)), mode="edge")
    return np.stack([np.convolve(own, kernel, mode="valid") for own in held.T], axis=1)


def problem_of(made: Recording) -> SelfProblem:
    return SelfProblem(make_grid(made, find_poses(made)), None, gravity=GRAVITY, full_gyro=False)


def test_where_and_how_many_are_found_to_the_sample() -> None:
    whole = recording(rate=100.0)
    poses = find_poses(whole)
    for turn, share, count in ((3, 0.4, 1), (7, 0.5, 2), (4, 0.4, 2)):
        a, b = int(poses.stop[turn]), int(poses.start[turn + 1])
        at = a + int(share * (b - a))
        (loss,) = find_losses(problem_of(without(whole, at, count)))
        assert loss.number == count
        assert abs(loss.moment - whole.time[at]) < 0.5 * whole.interval
        assert loss.after < 0.05 * loss.before


@pytest.mark.parametrize("count", [6, 8, 12, 20, MOST])
def test_a_packet_that_is_lost_is_counted(count: int) -> None:
    """In motion that is smooth, which is foretold through so many samples."""
    whole = recording(rate=200.0, seed=5)
    smooth = replace(whole, accel=smoothed(whole.accel), gyro=smoothed(whole.gyro))
    poses = find_poses(smooth)
    at = int(poses.stop[6] + poses.start[7]) // 2
    (loss,) = find_losses(problem_of(without(smooth, at, count)))
    assert abs(loss.number - count) <= 3.0 * loss.spread[1]
    assert loss.spread[1] < 1.0
    assert abs(loss.moment - whole.time[at]) < 1.5 * whole.interval


@pytest.mark.long
@pytest.mark.parametrize("count", [8, 20])
def test_a_packet_that_is_lost_leaves_nothing_else(count: int) -> None:
    whole = recording(rate=200.0, poses=20, seed=5)
    whole = replace(whole, accel=smoothed(whole.accel), gyro=smoothed(whole.gyro))
    poses = find_poses(whole)
    at = int(poses.stop[6] + poses.start[7]) // 2
    found = diagnose_recording(without(whole, at, count), gravity=GRAVITY)
    assert {item.effect for item in found.findings} == {"dropped_samples", "bandwidth"}
    (lost,) = (item for item in found.findings if item.effect == "dropped_samples")
    number = lost.parameters["count"]
    assert abs(number.value - count) <= 3.0 * (number.sigma or 0.0)
    ((start, stop),) = lost.intervals
    assert start < whole.time[at] < stop < start + 5.0
    assert not found.unexplained


def test_a_sample_lost_in_each_of_five_turns_is_found_in_all() -> None:
    made = recording(rate=100.0, poses=24)
    poses = find_poses(made)
    turns = [int(a + b) // 2 for a, b in zip(poses.stop[:-1], poses.start[1:], strict=True)]
    for at in sorted(turns[2:12:2], reverse=True):
        made = without(made, at, 1)
    assert [loss.number for loss in find_losses(problem_of(made))] == [1] * 5


@pytest.mark.parametrize("seed", [4, 6])
def test_a_long_turn_misses_its_closure_by_as_much_more_as_it_is_longer(seed: int) -> None:
    whole = recording(rate=100.0, seed=seed)
    poses = find_poses(whole)
    known = np.ones(len(poses), bool)
    known[6:11] = False  # a turn of 27 s, where others take one or two
    grid = make_grid(whole, poses.select(known))
    problem = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)
    turns = np.flatnonzero(~grid.is_rest)
    scores = _Closures(grid, problem.twin, turns, problem.noise).scores
    assert scores[np.argmax(np.ptp(grid.interval[turns], axis=1))] < 4.0


@pytest.mark.parametrize(("seed", "pose"), [(5, 3), (6, 5), (7, 3)])
def test_one_sample_that_is_wrong_is_no_loss(seed: int, pose: int) -> None:
    whole = recording(rate=100.0, seed=seed)
    gyro = whole.gyro.copy()
    gyro[find_poses(whole).start[pose] - 8] += [1.2, -1.4, 0.8]
    assert not find_losses(problem_of(replace(whole, gyro=gyro)))


@pytest.mark.parametrize("seed", [5, 7])
def test_a_turn_that_ends_with_a_knock_is_no_loss(seed: int) -> None:
    """What a sample misses of a knock, samples put back beside it would undo."""
    rng = np.random.default_rng(seed)
    whole = recording(rate=50.0, seed=seed)
    accel, poses = whole.accel.copy(), find_poses(whole)
    for end in poses.start[1::3] - 2:
        knock = rng.normal(size=3)
        accel[end] += 20.0 * knock / np.linalg.norm(knock)
    knocked = problem_of(replace(whole, accel=accel))
    grid = knocked.grid
    scores = _Closures(grid, knocked.twin, np.flatnonzero(~grid.is_rest), knocked.noise).scores
    assert scores.max() < 6.0
    assert not find_losses(knocked)


@pytest.mark.long
def test_where_and_how_many_are_found_among_the_jolts_of_a_hand() -> None:
    found = 0
    for seed in range(2, 8):
        rng = np.random.default_rng(seed)
        whole = recording(poses=18, rate=100.0, seed=seed)
        poses = find_poses(whole)
        moving = np.linalg.norm(whole.gyro, axis=1) > 0.3
        jolts = 0.05 * (moving & (rng.random(len(whole)) < 0.2))[:, None]
        shaken = replace(
            whole,
            gyro=whole.gyro + jolts * rng.normal(size=(len(whole), 3)),
            accel=whole.accel + 5.0 * jolts * rng.normal(size=(len(whole), 3)),
        )
        at = int(poses.stop[5] + poses.start[6]) // 2
        for loss in find_losses(problem_of(without(shaken, at, 2))):
            found += 1
            assert abs(loss.number - 2) <= 3.0 * loss.spread[1]
            late = np.hypot(whole.interval, loss.spread[0])
            assert abs(loss.moment - whole.time[at]) < 3.0 * late
    # A third of them at least: a turn in which a jolt hides it says nothing.
    assert found >= 2


def test_a_loss_stands_out_of_a_misaligned_gyroscope() -> None:
    """Of a few samples in a turn that is no brisker than others."""
    term = Term("gyro_misalignment", {"mxy": 8e-3, "myz": -7e-3, "mzx": 6e-3, "mzy": 7e-3})
    whole = recording(term, rate=100.0)
    poses = find_poses(whole)
    speed = np.linalg.norm(whole.gyro, axis=1)
    turns = [(int(a), int(b)) for a, b in zip(poses.stop[:-1], poses.start[1:], strict=True)]
    turn = int(np.argsort([speed[a:b].max() for a, b in turns])[len(turns) // 2])
    a, b = turns[turn]
    at = a + int(np.argmax(speed[a:b]))
    (loss,) = find_losses(problem_of(without(whole, at, 1)))
    assert loss.number == 1
    assert abs(loss.moment - whole.time[at]) < 1.5 * whole.interval


def test_a_recording_without_losses_has_none() -> None:
    for seed in (3, 4):
        assert find_losses(problem_of(recording(seed=seed))) == []


def test_a_turn_that_misses_its_closure_otherwise_is_no_loss() -> None:
    whole = recording(rate=100.0)
    poses = find_poses(whole)
    gyro = np.array(whole.gyro)
    # A blow of half a radian per second for a tenth of a second, about one axis.
    middle = int(poses.stop[5] + poses.start[6]) // 2
    gyro[middle : middle + 10, 1] += 0.5
    assert find_losses(problem_of(replace(whole, gyro=gyro))) == []


@pytest.mark.long
def test_a_loss_is_one_finding_and_its_turn_is_left_out_of_the_rest() -> None:
    whole = recording(rate=100.0)
    poses = find_poses(whole)
    at = int(0.6 * poses.stop[4] + 0.4 * poses.start[5])
    (found,) = diagnose_recording(without(whole, at, 2), gravity=GRAVITY).findings
    assert found.effect == "dropped_samples"
    assert found.parameters["count"].value == 2
    start, stop = found.intervals[0]
    assert start <= whole.time[at] <= stop
    assert found.held_out is not None
    assert found.held_out.after < 0.05 * found.held_out.before


def paused(whole: Recording, *turns: int) -> tuple[Recording, list[float]]:
    """Return a recording whose logger slept through the middle of some turns; and when."""
    poses, keep = find_poses(whole), np.ones(len(whole), bool)
    for turn in turns:
        a, b = int(poses.stop[turn]), int(poses.start[turn + 1])
        keep[a + (b - a) // 4 : b - (b - a) // 4] = False
    assert whole.temperature is not None
    made = Recording(
        whole.time[: keep.sum()],
        whole.accel[keep],
        whole.gyro[keep],
        "device",
        temperature=whole.temperature[keep],
    )
    before = [float(whole.time[keep[: poses.stop[turn]].sum()]) for turn in turns]
    return made, before


@pytest.mark.long
@pytest.mark.parametrize("turns", [(5,), (3, 9, 14)])
def test_turns_that_a_logger_slept_through_are_said_and_left_out(turns: tuple[int, ...]) -> None:
    term = Term("gyro_g_sensitivity", {"gxx": 1e-3, "gyy": -1e-3, "gzx": 1e-3})
    made, moments = paused(recording(term, poses=20), *turns)
    found = diagnose_recording(made, gravity=GRAVITY)
    assert [item.effect for item in found.findings] == ["gyro_g_sensitivity"]
    (left,) = found.unexplained
    assert left.follows == INCOMPLETE
    assert len(left.intervals) == len(turns)
    for (start, stop), moment in zip(left.intervals, moments, strict=True):
        assert start - 1.0 < moment < stop + 0.1
    assert found.verdict == "partly_explained"


def test_a_loss_beside_turns_that_are_broken_is_found() -> None:
    whole, _ = paused(recording(rate=100.0, poses=24), 2, 8, 12, 16)
    poses = find_poses(whole)
    at = int(poses.stop[5] + poses.start[6]) // 2
    losses, broken = leave_out_unwhole(problem_of(without(whole, at, 1)))
    assert len(broken) == 4
    (loss,) = losses
    assert abs(loss.moment - whole.time[at]) < 0.5


def test_no_turn_is_broken_where_one_goes_around_many_times() -> None:
    """A gyroscope off by some per cent is off by radians there."""
    whole = recording(Term("gyro_misalignment", {"mxy": 0.03, "myz": -0.03, "mzx": 0.03}))
    poses = find_poses(whole)
    known = np.ones(len(poses), bool)
    known[4:11] = False
    grid = make_grid(whole, poses.select(known))
    problem = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)
    assert not leave_out_unwhole(problem)[1]
    assert not leave_out_unwhole(problem_of(whole))[1]


def test_samples_are_put_back_where_a_spline_through_their_neighbours_has_them() -> None:
    rng = np.random.default_rng(5)
    time = 0.01 * (np.arange(40) + rng.uniform(-0.2, 0.2, 40))
    values = np.cumsum(rng.normal(size=(40, 6)), axis=0)
    at, count = np.array([2, 20, 37]), np.array([1, 5, 2])
    low, high = np.maximum(at - 6, 0), np.minimum(at + 6, 40)
    signals = (time, values[:, :3], values[:, 3:])
    (clock, force, rate), first, longer = _put_back(signals, low, high, at, count)
    assert np.all(np.diff(clock) > 0)
    step = np.median(np.diff(time))
    np.testing.assert_allclose(longer, count * step)
    for i, (a, b, k, n) in enumerate(zip(low, high, at, count, strict=True)):
        own = slice(first[i], first[i + 1])
        true = time + n * step * (np.arange(40) >= k)
        fresh = true[k - 1] + step * np.arange(1, n + 1)
        expected = np.insert(true[a:b], [k - a] * n, fresh)
        np.testing.assert_allclose(np.diff(clock[own]), np.diff(expected), atol=1e-12)
        put = CubicSpline(true[a:b], values[a:b])(fresh)
        expected = np.insert(values[a:b], [k - a] * n, put, axis=0)
        np.testing.assert_allclose(np.hstack((force, rate))[own], expected, atol=1e-9)


def test_a_mended_turn_ends_where_it_does_when_all_of_it_is_integrated() -> None:
    rng = np.random.default_rng(6)
    time = 0.01 * (np.arange(60) + rng.uniform(-0.2, 0.2, 60))
    force, rate = np.cumsum(rng.normal(size=(2, 60, 3)), axis=1)
    signals = (time, force, rate)
    path = follow_turns(Spans(time, np.array([0, 60])), force, rate)
    at, count = np.array([2, 5, 8, 30, 52, 57]), np.array([1, 4, 5, 3, 2, 1])
    found, _ = _mended(signals, path, at, count)
    everywhere = np.zeros(len(at), int), np.full(len(at), 60)
    near = _put_back(signals, np.maximum(at - PART, 0), np.minimum(at + PART, 60), at, count)[0]
    whole, first, _ = _put_back(signals, *everywhere, at, count)
    # The same samples: only those near a loss are interpolated from.
    for i, (k, n) in enumerate(zip(at, count, strict=True)):
        part = first[i] + k + np.arange(n)
        own = np.cumsum(np.append(0, np.minimum(at + PART, 60) - np.maximum(at - PART, 0) + count))[
            i
        ]
        own += k - max(k - PART, 0) + np.arange(n)
        for there, here in zip(whole[1:], near[1:], strict=True):
            there[part] = here[own]
    ended = integrate_turns(Spans(whole[0], first), *whole[1:])
    np.testing.assert_allclose(found.frame, ended.frame, atol=1e-12)
    np.testing.assert_allclose(found.velocity, ended.velocity, atol=1e-10)


@pytest.mark.parametrize(
    ("before", "after", "looks", "stands"),
    [
        (100.0, 4.0, 1500, True),
        (16.6, 2.4, 2, True),  # where the signals jump as well
        (16.6, 2.4, 1500, False),  # anywhere: such an error is mended so once in five
        (5.0, 0.5, 1, False),
        (100.0, 20.0, 1, False),
    ],
)
def test_a_loss_stands_if_no_other_error_would_be_mended_so(
    before: float, after: float, looks: int, stands: bool
) -> None:
    assert Loss(3, 10.0, 1, before, after, looks).stands == stands


def test_a_turn_beside_a_rest_that_is_shaken_may_miss_its_closure() -> None:
    """Its mean is off, and with it the way up that both turns beside it end with."""
    problem = problem_of(recording(rate=100.0))
    grid, shaken, off = problem.grid, 5, 2.5e-3
    up = problem.twin.up.copy()
    up[shaken] += off * np.cross(up[shaken], np.roll(up[shaken], 1))
    twin = replace(problem.twin, up=up / np.linalg.norm(up, axis=1, keepdims=True))
    turns = np.flatnonzero(~grid.is_rest)
    beside = (grid.before[turns] == shaken) | (grid.after[turns] == shaken)
    steady = _Closures(grid, twin, turns, problem.noise).scores
    assert steady[beside].min() > 6.0 > steady[~beside].max()
    own = grid.pose == shaken
    noise = problem.noise.copy()
    # So that the mean over its points is as uncertain as it is off.
    noise[own] = (off * GRAVITY) ** 2 * own.sum()
    louder = _Closures(grid, twin, turns, noise).scores
    assert louder[beside].max() < 3.0
    assert louder[~beside] == pytest.approx(steady[~beside], rel=0.1)
