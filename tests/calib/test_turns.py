"""Turns between poses, and what is refused."""

import numpy as np
import pytest

from calib.poses import Poses
from calib.recording import Recording
from calib.turns import find_holes, find_turns, overlapping


def recording(n: int = 100) -> Recording:
    return Recording(np.arange(n) * 0.01, np.ones((n, 3)), np.zeros((n, 3)), clock="device")


def poses(*spans: tuple[int, int]) -> Poses:
    start, stop = np.array(spans, dtype=np.int64).reshape(-1, 2).T
    zeros = np.zeros((len(spans), 3))
    cov = np.zeros((len(spans), 3, 3))
    interval = np.stack([start, stop - 1], axis=1) * 0.01
    return Poses(start, stop, interval, zeros, zeros, cov, cov)


def test_a_turn_runs_from_rest_to_rest() -> None:
    turns = find_turns(recording(), poses((0, 20), (30, 50), (70, 100)))
    assert turns.start.tolist() == [19, 49]
    assert turns.stop.tolist() == [31, 71]
    assert turns.before.tolist() == [0, 1]
    assert turns.after.tolist() == [1, 2]
    np.testing.assert_allclose(turns.interval, [[0.19, 0.30], [0.49, 0.70]])


@pytest.mark.parametrize("spans", [[], [(0, 10)]])
def test_fewer_than_two_poses_make_no_turn(spans: list[tuple[int, int]]) -> None:
    assert len(find_turns(recording(), poses(*spans))) == 0


@pytest.mark.parametrize("spans", [[(0, 20), (10, 30)], [(30, 50), (0, 20)], [(0, 20), (90, 101)]])
def test_poses_out_of_order_are_refused(spans: list[tuple[int, int]]) -> None:
    with pytest.raises(ValueError, match="`poses` must follow each other"):
        find_turns(recording(), poses(*spans))


def test_a_hole_is_where_no_sample_was_taken_for_a_quarter_of_a_second():
    time = np.concatenate((np.arange(0.0, 1.0, 0.01), np.arange(3.0, 4.0, 0.01), [4.2]))
    still = np.zeros((len(time), 3))
    holes = find_holes(Recording(time, still + 9.8, still, "device"))
    assert holes == pytest.approx(np.array([[0.99, 3.0]]))
    intervals = np.array([[0.0, 0.99], [0.5, 3.0], [0.99, 3.0], [1.5, 2.0], [3.0, 4.0]])
    assert overlapping(intervals, holes).tolist() == [False, True, True, True, False]
    assert not overlapping(intervals, holes[:0]).any()
    slow = Recording(np.arange(0.0, 10.0, 0.5), np.ones((20, 3)), np.zeros((20, 3)), "device")
    assert not len(find_holes(slow))
