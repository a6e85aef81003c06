"""Samples lost in a turn, with a clock that counts samples."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.grid import make_grid
from calib.mismatch.losses import _put_back, find_losses
from calib.mismatch.selfmode import SelfProblem
from calib.recording import Recording
from calib.statics import find_poses

from .bench import GRAVITY, recording


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


def test_samples_are_put_back_where_a_spline_through_their_neighbours_has_them() -> None:
    rng = np.random.default_rng(5)
    time = 0.01 * (np.arange(40) + rng.uniform(-0.2, 0.2, 40))
    values = np.cumsum(rng.normal(size=(40, 6)), axis=0)
    at, count = np.array([2, 20, 37]), np.array([1, 5, 2])
    (clock, force, rate), first = _put_back((time, values[:, :3], values[:, 3:]), at, count)
    assert np.all(np.diff(clock) > 0)
    step = np.median(np.diff(time))
    for i, (a, n) in enumerate(zip(at, count, strict=True)):
        own = slice(first[i], first[i + 1])
        since, whole = clock[own] - clock[own][0], np.hstack((force, rate))[own]
        true = time - time[0] + n * step * (np.arange(40) >= a)
        near = slice(max(a - 6, 0), a + 6)
        fresh = true[a - 1] + step * np.arange(1, n + 1)
        np.testing.assert_allclose(since, np.insert(true, [a] * n, fresh), atol=1e-12)
        expected = np.insert(values, [a] * n, CubicSpline(true[near], values[near])(fresh), axis=0)
        np.testing.assert_allclose(whole, expected, atol=1e-9)
