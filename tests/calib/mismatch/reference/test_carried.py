"""What an arm carries of another gyroscope's errors, against the kinematics it is made of."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import State, Term
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.carried import (
    NAMES,
    SIZES,
    UNSETTLED,
    arm_of,
    carried,
    known_errors,
    rough_arm,
    settled,
    simulated_errors,
    true_force,
)
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel, Triad
from calib.rotation import mat_from_rotvec
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER, NoiseModel

ARM = np.array([0.2, -0.1, 0.05])


def state() -> State:
    rng = np.random.default_rng(1)
    rate, slope, force = rng.normal(0, [[[3.0]], [[20.0]], [[9.8]]], (3, 50, 3))
    return State(np.arange(50) / 50.0, force, rate, angular_acceleration=slope)


@pytest.mark.parametrize("which", range(len(NAMES)))
def test_columns_are_the_derivatives_of_the_force(which):
    errors = np.zeros(len(NAMES))
    errors[which] = 1e-6
    known = np.random.default_rng(3).normal(0, 0.01, len(NAMES))
    change = (true_force(state(), ARM, known + errors) - true_force(state(), ARM, known)) / 1e-6
    column = carried(state(), ARM, known)[which]
    expected = np.stack([column.get(f"accel.{a}", np.zeros(50)) for a in "xyz"], axis=1)
    np.testing.assert_allclose(change, expected, atol=2e-4)


def test_a_rate_without_its_errors_makes_the_force_that_is_felt():
    rng = np.random.default_rng(2)
    bias, matrix = rng.normal(0, 0.01, 3), rng.normal(0, 0.01, (3, 3))
    true = state()
    # measured = w + e, e = b + E measured
    inverse = np.linalg.inv(np.eye(3) - matrix)
    measured = State(
        true.time,
        true.force,
        (true.rate + bias) @ inverse.T,
        angular_acceleration=true.rate_dot @ inverse.T,
    )
    errors = np.concatenate((bias, matrix.ravel(), np.zeros(6)))
    force = true_force(measured, ARM, errors)
    np.testing.assert_allclose(force + measured.gradient @ ARM, true.force + true.gradient @ ARM)


def test_what_an_arm_makes_is_no_part_of_what_the_other_one_reads_too_large():
    true = state()
    scale = np.array([[0.03, 0.0, 0.0], [0.01, -0.02, 0.0], [-0.02, 0.015, 0.01]])
    measured = replace(true, force=true.force + true.force @ scale.T)
    order = [(0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1)]
    errors = np.array([*np.zeros(12), *(scale[at] for at in order)])
    felt = true_force(measured, ARM, errors) + true.gradient @ ARM
    # What is too large is so for all of it: the sensor's own matrix takes it out again.
    inverse = np.linalg.inv(np.eye(3) + scale)
    np.testing.assert_allclose(felt @ inverse.T, true.force + true.gradient @ ARM)


def test_an_arm_is_roughly_known_from_what_it_leaves_and_a_short_one_is_none():
    left = state().gradient @ ARM + [0.3, -0.2, 0.1]
    np.testing.assert_allclose(rough_arm(state(), left), ARM)
    assert not rough_arm(state(), left * 0.01).any()


def test_the_arm_of_a_model():
    terms = (
        Term("accel_lever_arm", {"rx": 0.1, "rz": -0.2}),
        Term("accel_quadratic", {"kx": 1e-4}),
    )
    np.testing.assert_array_equal(arm_of(SensorModel(terms=terms)), [0.1, 0.0, -0.2])
    assert not arm_of(SensorModel()).any()


def test_what_it_reads_at_rest_is_taken_off_and_open_where_it_never_rests():
    rng = np.random.default_rng(3)
    motion = bench_protocol(rng, poses=4, first_pose=2.0, pose_duration=(2.0, 3.0))
    bias = np.array([0.1, -0.2, 0.05])
    sensor = SensorModel(gyro=Triad(bias))
    real, other = (
        simulate(motion, model, CONSUMER, rng=rng, rate=50.0) for model in (SensorModel(), sensor)
    )
    np.testing.assert_allclose(other.gyro - settled(other).gyro, [bias] * len(other), atol=2e-3)
    moving = (other.time > 2.0) & (np.linalg.norm(other.gyro - bias, axis=1) > 0.3)
    turn = np.flatnonzero(moving)[0]
    restless = other.slice(turn, turn + 30)
    assert settled(restless) is restless
    errors, sizes = known_errors(restless, np.eye(3), gravity=9.80665)
    np.testing.assert_array_equal(errors, 0.0)
    np.testing.assert_array_equal(sizes, [*[UNSETTLED] * 3, *SIZES[3:]])
    known = known_errors(settled(other), np.eye(3), gravity=9.80665)
    truth = RecordingTruth(settled(other), 9.80665)
    problem = ComparisonProblem(
        real, truth, Alignment(0.0, 0.0, 1.0), gravity=9.80665, mat_sr=np.eye(3), other=known
    )
    own = [n.startswith(("reference_gyro", "reference_accel")) for n in problem.aligned]
    np.testing.assert_array_equal(problem.loose[len(problem.names) :][own], known[1])
    np.testing.assert_allclose(problem.setup.errors, known[0], atol=1e-12)
    place, stood = problem.place(), problem.moved
    for _ in range(2):
        problem.move(dict.fromkeys(problem.names, 0.1), np.full(len(problem.aligned), 0.2), ())
        assert not np.allclose(problem.moved, stood)
        problem.go_back(place)
        np.testing.assert_array_equal(problem.moved, stood)


def test_what_its_own_rests_and_turns_tell_of_another_imu():
    rng = np.random.default_rng(5)
    motion = bench_protocol(rng, poses=25, first_pose=2.0, pose_duration=(2.0, 3.0))
    gyro, accel = rng.normal(0, 0.01, (3, 3)), np.tril(rng.normal(0, 0.01, (3, 3)))
    sensor = SensorModel(
        accel=Triad.from_matrix(np.eye(3) + accel, np.zeros(3)),
        gyro=Triad.from_matrix(np.eye(3) + gyro, np.zeros(3)),
    )
    other = simulate(motion, sensor, CONSUMER, rng=rng, rate=100.0)
    # The other one lies turned by (0.5, -1, 2) rad: what it reads, in the frame beside it.
    mat = mat_from_rotvec(np.array([0.5, -1.0, 2.0]))
    errors, sizes = known_errors(settled(other), mat, gravity=9.80665)
    arm = mat @ ARM
    true = state()
    turned = replace(
        true,
        force=true.force @ mat.T,
        rate=true.rate @ mat.T,
        angular_acceleration=true.rate_dot @ mat.T,
    )
    measured = replace(
        turned,
        force=true.force @ (np.eye(3) + accel).T @ mat.T,
        rate=true.rate @ (np.eye(3) + gyro).T @ mat.T,
        angular_acceleration=true.rate_dot @ (np.eye(3) + gyro).T @ mat.T,
    )
    # The frame in which its accelerometer's matrix is a lower triangle is turned a little, too.
    upper = np.triu(mat @ accel @ mat.T, 1)
    arm_there = arm + (upper - upper.T) @ arm
    felt = true_force(measured, arm_there, errors) + measured.gradient @ arm_there
    expected = measured.force + (turned.gradient @ arm) @ (mat @ (np.eye(3) + accel) @ mat.T).T
    without = measured.force + measured.gradient @ arm
    size = np.linalg.norm(turned.gradient @ arm)
    assert np.linalg.norm(without - expected) > 0.01 * size
    assert np.linalg.norm(felt - expected) < 0.003 * size
    assert (sizes[3:] < 0.6 * SIZES[3:]).all()


def test_what_a_simulated_sensor_gets_wrong_is_what_its_rests_and_turns_tell():
    rng = np.random.default_rng(6)
    motion = bench_protocol(rng, poses=14, first_pose=2.0, pose_duration=(2.0, 3.0))
    gyro = Triad(np.array([0.01, -0.02, 0.005]), np.array([0.01, -0.015, 0.008]))
    wrong = SensorModel(Triad(scale_factor_error=np.array([0.02, -0.01, 0.0])), gyro)
    quiet = NoiseModel()
    other = simulate(motion, wrong, quiet, rng=rng, rate=100.0)
    found = simulated_errors(other, np.eye(3), gravity=9.80665)
    assert found is not None
    errors, spread = found
    np.testing.assert_allclose(errors[:3], gyro.bias, atol=1e-6)
    # E of the measured rate: S / (1 + S).
    of_gyro = [3, 7, 11]
    expected = gyro.scale_factor_error / (1.0 + gyro.scale_factor_error)
    np.testing.assert_allclose(errors[of_gyro], expected, rtol=0.1, atol=5e-4)
    np.testing.assert_allclose(errors[12:15], wrong.accel.scale_factor_error, rtol=0.1, atol=5e-4)
    assert (spread[3:] < 0.01).all()
    perfect = simulate(motion, SensorModel(), quiet, rng=rng, rate=100.0)
    assert simulated_errors(perfect, np.eye(3), gravity=9.80665) is None
