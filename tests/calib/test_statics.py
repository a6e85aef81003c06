"""Static poses: found without a threshold, in any unit; batch and live."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calib import Recording
from calib.live_statics import LiveStatics
from calib.model import SensorModel
from calib.poses import average_poses
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

GRAVITY = 9.80665
BIAS = np.array([0.02, -0.01, 0.015])


def recording(
    *turns: tuple[float, float, float],
    rate: float = 100.0,
    last: float = 4.0,
    noise: float = 1.0,
    seed: int = 0,
    accel_unit: float = 1.0,
    gyro_unit: float = 1.0,
) -> tuple[Recording, FloatArray]:
    """Return rests of 4 s with turns (rad, duration s, rest after it s) about x and y by turns."""
    rng = np.random.default_rng(seed)
    spans, begin = [], 4.0
    for angle, duration, rest in turns:
        spans.append((begin, begin + duration, angle))
        begin += duration + rest
    time = np.arange(int((begin - (turns[-1][2] if turns else 4.0) + last) * rate)) / rate
    gyro = np.zeros((len(time), 3))
    up = np.tile([0.0, 0.0, 1.0], (len(time), 1))
    mat = np.eye(3)
    turning = np.zeros(len(time), bool)
    for k, (t0, t1, angle) in enumerate(spans):
        s = np.clip((time - t0) / (t1 - t0), 0, 1)
        turned = angle * (s - np.sin(2 * np.pi * s) / (2 * np.pi))
        axis = np.eye(3)[k % 2]
        inside = (time >= t0) & (time < t1)
        gyro[inside] = np.outer(1 - np.cos(2 * np.pi * s[inside]), axis) * angle / (t1 - t0)
        turning |= inside
        c, sn = np.cos(turned), np.sin(turned)
        v = mat.T @ [0.0, 0.0, 1.0]  # up before the turn, and after it turned the other way
        rotated = (
            np.outer(c, v) - sn[:, None] * np.cross(axis, v) + np.outer(1 - c, axis * (axis @ v))
        )
        up[time >= t0] = rotated[time >= t0]
        mat = np.linalg.qr(np.column_stack((rotated[-1], np.eye(3)[:, :2])))[0]
        mat = np.vstack((mat[:, 1], mat[:, 2], rotated[-1])).T
        mat = mat.T
    accel = GRAVITY * up + 0.02 * noise * rng.standard_normal(up.shape)
    gyro += BIAS + 0.002 * noise * rng.standard_normal(up.shape)
    made = Recording(time, accel * accel_unit, gyro * gyro_unit, "nominal")
    return made, turning


TURNS = ((1.5, 1.0, 4.0), (-1.0, 2.0, 3.0), (2.0, 0.4, 4.0), (0.8, 3.0, 4.0))


@pytest.mark.parametrize("rate", [8.0, 100.0, 1000.0])
@pytest.mark.parametrize("noise", [0.3, 1.0, 10.0])
def test_every_pose_is_found_and_no_turn_is_in_one(rate: float, noise: float) -> None:
    made, turning = recording(*TURNS, rate=rate, noise=noise)
    poses = find_poses(made)
    assert len(poses) == 5
    assert not any(turning[a:b].any() for a, b in zip(poses.start, poses.stop, strict=True))
    assert (poses.stop - poses.start > 1.5 * rate).all()


@pytest.mark.parametrize(("speed", "most"), [(0.3, 120.0), (3.49, 120.0), (3.49, 600.0)])
@pytest.mark.parametrize(("accel_unit", "gyro_unit"), [(1.0, 1.0), (1 / 1670, 1 / 939)])
def test_a_spin_at_one_speed_is_no_rest_however_long(speed, most, accel_unit, gyro_unit):
    """About the vertical nothing changes that a sensor reads, but the rests are slower."""
    rng = np.random.default_rng(4)
    time = np.arange(int((most + 14) * 50)) / 50
    spin = speed * np.clip(np.minimum(time - 5, most + 9 - time) / 2, 0, 1)
    gyro = BIAS + np.outer(spin, [0.0, 0.01, 1.0]) + rng.normal(0, 0.002, (len(time), 3))
    accel = np.array([0.0, 0.1, GRAVITY]) + rng.normal(0, 0.02, (len(time), 3))
    poses = find_poses(Recording(time, accel / accel_unit, gyro / gyro_unit, clock="host"))
    assert_allclose(time[poses.start], [0.0, most + 9], atol=0.5)
    assert_allclose(time[poses.stop - 1], [5.0, most + 14], atol=0.5)
    assert_allclose(poses.gyro * gyro_unit, [BIAS, BIAS], atol=1e-3)


def test_units_do_not_matter() -> None:
    poses = find_poses(recording(*TURNS)[0])
    for units in ((16384 / GRAVITY, 16.4 * 180 / np.pi), (1 / GRAVITY, 180 / np.pi)):
        other = find_poses(recording(*TURNS, accel_unit=units[0], gyro_unit=units[1])[0])
        assert_allclose(other.start, poses.start)
        assert_allclose(other.stop, poses.stop)


def test_a_log_at_rest_is_one_pose() -> None:
    poses = find_poses(recording(last=60.0)[0])
    assert len(poses) == 1
    assert poses.stop[0] - poses.start[0] > 5900


def test_a_log_that_only_moves_has_none() -> None:
    time = np.arange(0, 60, 0.01)
    angle = 1.2 * np.sin(2 * np.pi * 0.2 * time)
    rate = 1.2 * 2 * np.pi * 0.2 * np.cos(2 * np.pi * 0.2 * time)
    accel = GRAVITY * np.column_stack((0 * time, np.sin(angle), np.cos(angle)))
    gyro = np.column_stack((rate, 0 * time, 0 * time))
    assert len(find_poses(Recording(time, accel, gyro, "nominal"))) == 0


@pytest.mark.parametrize("size", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("motor", [0.0, 23.0])
def test_a_pose_on_a_bench_that_shakes_is_one(size: float, motor: float) -> None:
    log, _ = recording(*[(1.2, 1.0, 5.0)] * 6, seed=5)
    rng = np.random.default_rng(6)
    shaking = rng.normal(size=(len(log), 3))
    if motor:
        shaking = np.sqrt(2) * np.sin(2 * np.pi * motor * log.time[:, None] + [0.0, 1.0, 2.0])
    shaken = (log.time > 9.9) & (log.time < 22.1)  # two whole poses, and the turn between them
    accel = log.accel + size * shaken[:, None] * shaking
    poses = find_poses(Recording(log.time, accel, log.gyro, log.clock))
    calm = find_poses(log)
    assert len(poses) == len(calm)
    assert_allclose(poses.interval, calm.interval, atol=0.6)


def test_a_sensor_that_is_moved_about_without_turning_is_in_no_pose() -> None:
    log, _ = recording(*[(1.2, 1.0, 5.0)] * 6, seed=5)
    moved = (log.time > 10.0) & (log.time < 15.0)
    swing = np.sin(2 * np.pi * 2.0 * log.time)[:, None] * [2.0, 1.0, 0.5]
    accel = log.accel + moved[:, None] * swing
    poses = find_poses(Recording(log.time, accel, log.gyro, log.clock))
    assert not any(a < 14.5 and b > 10.5 for a, b in poses.interval)


def test_poses_on_both_sides_of_a_quick_turn_are_two() -> None:
    made, turning = recording((0.5, 0.2, 4.0))
    poses = find_poses(made)
    assert len(poses) == 2
    assert not any(turning[a:b].any() for a, b in zip(poses.start, poses.stop, strict=True))


def test_a_slow_turn_is_no_pose() -> None:
    made, turning = recording((1.0, 15.0, 5.0), last=5.0)
    poses = find_poses(made)
    assert len(poses) == 2
    inside = np.concatenate([np.arange(a, b) for a, b in zip(poses.start, poses.stop, strict=True)])
    assert turning[inside].sum() == 0


def test_a_bump_is_cut_out() -> None:
    made, _ = recording(last=20.0)
    accel = made.accel.copy()
    accel[1000:1020] += 3.0
    poses = find_poses(Recording(made.time, accel, made.gyro, "nominal"))
    assert len(poses) == 2
    assert not any((a < 1020) and (b > 1000) for a, b in zip(poses.start, poses.stop, strict=True))


def test_a_gap_parts_two_poses() -> None:
    made, _ = recording(last=20.0)
    time = made.time.copy()
    time[1000:] += 3.0
    poses = find_poses(Recording(time, made.accel, made.gyro, "nominal"))
    assert len(poses) == 2
    assert poses.stop[0] <= 1000 <= poses.start[1]


def test_short_and_constant_logs_are_no_trouble() -> None:
    for n in (1, 2, 5, 30):
        one = np.tile([0.0, 0.0, GRAVITY], (n, 1))
        assert len(find_poses(Recording(0.01 * np.arange(n), one, 0 * one, "nominal"))) == 0
    n = 400
    one = np.tile([0.0, 0.0, GRAVITY], (n, 1))
    assert len(find_poses(Recording(0.01 * np.arange(n), one, 0 * one, "nominal"))) == 1


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_covariance_of_the_mean_holds_for_correlated_noise(correlation: float) -> None:
    rng = np.random.default_rng(5)
    k, n = 60, 600
    noise = rng.standard_normal((k * n, 3))
    if correlation:
        from scipy.signal import lfilter

        noise = lfilter([1.0], [1.0, -correlation], noise, axis=0)
    made = Recording(0.01 * np.arange(k * n), noise + 1.0, noise, "nominal")
    start = np.arange(k) * n
    poses = average_poses(made, start, start + n)
    error = poses.accel - 1.0
    squares = np.einsum("ki,kij,kj->k", error, np.linalg.inv(poses.accel_covariance), error)
    assert 0.7 < squares.mean() / 3 < 1.5


def test_rounding_is_not_averaged_away_without_noise() -> None:
    made = Recording(
        0.01 * np.arange(100), np.tile([0.0, 0.0, 9.8], (100, 1)), np.zeros((100, 3)), "nominal"
    )
    accel = made.accel.copy()
    accel[50:, 2] += 0.01  # one step, once
    made = Recording(made.time, accel, made.gyro, "nominal")
    poses = average_poses(made, np.array([0, 50]), np.array([50, 100]))
    assert_allclose(poses.accel_covariance[:, 2, 2], 0.01**2 / 12)


@pytest.mark.parametrize("rate", [8.0, 100.0, 1000.0])
def test_live_knows_within_a_second(rate: float) -> None:
    made, turning = recording(*TURNS, rate=rate)
    live = LiveStatics()
    step = max(1, int(0.07 * rate))
    resting = np.zeros(len(made), bool)
    for first in range(0, len(made), step):
        events = live.update(made.slice(first, min(first + step, len(made))))
        for event in events:
            resting[np.searchsorted(made.time, event.known) :] = event.resting
            assert event.known - event.time < 1.0
    edge = np.flatnonzero(np.diff(turning.astype(int)))
    for k in edge:  # one second after every change it must know
        after = min(k + int(rate), len(made) - 1)
        if turning[after] == turning[k + 1]:
            assert resting[after] != turning[k + 1]


def test_live_does_not_depend_on_how_samples_are_cut() -> None:
    made, _ = recording(*TURNS)
    one, many = LiveStatics(), LiveStatics()
    whole = [e.resting for e in one.update(made)]
    parts = [e.resting for k in range(0, len(made), 37) for e in many.update(made.slice(k, k + 37))]
    assert whole == parts


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_gyroscope_that_warms_up_loses_no_rest(seed: int) -> None:
    """It leaves by 1.4 °/s: faster, back in time, than a bias drifts from pose to pose."""
    made, _ = recording(*TURNS * 5, noise=0.3, seed=seed)
    bias = 0.024 * np.exp(-made.time / 60.0)
    warm = Recording(made.time, made.accel, made.gyro + bias[:, None] / np.sqrt(3), "device")
    poses, cold = find_poses(warm), find_poses(made)
    assert len(poses) == len(cold) == 21
    # A part of the first rest, in which the rate changes most, may be left out.
    assert np.abs(poses.start[1:] - cold.start[1:]).max() < 50


@pytest.mark.parametrize("moment", [25.0, 25.8, 29.0, 60.0])
@pytest.mark.parametrize("size", [0.001, 0.01, 0.05])
def test_a_bias_that_steps_loses_no_rest(size: float, moment: float) -> None:
    """By less than it may drift, or by more than it ever does: a slow turn has no rate of its own
    through several poses. Within a rest and in a turn, in the middle and at an end."""
    made, _ = recording(*TURNS * 4, noise=0.3)
    bias = size * (made.time > moment)[:, None] * np.array([0.6, -0.8, 0.0])
    stepped = Recording(made.time, made.accel, made.gyro + bias, "device")
    poses, same = find_poses(stepped), find_poses(made)
    assert len(poses) == len(same) == 17
    assert np.abs(poses.start - same.start).max() <= 50
    assert np.abs(poses.stop - same.stop).max() <= 50


def test_a_bias_that_steps_back_loses_no_rest() -> None:
    made, _ = recording(*TURNS * 4, noise=0.3)
    there = (made.time > 30.0) & (made.time < 65.0)
    bias = there[:, None] * np.array([0.0, 0.02, 0.01])
    poses = find_poses(Recording(made.time, made.accel, made.gyro + bias, "device"))
    assert len(poses) == 17


@pytest.mark.parametrize("pose", [0, 1, 15, 16])
@pytest.mark.parametrize("size", [0.01, 0.05])
def test_a_bias_that_steps_beside_the_first_or_the_last_poses_loses_no_rest(
    size: float, pose: int
) -> None:
    """Nothing turns where gravity stays."""
    made, _ = recording(*TURNS * 4, noise=0.3)
    same = find_poses(made)
    moment = float(same.interval[pose, 1]) + 0.2
    if pose == 16:
        moment = float(same.interval[pose, 0]) - 0.2
    bias = size * (made.time > moment)[:, None] * np.array([0.6, -0.48, 0.64])
    poses = find_poses(Recording(made.time, made.accel, made.gyro + bias, "device"))
    assert len(poses) == len(same) == 17


def test_a_rate_that_only_two_poses_have_is_a_slow_turn() -> None:
    """A sensor that is turned about the vertical, slowly, and in one more pose again."""
    made, _ = recording(*TURNS * 4, noise=0.3)
    poses = find_poses(made)
    gyro = made.gyro.copy()
    for k in (7, 8):
        up = poses.accel[k] / np.linalg.norm(poses.accel[k])
        gyro[poses.start[k] : poses.stop[k]] += 0.02 * up
    assert len(find_poses(Recording(made.time, made.accel, gyro, "device"))) == 15


def test_a_table_that_turns_about_the_vertical_is_not_at_rest() -> None:
    """Gravity stays where it is, and every turn has a rate of its own: no bias steps so far."""
    rng = np.random.default_rng(8)
    rates = (0.087, -0.087, 0.5, -0.5, 0.9, -0.9, 1.5, -1.5)
    pieces = [piece for w in rates for piece in ((12.0, 0.0), (25.0, w))] + [(12.0, 0.0)]
    rate = np.concatenate([np.full(round(100 * length), w) for length, w in pieces])
    rate = np.convolve(np.pad(rate, 100, mode="edge"), np.full(201, 1 / 201), mode="valid")
    gyro = np.outer(rate, [0.0, 0.0, 1.0]) + rng.normal(0, 1e-4, (len(rate), 3))
    accel = np.array([0.0, 0.1, 9.8]) + rng.normal(0, 0.001, (len(rate), 3))
    # Mounted on another face, and turned there.
    turn = np.linspace(0.0, np.pi / 2, 200)
    over = 9.8 * np.stack((0 * turn, np.sin(turn), np.cos(turn)), axis=1)
    tipped = np.tile([np.pi / 4, 0.0, 0.0], (200, 1))
    recording = Recording(
        0.01 * np.arange(2 * len(rate) + 200),
        np.concatenate((accel, over, accel[:, [0, 2, 1]])),
        np.concatenate((gyro, tipped, gyro[:, [0, 2, 1]])),
        "device",
    )
    poses = find_poses(recording)
    assert len(poses) == 18
    assert np.abs(poses.gyro).max() < 0.01


@pytest.mark.parametrize("swayed", [0.3, 1.0])
@pytest.mark.parametrize("sway", [0.3, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_hand_that_sways_without_a_tremor_holds_still(
    seed: int, sway: float, swayed: float
) -> None:
    """Its rate is far above the gyroscope's noise, and hardly changes from block to block."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=20, temperature=None, sway=sway, swayed=swayed)
    poses = find_poses(simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0))
    rests = [s for s in motion.segments if s.kind == "static"]
    inside = [sum(s.start <= a and b <= s.stop for a, b in poses.interval) for s in rests]
    assert sum(inside) == len(poses)
    assert sum(n > 0 for n in inside) >= 17
    length = sum(s.stop - s.start for s in rests)
    assert np.diff(poses.interval, axis=1).sum() > 0.7 * length
