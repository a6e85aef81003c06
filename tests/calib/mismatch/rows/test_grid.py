"""The grid knows at each point which rest the sensor is in, and how much it is shaken there."""

from dataclasses import replace

import numpy as np
import pytest

from calib.apply import correct_recording
from calib.calibration import Calibration, Gravity
from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.rows.grid import make_grid, steady, untouched
from calib.model import SensorModel
from calib.poses import average_poses
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from ..bench import GRAVITY
from ..bench import recording as plain

SHAKEN = 0.4


def shaken(*terms: Term):
    """Return the motion of a bench that is shaken in some rests, and its recording."""
    rng = np.random.default_rng(11)
    motion = bench_protocol(rng, poses=18, vibration=SHAKEN)
    model = SensorModel(terms=terms, reference_temperature=30.0)
    return motion, simulate(motion, model, CONSUMER, rng=rng, rate=100.0)


def calibration_of(term: Term) -> Calibration:
    model = SensorModel(terms=(term,), reference_temperature=30.0)
    return Calibration(model, (), np.zeros((0, 0)), (), Gravity(GRAVITY))


def test_near_is_the_rest_that_is_not_left_yet():
    motion, recording = shaken()
    grid = make_grid(recording, find_poses(recording))
    rate = np.linalg.norm(motion.state(grid.time).rate, axis=1)
    assert (rate[grid.near >= 0] < 0.1).all()
    assert (grid.near[rate > 0.3] == -1).all()
    pose = grid.pose
    np.testing.assert_array_equal(grid.near[pose >= 0], pose[pose >= 0])


def test_turns_are_where_the_sensor_moves_from_rest_to_rest():
    motion, real = shaken()
    grid = make_grid(real, find_poses(real))
    rate = np.linalg.norm(motion.state(grid.time).rate, axis=1)
    assert (rate[~grid.turning] < 0.1).all()
    assert grid.turning[rate > 0.3].all()
    assert not grid.turning[grid.pose >= 0].any()
    known = np.isfinite(grid.since_turn)
    np.testing.assert_array_equal(known, np.maximum.accumulate(known))
    assert known[grid.near > 0].all()
    assert grid.since_turn[known].min() >= 0


def test_vibration_is_that_of_the_rest_to_its_very_end():
    motion, recording = shaken()
    grid = make_grid(recording, find_poses(recording))
    # Points that lie whole in a rest: near one, and with no turn within a tenth of a second.
    true = [motion.state(grid.time + d).vibration[:, 0] for d in (-0.1, 0.0, 0.1)]
    inside = (grid.near >= 0) & (true[0] == true[1]) & (true[1] == true[2])
    assert (inside & (grid.pose < 0)).sum() > 20
    found, there = grid.vibration[inside], true[1][inside] > 0
    # Of a second, or half of one at a rest's end, a variance is known to 14 to 20 %.
    np.testing.assert_allclose(found[there] / SHAKEN**2, 1.0, atol=0.7)
    np.testing.assert_allclose(found[there].mean() / SHAKEN**2, 1.0, atol=0.05)
    quiet = found[~there]
    np.testing.assert_allclose(quiet, np.tile(quiet[0], (len(quiet), 1)), rtol=1e-9)
    noise = CONSUMER.accel_noise_density * np.sqrt(50.0)
    np.testing.assert_allclose(quiet[0], noise**2, rtol=0.1)


@pytest.mark.long
def test_rectified_vibration_is_named():
    _, recording = shaken(Term("accel_vibration_rectification", {"kx": 0.5, "ky": 0.0, "kz": 0.0}))
    diagnosis = diagnose_recording(recording, gravity=GRAVITY)
    (finding,) = diagnosis.findings
    assert finding.effect == "accel_vibration_rectification"
    found = finding.parameters["kx"]
    assert abs(found.value - 0.5) < 4 * found.sigma


def touched(axes: tuple[int, ...], *, seed: int = 3) -> Recording:
    """Return a recording whose last second is shaken about some axes: a hand stops it."""
    real = plain(seed=seed)
    last = real.time > real.time[-1] - 1.0
    gyro = real.gyro.copy()
    for axis in axes:
        gyro[last, axis] += 0.05 * np.sin(2 * np.pi * 3.0 * real.time[last] + axis) + 0.02
    return replace(real, gyro=gyro)


def test_a_hand_at_the_end_of_a_rest_is_no_rest():
    real = touched((0, 2))
    poses = find_poses(plain())
    cut = untouched(real, poses)
    np.testing.assert_array_equal(cut.start, poses.start)
    np.testing.assert_array_equal(cut.stop[:-1], poses.stop[:-1])
    assert real.time[-1] - 1.4 < cut.interval[-1, 1] < real.time[-1] - 0.9
    # What one axis alone has is no rotation by hand.
    assert untouched(touched((1,)), poses) is poses
    assert untouched(plain(), poses) is poses


@pytest.mark.parametrize(
    ("seconds", "axes", "kept"),
    [(1.5, (0, 2), False), (1.5, (0,), True), (8.0, (0, 2), True)],
    ids=["held", "one axis alone", "a long rest"],
)
def test_a_moment_of_a_turn_is_no_rest(seconds: float, axes: tuple[int, ...], kept: bool):
    """It turns by no more than it sways by, and several axes do."""
    rate, rng = 100.0, np.random.default_rng(5)
    start = 1000 * np.arange(6)
    stop = start + round(rate * seconds)
    gyro = 0.03 * rng.standard_normal((6000, 3))
    own = slice(start[3], stop[3])
    sway = 0.05 + 0.05 * np.sin(2 * np.pi * np.arange(stop[3] - start[3]) / rate / seconds)
    gyro[own, axes] += sway[:, None]
    accel = np.array([0.0, 0.0, GRAVITY]) + 0.01 * rng.standard_normal((6000, 3))
    # It turns about x, and gravity with it.
    accel[own, 1] += GRAVITY * np.cumsum(sway) / rate
    recording = Recording(np.arange(6000) / rate, accel, gyro, clock="device")
    poses = average_poses(recording, start, stop)
    left = steady(recording, poses)
    assert left.start.tolist() == [s for s in start.tolist() if kept or s != start[3]]


@pytest.mark.parametrize("seed", [3, 8])
@pytest.mark.long
def test_a_hand_at_the_end_of_a_recording_gets_no_name(seed):
    found = diagnose_recording(touched((0, 2), seed=seed), gravity=GRAVITY)
    assert not found.findings


@pytest.mark.long
@pytest.mark.parametrize(("rate", "tone"), [(100.0, 40.0), (200.0, 25.3)])
def test_what_a_tone_rectifies_is_found_in_its_size(rate: float, tone: float) -> None:
    """Second differences of samples would have 0.1 to 2.4 times the variance of these tones."""
    motion = bench_protocol(np.random.default_rng(41), poses=16, vibration=1.0)
    quiet = replace(motion, vibration=None)
    rng = np.random.default_rng(42)
    real = simulate(quiet, SensorModel(reference_temperature=30.0), CONSUMER, rng=rng, rate=rate)
    variance = motion.state(real.time).vibration
    wave = np.sqrt(2.0) * np.sin(2 * np.pi * tone * real.time[:, None] + np.arange(3))
    size = np.array([2e-4, 1e-4, -2e-4])
    real = replace(
        real,
        accel=real.accel + np.sqrt(variance) * wave,
        gyro=real.gyro + size * variance.sum(axis=1)[:, None],
    )
    (finding,) = diagnose_recording(real, gravity=GRAVITY).findings
    assert finding.effect == "gyro_vibration_rectification"
    for name, true in zip(("kx", "ky", "kz"), size, strict=True):
        found = finding.parameters[name]
        assert found.sigma < 0.15 * abs(true) + 1e-5
        assert abs(found.value - true) < 3.5 * found.sigma
    # And it is gone when it is corrected.
    left = diagnose_recording(
        correct_recording(calibration_of(finding.term()), real), gravity=GRAVITY
    )
    assert not left.findings


def one_noisy_pose(*, throughout: bool) -> tuple[Recording, int]:
    """Return a recording one pose of which is shaken: from end to end, or for half a second."""
    recording = plain(seed=31, poses=20)
    poses = find_poses(recording)
    a, b = int(poses.start[7]), int(poses.stop[7])
    own = slice(a, b) if throughout else slice((a + b) // 2, (a + b) // 2 + 50)
    accel, rng = recording.accel.copy(), np.random.default_rng(31)
    accel[own] += rng.normal(0, 0.4 if throughout else 2.0, accel[own].shape)
    return replace(recording, accel=accel), a


@pytest.mark.parametrize("throughout", [True, False])
def test_the_one_pose_that_a_machine_shakes_is_kept_and_one_that_is_knocked_is_not(
    throughout: bool,
) -> None:
    """It is all that there is to tell what vibration does."""
    recording, start = one_noisy_pose(throughout=throughout)
    poses = find_poses(recording)
    assert np.abs(poses.start - start).min() < 50
    kept = steady(recording, poses).start
    assert (np.abs(kept - start).min() < 50) == throughout


def test_rests_of_half_an_hour_are_cut_so_that_drift_shows_in_them():
    rng = np.random.default_rng(1)
    motion = bench_protocol(rng, poses=8, pose_duration=(1700.0, 1800.0))
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=2.0)
    start, stop = (
        np.searchsorted(real.time, [getattr(s, at) for s in motion.segments if s.kind == "static"])
        for at in ("start", "stop")
    )
    poses = average_poses(real, start + 1, stop - 1)
    grid = make_grid(real, poses)
    assert np.ptp(grid.interval[grid.is_rest], axis=1).max() < 150.0
    assert grid.is_rest.sum() > 10 * len(poses)
