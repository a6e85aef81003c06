"""Rivals: what a residual may follow without being physics that we know, and where."""

from __future__ import annotations

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.ranking import make_stack
from calib.mismatch.rivals import RIVAL, WINDOWED, nearby_windows, window_columns
from calib.mismatch.score import Candidate, Stack
from calib.recording import Recording

from .bench import GRAVITY, problem, recording


def rivals(stack: Stack, name: str) -> list[Candidate]:
    return [c for c in stack.candidates if c.name == name]


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    common = min(one[1], other[1]) - max(one[0], other[0])
    return max(common, 0.0) / (max(one[1], other[1]) - min(one[0], other[0]))


def test_rivals_share_one_prior_and_a_window_is_the_same_column_wherever_it_comes_from():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    assert sum(c.weight for c in stack.candidates if not c.physical) <= RIVAL + 1e-9
    for name in WINDOWED:
        candidate = max(rivals(stack, name), key=lambda c: len(c.index))
        assert candidate.interval is not None
        on_grid = stack.of(candidate)
        exact = window_columns(rows, candidate, *candidate.interval)
        # The grid takes functions of time as constant in a part of a segment; ends do not matter.
        like = np.square((on_grid * exact).sum()) / np.square(on_grid).sum() / (exact**2).sum()
        assert like > 0.95, name


def test_nearby_windows_lie_around_a_window_and_make_no_step_of_a_bias():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    ends = rows.interval[0, 0], rows.interval[-1, 1]
    for name in WINDOWED:
        for candidate in rivals(stack, name)[::97]:
            assert candidate.interval is not None
            near = list(nearby_windows(rows, candidate))
            assert candidate.interval in near
            assert len(near) == len(set(near)) < 150
            length = np.ptp(candidate.interval)
            some = np.array(near) if length > 20 else np.zeros((0, 2))
            assert (np.ptp(some, axis=1) > 0.6 * length).all()
            assert (np.ptp(some, axis=1) < 1.6 * length).all()
            if name == "bias in a window":
                assert not set(ends) & set(np.ravel(near))


@pytest.mark.parametrize(("channel", "size"), [("gyro.y", 0.001), ("accel.x", 0.03)])
def test_jumps_in_a_window_are_unexplained_in_that_window(channel, size):
    real = recording(seed=8)
    rng = np.random.default_rng(1)
    start, stop = 0.3 * real.time[-1], 0.65 * real.time[-1]
    steps = size * rng.normal(size=200)[np.floor(real.time / 4.0).astype(int)]
    both = np.hstack((real.accel, real.gyro))
    both[:, ["accel.x", "gyro.y"].index(channel) * 4] += steps * (
        (real.time > start) & (real.time < stop)
    )
    odd = Recording(real.time, both[:, :3], both[:, 3:], "device", temperature=real.temperature)
    found = diagnose_recording(odd, gravity=GRAVITY)
    assert found.verdict == "unexplained"
    assert len(found.unexplained) == 1
    assert found.unexplained[0].channels == (channel,)
    assert overlap(found.unexplained[0].intervals[0], (start, stop)) > 0.5


def test_one_lost_sample_is_found_at_its_moment_in_the_turn():
    _, made = problem()
    rows = made.rows()
    turns = rows.interval[~rows.is_rest]
    # Off the middle of the turn, which is where it is looked for first.
    moment = float(turns[7] @ [0.6, 0.4])
    real = recording(Term("dropped_samples", {"count": 1.0, "moment": moment}), rate=100.0)
    # The simulation holds the last sample where one is missing.
    some = Recording(
        real.time[:-1], real.accel[:-1], real.gyro[:-1], "device", temperature=real.temperature[:-1]
    )
    found = diagnose_recording(some, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["dropped_samples"]
    count = found.findings[0].parameters["count"]
    assert count.sigma is not None
    assert abs(count.value - 1.0) < 4 * count.sigma
    assert abs(found.findings[0].parameters["moment"].value - moment) < 0.15
    assert not found.unexplained
