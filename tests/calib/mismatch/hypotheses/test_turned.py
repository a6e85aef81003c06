"""A triad that turns against the other, in a window or for good."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from calib.effects import get_effect
from calib.mismatch import diagnose_recording
from calib.mismatch.hypotheses.ends import Told, place_window
from calib.mismatch.hypotheses.rivals import RIVAL
from calib.mismatch.hypotheses.turned import EARLIEST, turned_axes
from calib.mismatch.hypotheses.windows import TURNED, window_columns
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.ranking import make_stack
from calib.recording import CHANNELS, Recording
from calib.simulation.bench import bench_protocol
from calib.types import FloatArray

from ..bench import GRAVITY, problem, recording


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    common = min(one[1], other[1]) - max(one[0], other[0])
    return max(common, 0.0) / (max(one[1], other[1]) - min(one[0], other[0]))


def turned(real: Recording, triad: str, share: FloatArray) -> Recording:
    """Return the recording of `seed=8` with one triad's axes turned by a part of 3 mrad."""
    motion = bench_protocol(
        np.random.default_rng(8), poses=14, first_pose=2.0, pose_duration=(3.0, 4.0)
    )
    state = motion.state(real.time)
    axis = 3e-3 * np.array([0.8, -0.5, 0.3])
    signal = state.force if triad == "accel" else state.rate
    more = share[:, None] * np.cross(axis, signal)
    accel, gyro = real.accel.copy(), real.gyro.copy()
    (accel if triad == "accel" else gyro)[:] += more
    return Recording(real.time, accel, gyro, "device", temperature=real.temperature)


def for_good(part: FloatArray) -> FloatArray:
    return np.asarray(1.0 * (part > 0.45))


def slowly(part: FloatArray) -> FloatArray:
    return np.asarray(np.clip((part - 0.35) / 0.5, 0.0, 1.0))


@pytest.mark.parametrize(
    ("triad", "how", "interval"),
    [("accel", for_good, (0.45, 1.0)), ("gyro", slowly, (0.35, 1.0))],
)
@pytest.mark.long
def test_a_triad_that_turns_against_the_other_is_unexplained_from_when_it_does(
    triad: str, how: Callable[[FloatArray], FloatArray], interval: tuple[float, float]
):
    real = recording(seed=8)
    length = float(real.time[-1])
    found = diagnose_recording(turned(real, triad, how(real.time / length)), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert left.follows == TURNED
    assert overlap(left.intervals[0], (interval[0] * length, interval[1] * length)) > 0.6


def test_what_is_turned_throughout_is_a_misalignment_and_no_window_says_so():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    found = [c for c in stack if c.name == TURNED]
    assert {c.channels for c in found} == {CHANNELS[:3], CHANNELS[3:]}
    start, stop = float(rows.interval[0, 0]), float(rows.interval[-1, 1])
    assert all(c.interval is not None and c.interval[0] > start for c in found)
    stays = [c.interval[0] for c in found if c.interval is not None and c.interval[1] == stop]
    assert min(stays) > start + 0.6 * EARLIEST * (stop - start)
    # A rotation of the gyroscope is three of its misalignments' differences: the same columns.
    effect = get_effect("gyro_misalignment")
    signals = effect.columns(rows.state, {})
    candidate = found[-1]
    whole = window_columns(
        rows,
        type(candidate)(
            TURNED, candidate.index, 1.0, False, candidate.channels, interval=(start, stop)
        ),
    )
    about_z = rows.column(signals["mxy"]) - rows.column(signals["myx"])
    like = abs(float(whole[:, 2] @ about_z)) / np.linalg.norm(whole[:, 2]) / np.linalg.norm(about_z)
    assert like == pytest.approx(1.0, abs=1e-6)


def test_an_accelerometer_that_turns_within_a_rest_is_placed_within_it():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    first = np.flatnonzero(rows.is_rest)[7]
    a, b = rows.interval[first]
    moment, end = float(a + (b - a) / 3), float(rows.interval[-1, 1])
    candidate = max(turned_axes(stack, rows, RIVAL), key=lambda c: (c.interval or (0.0,))[0])
    there = type(candidate)(
        TURNED, candidate.index, 1.0, False, CHANNELS[:3], interval=(moment, end)
    )
    true = window_columns(rows, there) @ [1.0, -0.6, 0.4]
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    y = whitener.project(30.0 * true / np.linalg.norm(whitener.project(true)))
    placed = place_window(rows, there, Told(whitener, y))
    assert placed.interval == pytest.approx((moment, end), abs=1e-6)


def test_axes_that_turn_and_turn_back_are_placed_in_their_window_and_not_for_good():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    candidate = next(c for c in turned_axes(stack, rows, RIVAL) if c.channels == CHANNELS[:3])
    start, stop = float(rows.interval[14, 0]), float(rows.interval[24, 1])
    there = type(candidate)(
        TURNED, candidate.index, 1.0, False, CHANNELS[:3], interval=(start, stop)
    )
    true = window_columns(rows, there) @ [1.0, -0.6, 0.4]
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    y = whitener.project(8.0 * true / np.linalg.norm(whitener.project(true)))
    placed = place_window(rows, there, Told(whitener, y))
    assert placed.interval is not None
    assert overlap(placed.interval, (start, stop)) > 0.8
