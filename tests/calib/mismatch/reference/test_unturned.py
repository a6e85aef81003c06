"""What turns about one axis do not tell: angles about it, and what is across it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.findings.diagnosis import Diagnosis
from calib.mismatch.reference.setup import LOOSE
from calib.mismatch.reference.unturned import ANY, UNTURNED, with_any_angle
from calib.mismatch.search.estimate import Estimate
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.rotation import mat_from_rotvec, quat_from_rotvec, quat_multiply, rotvec_from_mat
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.motions import pendulum
from calib.simulation.noise import CONSUMER
from calib.simulation.turntable import turntable
from calib.types import FloatArray

GRAVITY = 9.80665
ARM = {"rx": 0.01, "ry": 0.07, "rz": -0.01}


def askew(real: Recording, turn: FloatArray) -> Recording:
    """Return what a sensor reads that is turned by a rotation vector."""
    mat = mat_from_rotvec(turn)
    return replace(real, accel=real.accel @ mat.T, gyro=real.gyro @ mat.T)


def markers(motion: Motion, rng: np.random.Generator, rate: float = 120.0) -> ReferenceMotion:
    time = np.arange(1.0, motion.duration - 1.0, 1.0 / rate)
    turning, path = motion.kinematics(time)
    assert path is not None
    shake = quat_from_rotvec(rng.normal(0, np.radians(0.1), (len(time), 3)))
    position = path.position + rng.normal(0, 3e-4, (len(time), 3))
    return ReferenceMotion(time, quat_multiply(turning.quat, shake), position)


def off(found: Diagnosis, turn: FloatArray) -> FloatArray:
    """Return by how much the angles that were found are off, in their standard errors."""
    (item,) = (f for f in found.findings if f.effect == "reference_misalignment")
    value, sigma = np.array([(q.value, q.sigma) for q in item.parameters.values()]).T
    error = rotvec_from_mat(mat_from_rotvec(value) @ mat_from_rotvec(turn))
    return np.asarray(error / sigma)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.long
def test_a_sensor_that_swings_askew_has_no_misalignment_of_the_noise_of_markers(seed):
    rng = np.random.default_rng(seed)
    turn = rng.normal(0, 1.0, 3)
    motion = pendulum(length=0.4, amplitude=0.7, duration=70.0)
    triad = Triad(rng.normal(0, 0.1, 3), rng.normal(0, 0.006, 3))
    model = SensorModel(triad, terms=(Term("accel_lever_arm", ARM),))
    real = askew(simulate(motion, model, CONSUMER, rng=rng, rate=100.0), turn)
    found = diagnose_reference(real, markers(motion, rng), gravity=GRAVITY)
    named = {item.effect for item in found.findings}
    assert named <= {"time_offset", "reference_misalignment", "accel_lever_arm"}
    assert (np.abs(off(found, turn)) < 4.0).all()
    assert UNTURNED not in found.missing


@pytest.mark.long
def test_on_a_table_nobody_knows_how_a_sensor_is_turned_about_the_vertical():
    rng = np.random.default_rng(2)
    turn = np.array([0.3, -0.2, 2.4])
    motion = turntable([1.5, -3.0, 4.5, -1.5, 3.0, -4.5])
    real = askew(simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0), turn)
    found = diagnose_reference(real, markers(motion, rng), gravity=GRAVITY)
    assert UNTURNED in found.missing
    assert (np.abs(off(found, turn)) < 3.0).all()
    arms = [f for f in found.findings if f.effect == "accel_lever_arm"]
    # As far as that is not known, neither is where the sensor is: it is at the point that is seen.
    for q in (q for f in arms for q in f.parameters.values()):
        assert q.sigma is not None
        assert abs(q.value) < 3.0 * q.sigma
    assert not {f.effect for f in found.findings} & {"gyro_misalignment", "accel_size_effect"}


@pytest.mark.long
def test_how_another_imu_is_turned_is_known_no_better_than_its_axes():
    rng = np.random.default_rng(4)
    turn = np.array([0.4, -1.0, 0.2])
    motion = bench_protocol(rng, poses=12, first_pose=2.0, pose_duration=(2.0, 3.0))
    other = SensorModel(
        gyro=Triad.from_matrix(np.eye(3) + rng.normal(0, 0.01, (3, 3)), np.zeros(3))
    )
    real = askew(simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0), turn)
    seen = simulate(motion, other, CONSUMER, rng=rng, rate=90.0)
    found = diagnose_reference(real, seen, gravity=GRAVITY)
    assert (np.abs(off(found, turn)) < 3.0).all()


def test_an_angle_that_only_the_fit_holds_may_be_any():
    rng = np.random.default_rng(5)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    root = rng.normal(size=(5, 5)) * 1e-4
    covariance = root @ root.T
    # An angle about the axis, and a coefficient that follows it.
    along = np.concatenate(([0.7], axis, [0.0]))
    covariance += LOOSE["rx"] ** 2 * np.outer(along, along)
    fit = Estimate(np.zeros(5), covariance, (5,), {}, {}, {}, np.zeros(0), np.ones(5, bool))
    wide, any_angle = with_any_angle(fit, slice(1, 4), lambda _: 0.0)
    assert any_angle
    assert wide.covariance == pytest.approx(ANY**2 * np.outer(along, along), abs=1e-3)
    # Of what noise seems to tell nothing is known either, and what motion tells stays.
    told = replace(fit, covariance=covariance / 1e4)
    assert with_any_angle(told, slice(1, 4), lambda _: 1e5)[1]
    assert with_any_angle(told, slice(1, 4), lambda _: 1e3) == (told, False)
