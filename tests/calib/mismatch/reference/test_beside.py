"""The motion of a reference in the time and the frame of a recording."""

import numpy as np
import pytest

from calib.effects.base import Term
from calib.errors import NoCommonMotionError
from calib.mismatch import ReferenceMotion
from calib.mismatch.reference.beside import motion_beside, without_alignment
from calib.model import SensorModel, Triad
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import Sampling, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665


@pytest.mark.parametrize("inverse", [False, True])
def test_it_is_the_motion_that_the_sensor_felt(inverse):
    rng = np.random.default_rng(21)
    motion = bench_protocol(rng, poses=8, first_pose=1.0, pose_duration=(2.0, 3.0), tremor=0.3)
    errors = Triad(np.array([0.02, -0.01, 0.01]), np.array([0.01, -0.01, 0.005]))
    model = SensorModel(Triad(np.array([0.1, -0.1, 0.2])), errors)
    sampling = Sampling(clock_offset=40.0)
    real = simulate(motion, model, CONSUMER, rng=rng, rate=80.0, sampling=sampling)
    time = np.arange(1.0, motion.duration - 2.0, 1 / 120.0)
    turning, path = motion.kinematics(time)
    assert path is not None
    # The reference's body is turned against the sensor, and its clock starts elsewhere.
    quat = quat_multiply(turning.quat, quat_from_rotvec(np.array([0.1, -0.2, 1.0])))
    reference = ReferenceMotion(time + 7.0, quat, path.position)
    found = motion_beside(real, reference.inverted() if inverse else reference, gravity=GRAVITY)
    assert found.bandwidth is None
    assert found.part.time[0] == pytest.approx(41.0, abs=0.02)
    assert found.part.time[-1] == pytest.approx(motion.duration + 38.0, abs=0.02)
    inner = found.part.time[20:-20]
    seen, true = found.motion.state(inner - found.part.time[0]), motion.state(inner - 40.0)
    # Small beside the noise of one sample (0.028 m/s², 6e-4 rad/s) where it is at rest; the frame
    # is known to 0.3 mrad and the time to a tenth of a millisecond.
    assert np.sqrt(np.mean((seen.force - true.force) ** 2)) < 0.02
    assert np.sqrt(np.mean((seen.rate - true.rate) ** 2)) < 2e-3


def test_another_motion_is_an_error():
    rng = np.random.default_rng(22)
    real, other = (bench_protocol(rng, poses=6) for _ in range(2))
    recording = simulate(real, SensorModel(), CONSUMER, rng=rng, rate=50.0)
    time = np.arange(0.0, other.duration, 0.02)
    turning, path = other.kinematics(time)
    assert path is not None
    with pytest.raises(NoCommonMotionError):
        motion_beside(
            recording, ReferenceMotion(time, turning.quat, path.position), gravity=GRAVITY
        )


def test_what_lies_beside_a_reference_is_not_the_sensors():
    terms = (
        Term("time_offset", {"delay": 0.01, "gyro_delay": 2e-3}),
        Term("clock_scale", {"scale": 1e-4}),
        Term("reference_misalignment", {"rx": 0.01}),
        Term("accel_lever_arm", {"rx": 0.02}),
    )
    assert without_alignment(terms) == (
        Term("time_offset", {"gyro_delay": 2e-3}),
        Term("accel_lever_arm", {"rx": 0.02}),
    )
