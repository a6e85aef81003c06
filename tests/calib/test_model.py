"""The forward model and its inverse."""

import numpy as np
import pytest

from calib.effects.base import State, Term
from calib.model import SensorModel, Triad


def a_state(rng: np.random.Generator, n: int = 200) -> State:
    time = np.arange(n) / 100.0
    return State(time, rng.normal(0, 6, (n, 3)), rng.normal(0, 2, (n, 3)))


def a_model() -> SensorModel:
    lower = np.array([[0, 0, 0], [0.01, 0, 0], [0.02, 0.03, 0]])
    full = np.array([[0, 0.004, -0.01], [0.02, 0, 0.007], [-0.006, 0.003, 0]])
    return SensorModel(
        Triad(np.array([0.3, -0.6, 0.3]), np.array([0.1, -0.05, 0.2]), lower),
        Triad(np.array([0.02, -0.01, 0.03]), np.array([0.01, -0.02, 0.03]), full),
        (Term("gyro_g_sensitivity", {"gxx": 2e-4, "gyz": -1e-4}),),
    )


def test_correct_inverts_distort() -> None:
    state, model = a_state(np.random.default_rng(1)), a_model()
    measured = model.distort(state)
    true = model.correct(State(state.time, measured.accel, measured.gyro))
    np.testing.assert_allclose(true.accel, state.force, atol=1e-10)
    np.testing.assert_allclose(true.gyro, state.rate, atol=1e-10)


def test_forward_model_is_the_written_equation() -> None:
    state, model = a_state(np.random.default_rng(2), 1), a_model()
    a = model.accel
    expected = (np.eye(3) + np.diag(a.scale_factor_error) + a.misalignment) @ state.force[0]
    np.testing.assert_allclose(model.distort(state).accel[0], expected + a.bias, rtol=1e-14)


def test_g_sensitivity_adds_g_times_f() -> None:
    state = a_state(np.random.default_rng(3), 5)
    model = SensorModel(terms=(Term("gyro_g_sensitivity", {"gzx": 1e-3}),))
    gyro = model.distort(state).gyro - state.rate
    np.testing.assert_allclose(gyro[:, 2], 1e-3 * state.force[:, 0])
    assert not gyro[:, :2].any()


def test_triad_parameters_round_trip() -> None:
    triad = a_model().gyro
    again = Triad().with_parameters(triad.parameters("gyro"))
    np.testing.assert_array_equal(again.matrix, triad.matrix)
    np.testing.assert_array_equal(again.bias, triad.bias)


def test_triad_refuses_a_diagonal_misalignment() -> None:
    with pytest.raises(ValueError, match="`misalignment`"):
        Triad(misalignment=np.eye(3))


def test_a_lever_arm_is_felt_through_the_errors_of_the_sensor() -> None:
    state = a_state(np.random.default_rng(3))
    arm = Term("accel_lever_arm", {"rx": 0.1, "rz": -0.05})
    there = SensorModel(terms=(arm,)).felt(state)
    assert np.abs(there.force - state.force).max() > 0.01
    plain = SensorModel(accel=a_model().accel, gyro=a_model().gyro)
    model = SensorModel(accel=plain.accel, gyro=plain.gyro, terms=(arm,))
    measured = model.distort(state)
    assert np.allclose(measured.accel, plain.distort(there).accel)
    true = model.correct(State(state.time, measured.accel, measured.gyro))
    assert np.allclose(true.accel, state.force, atol=1e-9)
