"""Samples at rest beside a truth: what is motion of both is no disturbance of one."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_against, diagnose_reference
from calib.mismatch.hypotheses.places import joined
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.shaken import noise_beside
from calib.mismatch.samples.found import SPIKES
from calib.mismatch.samples.resting import look_at_rests
from calib.mismatch.samples.spectrum import LOUDER_THERE
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import Sampling, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses

GRAVITY = 9.80665
SHOWN = 30.0
"""What the other clock shows at the true time 0, s."""
SIGMA = CONSUMER.gyro_noise_density * np.sqrt(50.0)
"""White noise of one sample at 100 Hz."""


def pair(
    seed: int, *, rate: float, noise: NoiseModel, vibration: float = 0.0
) -> tuple[Recording, Recording]:
    """Return a recording and a truth of the same motion at another rate, on a clock of its own."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=16, pose_duration=(2.0, 3.0), vibration=vibration)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    sampling = Sampling(clock_offset=SHOWN)
    truth = simulate(motion, SensorModel(), noise, rng=rng, rate=rate, sampling=sampling)
    # It begins a little later and ends a little earlier.
    return real, truth.slice(50, len(truth) - 50)


def spiky(real: Recording) -> Recording:
    gyro, rng = real.gyro.copy(), np.random.default_rng(1)
    at = rng.choice(len(gyro), 30, replace=False)
    gyro[at, 1] += rng.choice([-1.0, 1.0], 30) * rng.uniform(50.0, 100.0, 30) * SIGMA
    return replace(real, gyro=gyro)


@pytest.mark.parametrize("rate", [40.0, 200.0])
@pytest.mark.parametrize("noise", [NoiseModel(), CONSUMER])
@pytest.mark.parametrize("seed", [1, 2])
def test_rests_that_shake_the_truth_as_well_have_no_disturbance(
    rate: float, noise: NoiseModel, seed: int
) -> None:
    real, truth = pair(seed, rate=rate, noise=noise, vibration=10.0)
    still = pair(seed, rate=rate, noise=noise)[1]
    same = Alignment(SHOWN, 0.0, 0.0)
    poses = find_poses(real)
    assert not noise_beside(real, poses, truth, same)
    # Beside one that does not move there, it is said.
    (said,) = {item.follows for item in noise_beside(real, poses, still, same)}
    assert said == LOUDER_THERE


@pytest.mark.parametrize("noise", [NoiseModel(), CONSUMER])
@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_hand_does_in_all_rests_is_motion_and_hides_nothing(
    noise: NoiseModel, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=20, pose_duration=(3.0, 5.0), hold_tremor=0.1)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    # It begins late, in the first rest.
    truth = simulate(motion, SensorModel(), noise, rng=rng, rate=80.0)
    truth = truth.slice(150, len(truth) - 100)
    same, poses = Alignment(0.0, 0.0, 0.0), find_poses(real)
    assert not noise_beside(real, poses, truth, same)
    line = 1.5 * SIGMA * np.sin(2 * np.pi * 31.0 * real.time)
    gyro = real.gyro + line[:, None] * [0.0, 1.0, 0.0]
    (found,) = noise_beside(replace(real, gyro=gyro), poses, truth, same)
    assert found.channels == ("gyro.y",)
    assert found.follows.startswith("a line at 31")


def test_what_shakes_all_axes_may_be_motion_that_markers_do_not_resolve() -> None:
    same = Alignment(0.0, 0.0, 0.0)
    shaken, _ = pair(1, rate=100.0, noise=CONSUMER, vibration=10.0)
    assert not noise_beside(shaken, find_poses(shaken), None, same)
    # One axis alone is not.
    real, _ = pair(1, rate=100.0, noise=CONSUMER)
    poses, accel = find_poses(real), real.accel.copy()
    part = slice(int(poses.start[4]), int(poses.stop[8]))
    more = 4.0 * CONSUMER.accel_noise_density * np.sqrt(50.0)
    accel[part, 2] += np.random.default_rng(2).normal(0.0, more, len(accel[part]))
    (found,) = joined(list(noise_beside(replace(real, accel=accel), poses, None, same)))
    assert found.channels == ("accel.z",)


@pytest.mark.long
def test_single_samples_off_course_are_said_beside_a_simulation_and_another_imu() -> None:
    real, simulation = pair(5, rate=80.0, noise=NoiseModel())
    other = pair(5, rate=80.0, noise=CONSUMER)[1]
    for found in (
        diagnose_against(spiky(real), simulation, gravity=GRAVITY),
        diagnose_reference(spiky(real), other, gravity=GRAVITY),
    ):
        (left,) = found.unexplained
        assert (left.follows, left.channels) == (SPIKES, ("gyro.y",))
    assert not diagnose_against(real, simulation, gravity=GRAVITY).unexplained


def test_what_shakes_all_axes_is_motion_though_one_is_loud_from_a_rest_before() -> None:
    real, _ = pair(1, rate=100.0, noise=NoiseModel())
    poses, rng = find_poses(real), np.random.default_rng(1)
    accel = real.accel.copy()
    for rest, axes, size in ((8, [0, 1, 2], 1.0), (7, [0], 0.05)):
        part = slice(poses.start[rest], poses.stop[rest])
        accel[part, axes] += rng.normal(0.0, size, accel[part, axes].shape)
    shaken = replace(real, accel=accel)
    poses = find_poses(shaken)
    same = Alignment(SHOWN, 0.0, 0.0)
    assert len({item.intervals for item in look_at_rests(shaken, poses)}) == 2
    assert not noise_beside(shaken, poses, None, same)
    # One axis alone is no motion.
    alone = accel.copy()
    alone[:, 1:] = real.accel[:, 1:]
    shaken = replace(real, accel=alone)
    said = noise_beside(shaken, find_poses(shaken), None, same)
    assert LOUDER_THERE in {item.follows for item in said}
    assert {item.channels for item in said} == {("accel.x",)}


def test_a_tremor_that_noise_of_the_truth_hides_part_of_is_no_line_and_a_hum_is_one() -> None:
    rng = np.random.default_rng(12)
    motion = bench_protocol(rng, poses=24, hold_tremor=0.1, gravity=GRAVITY)
    real, truth = (
        simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=rate) for rate in (200.0, 100.0)
    )
    same, poses = Alignment(0.0, 0.0, 0.0), find_poses(real)
    assert not noise_beside(real, poses, truth, same)
    hum = 1.5 * SIGMA * np.sin(2.0 * np.pi * 21.0 * real.time)
    (found,) = noise_beside(
        replace(real, gyro=real.gyro + np.stack((0 * hum, hum, 0 * hum), axis=1)),
        poses,
        truth,
        same,
    )
    assert found.follows == "a line at 21 Hz"
    assert found.channels == ("gyro.y",)
