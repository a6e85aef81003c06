"""The motion of a recording, found again from what a sensor saw of it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.errors import InsufficientMotionError
from calib.model import SensorModel, Triad
from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.simulate import digital_twin, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion, Segment
from calib.simulation.motions import pendulum
from calib.simulation.noise import NoiseModel, noise_at_rest
from calib.simulation.recorded import motion_of
from calib.statics import find_poses

G = 9.80665
MODEL = SensorModel(
    Triad(np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03])),
    Triad(np.array([0.02, -0.01, 0.03]), np.array([0.01, -0.02, 0.03])),
    (Term("gyro_g_sensitivity", {"gxx": 2e-4}),),
)
NOISE = NoiseModel(accel_noise_density=4e-3, gyro_noise_density=1e-4, gyro_bias_instability=5e-5)


def recorded(seed: int, poses: int = 10, rate: float = 100.0) -> tuple[Motion, Recording, Poses]:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=poses, tremor=0.5)
    recording = simulate(motion, MODEL, NOISE, rng=rng, rate=rate)
    return motion, recording, find_poses(recording)


def tilt(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angle between the directions of up of two orientations, rad."""
    return np.linalg.norm(first[:, 2] - second[:, 2], axis=1)


def test_a_single_sample_is_no_motion() -> None:
    _, recording, _ = recorded(1)
    one = recording.slice(0, 1)
    with pytest.raises(InsufficientMotionError, match="1 sample: no motion"):
        motion_of(one, MODEL, find_poses(one), gravity=G)


def test_orientation_and_force_are_found_again() -> None:
    motion, recording, poses = recorded(1)
    found = motion_of(recording, MODEL, poses, gravity=G).state(recording.time)
    true = motion.state(recording.time)
    assert np.degrees(tilt(found.mat_ns, true.mat_ns)).max() < 0.05
    for name, level in (("rate", 1e-4 * np.sqrt(50)), ("force", 4e-3 * np.sqrt(50))):
        error = getattr(found, name) - getattr(true, name)
        assert np.sqrt(np.mean(error**2)) < level


def test_at_rest_the_found_motion_rests() -> None:
    _, recording, poses = recorded(2)
    motion = motion_of(recording, MODEL, poses, gravity=G)
    assert len(motion.statics) == len(poses) == 10
    assert len(motion.turns) == 9
    for start, stop in motion.statics:
        state = motion.state(np.linspace(start + 0.05, stop - 0.05, 20))
        assert np.abs(state.rate).max() < 1e-4
        np.testing.assert_allclose(np.linalg.norm(state.force, axis=1), G, rtol=1e-5)


def test_a_noisy_model_still_closes_at_every_pose() -> None:
    """With a scale factor that is 3 % off, roll and pitch at rest are still gravity's."""
    motion, recording, poses = recorded(3)
    wrong = SensorModel(MODEL.accel, Triad(MODEL.gyro.bias), MODEL.terms)
    found = motion_of(recording, wrong, poses, gravity=G).state(recording.time)
    true = motion.state(recording.time)
    rest = np.concatenate([np.arange(a, b) for a, b in zip(poses.start, poses.stop, strict=True)])
    assert np.degrees(tilt(found.mat_ns[rest], true.mat_ns[rest])).max() < 0.05


def test_a_twin_looks_like_its_recording() -> None:
    _, recording, poses = recorded(4)
    motion = motion_of(recording, MODEL, poses, gravity=G)
    quiet = digital_twin(recording, motion, MODEL, NoiseModel(), rng=np.random.default_rng(0))
    np.testing.assert_array_equal(quiet.time, recording.time)
    assert quiet.device == recording.device
    for name, density in (("accel", 4e-3), ("gyro", 1e-4)):
        left = getattr(recording, name) - getattr(quiet, name)
        assert np.sqrt(np.mean(left**2)) < 1.5 * density * np.sqrt(50)


def test_a_twin_has_the_clock_and_the_gaps_of_its_recording() -> None:
    _, recording, poses = recorded(5)
    cut = Recording(
        np.delete(recording.time, np.s_[3000:3010]) + 1e5,
        np.delete(recording.accel, np.s_[3000:3010], axis=0),
        np.delete(recording.gyro, np.s_[3000:3010], axis=0),
        "host",
        lost=np.where(np.arange(len(recording) - 10) == 3000, 10, 0),
    )
    poses = find_poses(cut)
    motion = motion_of(cut, MODEL, poses, gravity=G)
    twin = digital_twin(cut, motion, MODEL, NOISE, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(twin.time, cut.time)
    np.testing.assert_array_equal(twin.lost, cut.lost)
    assert twin.clock == "host"


def test_a_twin_has_no_samples_where_its_motion_is_hidden() -> None:
    _, recording, poses = recorded(5)
    lost = np.zeros(len(recording), int)
    lost[[400, 1000, 1500]] = 3, 5, 7
    recording = replace(recording, lost=lost, time=recording.time + 100.0)
    motion = motion_of(recording, MODEL, poses, gravity=G)
    motion = replace(motion, segments=(*motion.segments, Segment("hidden", 9.495, 12.005)))
    twin = digital_twin(recording, motion, MODEL, NOISE, rng=np.random.default_rng(0))
    kept = np.concatenate((np.arange(950), np.arange(1201, len(recording))))
    np.testing.assert_array_equal(twin.time, recording.time[kept])
    assert np.flatnonzero(twin.lost).tolist() == [400, 950, 950 + 299]
    assert twin.lost[[400, 950, 950 + 299]].tolist() == [3, 251 + 5, 7]


def test_a_recording_without_poses_has_a_motion() -> None:
    rng = np.random.default_rng(6)
    recording = simulate(pendulum(hold=0.0, duration=20.0), MODEL, NOISE, rng=rng, rate=100.0)
    poses = average_poses(recording, np.zeros(0, np.int64), np.zeros(0, np.int64))
    motion = motion_of(recording, MODEL, poses, gravity=G)
    assert not motion.segments
    left = motion.state(recording.time).rate - MODEL.gyro.correct(recording.gyro)
    assert np.sqrt(np.mean(left**2)) < 3e-3


def test_white_noise_at_rest_is_measured() -> None:
    _, recording, poses = recorded(9)
    found = noise_at_rest(recording, poses)
    assert found.accel_noise_density == pytest.approx(4e-3, rel=0.03)
    assert found.gyro_noise_density == pytest.approx(1e-4, rel=0.03)
    assert noise_at_rest(recording, poses.select(np.zeros(0, int))) == NoiseModel()


def test_angular_acceleration_is_not_lost_between_samples() -> None:
    """A cubic spline was off by 9 % of it."""
    rng = np.random.default_rng(11)
    motion = bench_protocol(rng, poses=6, first_pose=1.0, tremor=0.5)
    recording = simulate(motion, MODEL, NoiseModel(), rng=rng, rate=50.0)
    found = motion_of(recording, MODEL, find_poses(recording), gravity=G).state(recording.time)
    true = motion.state(recording.time).angular_acceleration
    assert found.angular_acceleration is not None
    assert true is not None
    error = found.angular_acceleration - true
    assert np.sqrt(np.mean(error**2) / np.mean(true**2)) < 0.02


def test_no_motion_runs_free_in_a_gap_of_the_recording() -> None:
    motion, recording, _ = recorded(12)
    (start, stop), *_ = motion.turns
    middle = 0.5 * (start + stop)
    cut = recording.select((recording.time < middle) | (recording.time > middle + 0.4))
    found = motion_of(cut, MODEL, find_poses(cut), gravity=G)
    state = found.state(np.arange(middle, middle + 0.4, 1e-3))
    assert np.linalg.norm(state.force, axis=1).max() < 2 * G
    assert (
        np.linalg.norm(state.rate, axis=1).max() < 2 * np.linalg.norm(recording.gyro, axis=1).max()
    )
