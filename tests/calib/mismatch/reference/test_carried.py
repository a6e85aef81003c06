"""What an arm carries of another gyroscope's errors, against the kinematics it is made of."""

import numpy as np
import pytest

from calib.effects.base import State, Term
from calib.mismatch.reference.carried import NAMES, arm_of, carried, rough_arm, true_force
from calib.model import SensorModel

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
