"""The motion that motion capture or a table saw."""

import numpy as np
import pytest

from calib.errors import InsufficientMotionError
from calib.mismatch import ReferenceMotion
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.motions import pendulum
from calib.simulation.referenced import motion_from_reference, shown_bandwidth
from calib.types import FloatArray

G = 9.80665


def captured(
    seed: int, rate: float, angle: float, place: float
) -> tuple[Motion, FloatArray, FloatArray, FloatArray]:
    """Return a motion, and times, orientations and positions of it with noise (rad, m)."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=6, first_pose=1.0, pose_duration=(2.0, 3.0), tremor=0.3)
    time = np.arange(0.0, motion.duration, 1.0 / rate)
    turning, path = motion.kinematics(time)
    assert path is not None
    shake = quat_from_rotvec(rng.normal(0.0, angle, (len(time), 3)))
    position = path.position + rng.normal(0.0, place, (len(time), 3))
    return motion, time, quat_multiply(turning.quat, shake), position


def left(found: Motion, motion: Motion, rate: float) -> tuple[float, float]:
    """Return what is off in forces and rates away from the ends, m/s² and rad/s rms."""
    time = np.arange(2.0, motion.duration - 2.0, 1.0 / rate)
    seen, true = found.state(time), motion.state(time)
    force, rates = seen.force - true.force, seen.rate - true.rate
    return float(np.sqrt(np.mean(force**2))), float(np.sqrt(np.mean(rates**2)))


@pytest.mark.parametrize("rate", [100.0, 400.0])
def test_a_reference_gives_back_its_motion(rate: float) -> None:
    motion = pendulum(hold=0.0, duration=10.0)
    time = np.arange(0.0, 10.0, 1 / rate)
    kinematics = motion.kinematics(time)
    assert kinematics.path is not None
    quat = kinematics.turning.quat.copy()
    quat[::3] *= -1  # the same orientations
    quat[50:53] = np.nan
    found = motion_from_reference(time + 7.0, quat, kinematics.path.position, gravity=G)
    between = time[20:-20] + 0.3 / rate
    between = between[found.seen(between)]
    assert len(between) > 0.93 * len(time)
    true, state = motion.state(between), found.state(between)
    np.testing.assert_allclose(state.rate, true.rate, atol=1e-3)
    np.testing.assert_allclose(state.force, true.force, atol=2e-3)
    # That of `ReferenceMotion`, by which a diagnosis judges.
    seen = ReferenceMotion(time + 7.0, kinematics.turning.quat, kinematics.path.position)
    truth = seen.truth(gravity=G).state(between + 7.0)
    np.testing.assert_allclose(state.force, truth.force, atol=2e-3)


def test_a_noisy_reference_is_smoothed_without_delay() -> None:
    motion = pendulum(hold=0.0, duration=20.0, length=0.5)
    time = np.arange(0.0, 20.0, 0.005)
    kinematics = motion.kinematics(time)
    assert kinematics.path is not None
    noise = np.random.default_rng(8).normal(0, 2e-4, (len(time), 3))
    found = motion_from_reference(
        time, kinematics.turning.quat, kinematics.path.position + noise, gravity=G, bandwidth=6.0
    )
    error = (found.state(time).force - motion.state(time).force)[100:-100]
    assert np.sqrt(np.mean(error**2)) < 0.15


def test_references_are_checked() -> None:
    time, quat = np.arange(5.0), np.tile([1.0, 0, 0, 0], (5, 1))
    for arguments, name in (
        ((time, quat[:4]), "quat"),
        ((time, quat, np.zeros((4, 3))), "position"),
        ((time, np.full((5, 4), np.nan)), "quat"),
        ((np.zeros(5), quat), "time"),
    ):
        with pytest.raises(ValueError, match=f"`{name}`"):
            motion_from_reference(*arguments, gravity=G)


@pytest.mark.parametrize("rate", [60.0, 240.0])
def test_an_exact_reference_needs_no_low_pass(rate: float) -> None:
    _, time, quat, position = captured(11, rate, 0.0, 0.0)
    assert shown_bandwidth(time, quat, position) is None
    assert shown_bandwidth(time[:50], quat[:50], position[:50]) is None


@pytest.mark.parametrize("rate", [60.0, 240.0])
def test_a_reference_shows_where_its_motion_drowns(rate: float) -> None:
    """The low-pass that it chooses is about as good as the best."""
    motion, time, quat, position = captured(12, rate, np.radians(0.1), 2e-4)
    shown = shown_bandwidth(time, quat, position)
    assert shown is not None
    seen = {
        cutoff: left(
            motion_from_reference(time, quat, position, gravity=G, bandwidth=cutoff), motion, rate
        )
        for cutoff in (shown, 3.0, 5.0, 8.0, 12.0, 20.0)
    }
    for k in range(2):
        assert seen[shown][k] < 1.3 * min(values[k] for values in seen.values())


def test_a_gap_delays_nothing_behind_it() -> None:
    motion, time, quat, position = captured(13, 120.0, np.radians(0.05), 1e-4)
    quat[600:660] = np.nan
    found = motion_from_reference(time, quat, position, gravity=G, bandwidth=6.0)
    after = time[(time > 6.5) & (time < motion.duration - 1)]
    error = found.state(after).rate - motion.state(after).rate
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_quaternions_of_zeros_are_gaps() -> None:
    _, time, quat, position = captured(18, 120.0, 0.0, 0.0)
    found = []
    for nothing in (np.nan, 0.0):
        quat[600:700] = nothing
        assert shown_bandwidth(time, quat, position) is None
        found.append(motion_from_reference(time, quat, position, gravity=G))
    assert len(found[1].intervals("hidden")) == 1
    np.testing.assert_array_equal(*(motion.state(time).rate for motion in found))


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("length", [60, 240, 600])
def test_nothing_is_made_up_in_a_hole(noise: float, length: int) -> None:
    motion, time, quat, position = captured(16, 120.0, noise * np.radians(0.05), noise * 1e-4)
    size = np.linalg.norm(motion.kinematics(time).path.acceleration, axis=1)
    fastest = np.linalg.norm(motion.kinematics(time).turning.rate, axis=1).max()
    for start in range(300, 1800, 100):
        seen = position.copy()
        seen[start : start + length] = np.nan
        found = motion_from_reference(time, quat, seen, gravity=G, bandwidth=8.0 if noise else None)
        ((begin, end),) = found.intervals("hidden")
        assert time[start - 1] - 0.1 < begin < time[start]
        assert time[start + length - 1] < end < time[start + length] + 0.1
        assert not found.seen(time[start : start + length]).any()
        turning, path = found.kinematics(np.arange(begin, end, 1e-3))
        assert np.linalg.norm(path.acceleration, axis=1).max() < 1.5 * size.max()
        assert np.linalg.norm(turning.rate, axis=1).max() < 1.1 * fastest


def test_holes_all_over_leave_no_motion() -> None:
    _, time, quat, position = captured(19, 120.0, 0.0, 0.0)
    position[np.arange(len(time)) % 20 < 13] = np.nan
    with pytest.raises(InsufficientMotionError, match=r"torn by \d+ holes.* more than 16 rows"):
        motion_from_reference(time, quat, position, gravity=G)


def test_a_few_rows_that_are_missing_hide_nothing() -> None:
    motion, time, quat, position = captured(17, 120.0, 0.0, 0.0)
    position[600:603] = np.nan
    found = motion_from_reference(time, quat, position, gravity=G)
    assert found.seen(time).all()
    error = found.state(time).force - motion.state(time).force
    assert np.abs(error[500:700]).max() < 0.2


def test_a_reference_says_when_it_turns() -> None:
    motion, time, quat, position = captured(14, 120.0, np.radians(0.02), 5e-5)
    found = motion_from_reference(time, quat, position, gravity=G, bandwidth=8.0)
    assert len(found.turns) == len(motion.turns)
    np.testing.assert_allclose(found.turns, motion.turns, atol=0.25)


def test_time_zero_may_be_given() -> None:
    _, time, quat, position = captured(15, 60.0, 0.0, 0.0)
    whole = motion_from_reference(time + 3.0, quat, position, gravity=G)
    later = motion_from_reference(time + 3.0, quat, position, gravity=G, start=5.0)
    assert later.duration == pytest.approx(whole.duration - 2.0)
    at = np.arange(0.0, 4.0, 0.1)
    np.testing.assert_allclose(later.state(at).rate, whole.state(at + 2.0).rate, atol=1e-9)
