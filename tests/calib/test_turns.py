"""Turns between poses, and what is refused."""

import numpy as np
import pytest

from calib.poses import Poses
from calib.recording import Recording
from calib.turns import find_turns


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
