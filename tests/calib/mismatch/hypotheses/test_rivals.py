"""Rivals: what a residual may follow without being physics that we know, and where."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from calib.effects import get_effect
from calib.effects.base import State, Term
from calib.mismatch import diagnose_recording
from calib.mismatch.hypotheses.candidates import DELAY, GAIN, GAIN_IN_TIME, Candidate
from calib.mismatch.hypotheses.followed import own_rate
from calib.mismatch.hypotheses.rivals import FADED, FADING, FROM_START, LATE, RIVAL
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.windows import (
    SLIPPED,
    TURNED,
    WINDOWED,
    moved_window,
    nearby_windows,
    window_columns,
)
from calib.mismatch.search.ranking import make_stack
from calib.recording import CHANNELS, Recording
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import GRAVITY, motion, motion_of, problem, recording, with_added


def rivals(stack: Stack, name: str) -> list[Candidate]:
    return [c for c in stack if c.name == name]


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    common = min(one[1], other[1]) - max(one[0], other[0])
    return max(common, 0.0) / (max(one[1], other[1]) - min(one[0], other[0]))


def test_rivals_share_one_prior_and_a_window_is_the_same_column_wherever_it_comes_from():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    assert sum(c.weight for c in stack if not c.physical) <= RIVAL + 1e-9
    # Beside a truth alone does a sensor slip in its mount; what is late is looked at below.
    names = [name for name in WINDOWED if name not in (SLIPPED, DELAY)]
    longest = [max(rivals(stack, name), key=lambda c: len(c.index)) for name in names]
    assert {len(c.channels) for c in longest} == {1, 3}
    for candidate in longest:
        on_grid = stack.of(candidate)
        exact = window_columns(rows, candidate)
        # The grid takes functions of time as constant in a part of a segment; ends do not matter.
        like = np.square((on_grid * exact).sum()) / np.square(on_grid).sum() / (exact**2).sum()
        assert like > 0.95, candidate.name


def test_a_delay_in_a_window_takes_six_turns_without_a_truth():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    assert min(len(c.index) for c in rivals(stack, DELAY)) == LATE == 12
    assert not rivals(make_stack(rows, skip=(DELAY,), reference=False), DELAY)
    assert sum(c.weight for c in stack if not c.physical) <= RIVAL + 1e-9
    longest = max(rivals(stack, DELAY), key=lambda c: len(c.index))
    on_grid, exact = stack.of(longest), window_columns(rows, longest)
    like = np.square((on_grid * exact).sum()) / np.square(on_grid).sum() / (exact**2).sum()
    assert like > 0.95


def test_what_fades_from_the_start_is_warming_up_but_faster():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    found = rivals(stack, FROM_START)
    assert {c.channels for c in found} == {CHANNELS[:3], CHANNELS[3:], *((c,) for c in CHANNELS)}
    effect = get_effect("gyro_warm_up")
    lasting = effect.shape[0].low
    assert lasting is not None
    for candidate in (c for c in found if c.channels == CHANNELS[3:]):
        assert candidate.interval is not None
        start, stop = candidate.interval
        assert start == rows.state.power_on
        tau = (stop - start) / FADED
        signals = effect.columns(rows.state, {"tau": tau})
        exact = np.stack([rows.column(signals[f"k{a}"]) for a in "xyz"], axis=1)
        on_grid = stack.of(candidate)
        np.testing.assert_allclose(on_grid, exact * (np.abs(on_grid).max() / np.abs(exact).max()))
    # Between the two there is no gap, and where both are meant warming up is more probable.
    assert FADING[0] < 2.0 < lasting < FADING[-1]
    own = sum(c.weight for c in found if "accel.x" in c.channels) / len(FADING)
    warm = [c for c in stack if c.name == "accel_warm_up" and "kx" in c.parameters]
    assert own < sum(c.weight for c in warm) / len({c.shape["tau"] for c in warm})
    # Without a clock nobody knows how fast anything fades.
    assert not rivals(make_stack(rows, skip=("time",), reference=False), FROM_START)


@pytest.mark.long
@pytest.mark.parametrize(("triad", "size"), [("accel", 0.06), ("gyro", 0.01)])
def test_a_first_rest_that_settles_has_not_warmed_up(triad, size):
    real = recording(seed=22)
    fading = size * np.exp(-(real.time - real.time[0]) / 2.5)
    real = with_added(real, {f"{triad}.x": fading, f"{triad}.z": -0.7 * fading})
    found = diagnose_recording(real, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert {f"{triad}.x", f"{triad}.z"} <= set(left.channels)
    assert overlap(left.intervals[0], (0.0, 7.5)) > 0.5


def test_a_moved_window_holds_what_is_as_fast_in_seconds():
    _, made = problem()
    stack = make_stack(made.rows(), skip=(), reference=False)
    candidate = max(rivals(stack, "fluctuation in a window"), key=lambda c: c.shape.get("order", 0))
    assert candidate.interval is not None
    start, stop = candidate.interval
    moved = moved_window(candidate, start, start + 1.5 * (stop - start))
    for name in ("order", "corner"):
        assert moved.shape[name] == pytest.approx(1.5 * candidate.shape[name], rel=0.05)
    assert moved_window(moved, start, stop).shape == pytest.approx(candidate.shape)
    night = moved_window(candidate, start, start + 1000.0 * (stop - start))
    assert night.shape["order"] <= 64


@pytest.mark.long
def test_what_follows_a_field_in_the_room_is_unexplained_and_so_is_what_a_triad_has_at_once():
    real = recording(seed=8)
    state = motion_of(real)
    assert state.mat_ns is not None
    heading = np.einsum("nij,i,j->n", state.mat_ns, [0.8, 0.6, 0.0], [0.6, 0.0, 0.8])
    found = diagnose_recording(with_added(real, {"gyro.z": 0.002 * heading}), gravity=GRAVITY)
    assert [(u.follows, u.channels) for u in found.unexplained] == [("orientation", ("gyro.z",))]
    assert not found.findings
    start, stop = 0.3 * real.time[-1], 0.6 * real.time[-1]
    inside = (real.time > start) & (real.time < stop)
    swing = inside * np.sin(4 * np.pi * (real.time - start) / (stop - start))
    sizes = dict(zip(CHANNELS[:3], (0.02, -0.02, 0.02), strict=True))
    odd = with_added(real, {c: k * swing for c, k in sizes.items()})
    found = diagnose_recording(odd, gravity=GRAVITY)
    assert not found.findings
    assert found.unexplained[0].channels == CHANNELS[:3]
    assert overlap(found.unexplained[0].intervals[0], (start, stop)) > 0.5


@pytest.mark.parametrize(("triad", "size"), [(CHANNELS[:3], 0.009), (CHANNELS[3:], 3.5e-4)])
@pytest.mark.long
def test_what_pushes_a_triad_in_one_rest_is_unexplained_there(triad, size):
    """Each axis has a third of what there is to see."""
    real = recording(seed=8)
    start, stop = find_poses(real).interval[7]
    inside = size * ((real.time >= start) & (real.time <= stop))
    pushed = {c: sign * inside for c, sign in zip(triad, (1, -1, 1), strict=True)}
    found = diagnose_recording(with_added(real, pushed), gravity=GRAVITY)
    assert not found.findings
    assert [u.channels for u in found.unexplained] == [triad]
    assert overlap(found.unexplained[0].intervals[0], (start, stop)) > 0.5


@pytest.mark.parametrize(("channel", "size"), [("accel.y", 0.012), ("gyro.y", 6e-4)])
@pytest.mark.long
def test_a_wave_in_a_window_is_found_though_a_rest_and_a_turn_have_most_of_a_period(channel, size):
    real = recording(seed=8)
    start, stop = 0.3 * real.time[-1], 0.75 * real.time[-1]
    inside = (real.time > start) & (real.time < stop)
    hum = size * np.sin(2 * np.pi * real.time / 6.0)
    found = diagnose_recording(with_added(real, {channel: inside * hum}), gravity=GRAVITY)
    assert not found.findings
    ((follows, channels),) = [(u.follows, u.channels) for u in found.unexplained]
    assert (follows, channels) == ("wave in a window", (channel,))
    assert overlap(found.unexplained[0].intervals[0], (start, stop)) > 0.5


def test_nearby_windows_lie_around_a_window_and_make_no_step_of_a_bias():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    ends = rows.interval[0, 0], rows.interval[-1, 1]
    for name in (n for n in WINDOWED if n not in (TURNED, SLIPPED, DELAY)):
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
@pytest.mark.long
def test_jumps_in_a_window_are_unexplained_in_that_window(channel, size):
    real = recording(seed=8)
    rng = np.random.default_rng(1)
    start, stop = 0.3 * real.time[-1], 0.65 * real.time[-1]
    steps = size * rng.normal(size=200)[np.floor(real.time / 4.0).astype(int)]
    steps *= (real.time > start) & (real.time < stop)
    found = diagnose_recording(with_added(real, {channel: steps}), gravity=GRAVITY)
    assert found.verdict == "unexplained"
    assert len(found.unexplained) == 1
    assert found.unexplained[0].channels == (channel,)
    assert overlap(found.unexplained[0].intervals[0], (start, stop)) > 0.5


def before(real: Recording) -> FloatArray:
    """Return gravity's direction in the pose before that of each sample, (n, 3)."""
    poses = find_poses(real)
    up = np.vstack((np.zeros((1, 3)), poses.accel / GRAVITY))
    return np.asarray(up[np.searchsorted(poses.start, np.arange(len(real)), side="right") - 1])


def creeping(real: Recording) -> FloatArray:
    """Return an axis's load minus what it was of late, with a memory of eight seconds."""
    load = motion_of(real).force[:, 2] / GRAVITY
    kept = np.exp(-real.interval / 8.0)
    lately = [load[0]]
    for value in load[1:]:
        lately.append(value + kept * (lately[-1] - value))
    return np.asarray(load - lately)


def swing(real: Recording) -> FloatArray:
    return np.asarray(np.sin(2 * np.pi * real.time / 17.0))


def rate(real: Recording, axis: int) -> FloatArray:
    """Return the true rate about an axis."""
    return np.asarray(motion_of(real).rate[:, axis])


LASTING: list[tuple[str, str, Callable[[Recording], FloatArray]]] = [
    ("wave throughout", "gyro.x", lambda r: 6e-4 * swing(r)),
    ("the pose before", "accel.y", lambda r: 0.02 * before(r)[:, 0]),
    ("the pose before", "accel.z", lambda r: 0.03 * creeping(r)),
    ("rate about the other axes", "gyro.x", lambda r: 3e-3 * (abs(rate(r, 2)) > 1)),
    ("rate about the other axes", "accel.y", lambda r: 0.025 * rate(r, 0) * rate(r, 2)),
    (
        "rate and direction of gravity",
        "accel.z",
        lambda r: 2e-3 * motion_of(r).force[:, 2] * np.linalg.norm(motion_of(r).rate, axis=1),
    ),
    (
        "rate and direction of gravity",
        "gyro.y",
        lambda r: 2e-4 * motion_of(r).force[:, 0] * motion_of(r).rate[:, 2],
    ),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "channel", "make"), LASTING)
def test_what_is_there_throughout_is_unexplained_by_what_it_follows(name, channel, make):
    real = recording(seed=8, poses=18)
    found = diagnose_recording(with_added(real, {channel: make(real)}), gravity=GRAVITY)
    assert not found.findings
    assert [(u.follows, u.channels) for u in found.unexplained] == [(name, (channel,))]


@pytest.mark.long
@pytest.mark.parametrize("size", [0.01, 0.02])
def test_steps_of_a_converter_on_its_own_axis_follow_the_direction_of_gravity(size):
    # Nor does a cubic stand beside it, which is left of steps that are no pure ripple.
    real = recording(seed=8, poses=24)
    ripple = np.sin(3.0 * np.pi * motion_of(real).force[:, 0] / GRAVITY)
    found = diagnose_recording(with_added(real, {"accel.x": size * ripple}), gravity=GRAVITY)
    assert not found.findings
    left = [(u.follows, u.channels) for u in found.unexplained]
    assert left == [("direction of gravity", ("accel.x",))]


@pytest.mark.long
def test_what_weakens_a_triad_in_a_window_is_one_gain_of_it():
    real = recording(seed=8)
    force = motion_of(real).force
    start, stop = 0.4 * real.time[-1], 0.7 * real.time[-1]
    inside = (real.time > start) & (real.time < stop)
    weak = {CHANNELS[i]: 1.5e-3 * inside * force[:, i] for i in range(3)}
    found = diagnose_recording(with_added(real, weak), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == (GAIN, CHANNELS[:3])
    assert overlap(left.intervals[0], (start, stop)) > 0.7


@pytest.mark.long
def test_a_gain_that_grows_in_a_window_and_snaps_back_is_unexplained_there():
    real = recording(seed=8)
    start, stop = 0.3 * real.time[-1], 0.7 * real.time[-1]
    grown = np.where(
        (real.time > start) & (real.time < stop), (real.time - start) / (stop - start), 0.0
    )
    found = diagnose_recording(
        with_added(real, {"accel.y": 4e-3 * grown * motion_of(real).force[:, 1]}), gravity=GRAVITY
    )
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == (GAIN, ("accel.y",))
    assert overlap(left.intervals[0], (start, stop)) > 0.6


@pytest.mark.long
def test_a_gain_that_every_turn_makes_anew_is_unexplained_throughout():
    real = recording(seed=8)
    turn = np.searchsorted(find_poses(real).stop, np.arange(len(real)))
    gain = 3e-3 * np.random.default_rng(2).normal(size=turn[-1] + 1)[turn]
    odd = with_added(real, {"gyro.y": gain * rate(real, 1)})
    found = diagnose_recording(odd, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == (GAIN_IN_TIME, ("gyro.y",))
    assert overlap(left.intervals[0], (0.0, real.time[-1])) > 0.95


@pytest.mark.long
def test_a_gain_that_changes_at_a_moment_is_unexplained_in_the_shorter_part():
    overlaps = []
    for seed in (8, 9, 10, 11):
        real = recording(seed=seed, poses=18)
        begin = 0.4 * real.time[-1]
        force = motion(18, seed).state(real.time).force[:, 1]
        odd = with_added(real, {"accel.y": 4e-3 * (real.time > begin) * force})
        found = diagnose_recording(odd, gravity=GRAVITY)
        assert not found.findings
        (left,) = found.unexplained
        assert (left.follows, left.channels) == (GAIN, ("accel.y",))
        overlaps.append(overlap(left.intervals[0], (0.0, begin)))
    assert np.mean(overlaps) > 0.85


@pytest.mark.long
def test_a_gain_that_grows_for_good_is_unexplained_from_then_on():
    real = recording(seed=8, poses=18)
    begin, end = 0.55 * real.time[-1], float(real.time[-1])
    share = np.maximum(real.time - begin, 0.0) / (end - begin)
    force = motion_of(real).force[:, 1]
    found = diagnose_recording(with_added(real, {"accel.y": 4e-3 * share * force}), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == (GAIN_IN_TIME, ("accel.y",))
    assert overlap(left.intervals[0], (begin, end)) > 0.7


def test_one_lost_sample_is_found_at_its_moment_in_the_turn():
    _, made = problem()
    rows = made.rows()
    turns = rows.interval[~rows.is_rest]
    # Off the middle of the turn, which is where it is looked for first.
    moment = float(turns[7] @ [0.6, 0.4])
    lost = Term("dropped_samples", {"count": 1.0, "moment": moment})
    real = recording(lost, poses=18, rate=100.0)
    # The simulation holds the last sample where one is missing.
    some = Recording(
        real.time[:-1], real.accel[:-1], real.gyro[:-1], "device", temperature=real.temperature[:-1]
    )
    found = diagnose_recording(some, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["dropped_samples"]
    count = found.findings[0].parameters["count"]
    # A whole number, if the turn is mended by it; a fitted one has an error.
    assert count.value == pytest.approx(1.0, abs=4 * (count.sigma or 0.0))
    assert abs(found.findings[0].parameters["moment"].value - moment) < 0.15
    assert not found.unexplained


def test_an_axis_that_hardly_turns_has_no_rate_of_its_own_to_follow():
    time = np.linspace(0.0, 10.0, 500)
    rate = np.stack([np.sin(time), np.cos(0.7 * time), 0.01 * np.sin(time)], axis=1)
    state = State(time, np.ones((500, 3)), rate)
    for c in range(6):
        assert own_rate(state, c).any() == (c != 5)
