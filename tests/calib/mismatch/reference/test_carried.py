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
    expected,
    rough_arm,
    true_force,
)
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel, Triad
from calib.rotation import mat_from_rotvec
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

ARM = np.array([0.2, -0.1, 0.05])


def state() -> State:
    rng = np.random.default_rng(1)
    rate, slope, force = rng.normal(0, [[[3.0]], [[20.0]], [[9.8]]], (3, 50, 3))
    return State(np.arange(50) / 50.0, force, rate, angular_acceleration=slope)


@pytest.mark.parametrize("which", range(len(NAMES)))
def test_columns_are_the_derivatives_of_the_force(which):
    errors = np.zeros(len(NAMES))
    errors[which] = 1e-6
    change = (true_force(state(), ARM, errors) - state().force) / 1e-6
    column = carried(state(), ARM)[which]
    expected = np.stack([column[f"accel.{a}"] for a in "xyz"], axis=1)
    np.testing.assert_allclose(change, expected, atol=1e-4)


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
    force = true_force(measured, ARM, np.concatenate((bias, matrix.ravel())))
    np.testing.assert_allclose(force + measured.gradient @ ARM, true.force + true.gradient @ ARM)


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


def test_what_it_reads_at_rest_is_known_where_it_rests_and_open_where_it_never_does():
    rng = np.random.default_rng(3)
    motion = bench_protocol(rng, poses=4, first_pose=2.0, pose_duration=(2.0, 3.0))
    bias = np.array([0.1, -0.2, 0.05])
    sensor = SensorModel(gyro=Triad(bias))
    real, other = (
        simulate(motion, model, CONSUMER, rng=rng, rate=50.0) for model in (SensorModel(), sensor)
    )
    moving = (other.time > 2.0) & (np.linalg.norm(other.gyro - bias, axis=1) > 0.3)
    turn = np.flatnonzero(moving)[0]
    errors, loose = expected(other.slice(turn, turn + 30), np.eye(3))
    assert not errors.any()
    np.testing.assert_array_equal(loose, [*[UNSETTLED] * 3, *SIZES[3:]])
    mat = mat_from_rotvec(np.array([0.0, 0.0, 0.5]))
    truth = RecordingTruth(replace(other, accel=other.accel @ mat, gyro=other.gyro @ mat), 9.80665)
    problem = ComparisonProblem(real, truth, Alignment(0.0, 0.0, 1.0), gravity=9.80665, mat_sr=mat)
    np.testing.assert_allclose(problem.setup.errors[:3], bias, atol=2e-3)
    own = [n.startswith("reference_gyro") for n in problem.aligned]
    np.testing.assert_array_equal(problem.loose[len(problem.names) :][own], SIZES)
