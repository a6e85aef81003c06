"""What a hand still carries when it turns no more is no rest; what moves slowly is left in."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.rows.uncarried import uncarried
from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.types import FloatArray

RATE = 100.0


def two_rests(push: FloatArray) -> tuple[Recording, FloatArray]:
    """Return 5 s of rest, 2 s of a turn and 5 s of rest, `push` (m,) from the turn's end on."""
    time = np.arange(0.0, 12.0, 1 / RATE)
    turning = (time >= 5.0) & (time < 7.0)
    angle = np.clip((time - 5.0) / 2.0, 0.0, 1.0) * 1.2
    accel = 9.81 * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    gyro = np.where(turning, 0.6, 0.0)[:, None] * [0.0, 1.0, 0.0]
    accel[700 : 700 + len(push), 1] += push
    rng = np.random.default_rng(1)
    noisy = accel + rng.normal(0, 0.02, accel.shape), gyro + rng.normal(0, 0.002, gyro.shape)
    edges = np.array([0, 700]), np.array([500, 1200])
    recording = Recording(time, *noisy, "device")
    return recording, uncarried(recording, average_poses(recording, *edges)).interval


def test_a_rest_begins_when_nothing_carries_the_sensor_any_more() -> None:
    """It moved by 0.65 m/s² in one, and the turn before it was a bias in a window."""
    push = 1.5 * np.sin(np.linspace(0.0, 2 * np.pi, 35, endpoint=False))
    _, interval = two_rests(push)
    assert interval[0] == pytest.approx([0.0, 4.99], abs=0.011)
    assert 7.3 <= interval[1, 0] <= 7.75
    assert interval[1, 1] == pytest.approx(11.99)


@pytest.mark.parametrize("size", [0.0, 0.02])
def test_what_settles_for_seconds_is_left_in(size: float) -> None:
    _, interval = two_rests(size * np.exp(-np.arange(400) / RATE / 1.5))
    assert interval == pytest.approx(np.array([[0.0, 4.99], [7.0, 11.99]]), abs=0.011)


def test_of_a_rest_that_was_thinned_no_moment_is_taken_from_beyond_what_was_left_out() -> None:
    # Windows of 0.26 s are left of the first rest, 0.2 s apart: none is long enough to tell, and
    # no moment in the second window is next to the turn.
    push = 1.5 * np.sin(np.linspace(0.0, 2 * np.pi, 35, endpoint=False))
    whole, interval = two_rests(push)
    kept = np.ones(len(whole), bool)
    for at in range(700, 1160, 46):
        kept[at + 26 : at + 46] = False
    lost = np.diff(np.flatnonzero(kept), prepend=-1) - 1
    thinned = replace(whole.select(kept), lost=lost)
    begin, end = int(kept[:700].sum()), int(kept.sum())
    poses = average_poses(thinned, np.array([0, begin]), np.array([500, end]))
    left = uncarried(thinned, poses)
    assert interval[1, 0] > 7.3
    assert thinned.time[left.start[1]] == pytest.approx(7.0, abs=0.011)


def slowly(ends: list[int], begins: list[int], count: int = 12) -> tuple[Recording, Poses, Poses]:
    """Return rests of 6 s with turns of 2 s between, and what `uncarried` leaves of them.

    Some end, and some begin, with a force across gravity that a smooth lift has: from nothing to
    0.02 m/s² within 1.2 s, of a part with 0.004 m/s² of noise.
    """
    cycle = round(8.0 * RATE)
    time = np.arange(count * cycle) / RATE
    since = np.arange(cycle) / RATE
    accel = np.tile([0.0, 0.0, 9.81], (len(time), 1))
    gyro = np.zeros_like(accel)
    rng = np.random.default_rng(2)
    for k in range(count):
        own = slice(k * cycle, (k + 1) * cycle)
        gyro[own, 1] = np.where(since >= 6.0, 0.6, 0.0)
        accel[own, 0] += 0.02 * (k in ends) * np.clip((since - 4.8) / 1.2, 0.0, 1.0) * (since < 6.0)
        accel[own, 0] += 0.02 * (k in begins) * np.clip((1.2 - since) / 1.2, 0.0, 1.0)
    accel += rng.normal(0, 0.004, accel.shape)
    gyro += rng.normal(0, 4e-4, gyro.shape)
    recording = Recording(time, accel, gyro, "device")
    start = np.arange(count) * cycle
    poses = average_poses(recording, start, start + round(6.0 * RATE))
    return recording, poses, uncarried(recording, poses)


def moved(before: Poses, after: Poses) -> tuple[FloatArray, FloatArray]:
    """Return by how many seconds rests begin later, and end earlier."""
    return (after.start - before.start) / RATE, (before.stop - after.stop) / RATE


def test_what_is_carried_slowly_before_it_is_turned_is_no_rest() -> None:
    _, poses, left = slowly(ends=[1, 4, 7], begins=[])
    late, early = moved(poses, left)
    assert (early[[1, 4, 7]] >= 0.9).all()
    assert (early[[1, 4, 7]] <= 1.9).all()
    assert np.delete(early, [1, 4, 7]).max() <= 0.4
    assert late.max() <= 0.4


@pytest.mark.parametrize(("ends", "begins"), [([], [3]), ([1, 4], [0, 2, 3, 5, 6, 8])])
def test_what_few_rests_begin_with_or_where_they_end_so_too_is_motion(
    ends: list[int], begins: list[int]
) -> None:
    _, poses, left = slowly(ends, begins)
    late, _ = moved(poses, left)
    assert (late[begins] >= 0.9).all()
    assert np.delete(late, begins).max() <= 0.4


def test_what_nearly_all_rests_begin_with_is_the_sensor_s_own() -> None:
    _, poses, left = slowly(ends=[], begins=list(range(1, 12)))
    assert moved(poses, left)[0].max() <= 0.11
