"""The paper's own method: its convention, several revolutions, and what it cannot see."""

from dataclasses import replace

import numpy as np
import pytest
from gyro_motion import GRAVITY, Motion, Truth, simulate

from calib.fit import Fit
from calib.model import SensorModel, Triad
from calib.simulate import simulate as simulate_sensor
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.solvers import gyro_solvers
from calib.statics import find_poses
from calib.turns import find_turns

GYRO = Triad([0.03, -0.06, 0.03], [0.1, -0.05, 0.2])
Q = np.pi / 2


def run(turns: list[list[float]], **noise: float) -> tuple[Fit, Truth]:
    truth = simulate(
        Motion(np.array(turns), rate=50.0), GYRO, rng=np.random.default_rng(2), **noise
    )
    fit = gyro_solvers()["rotation_segment"].solve(
        truth.recording,
        truth.poses,
        find_turns(truth.recording, truth.poses),
        Triad(),
        gravity=GRAVITY,
        options={},
    )
    return fit, truth


def test_the_scale_factor_is_the_one_that_multiplies_the_rate() -> None:
    # The paper's equation 13 would give 1 / 1.1 here.
    fit, _ = run([[Q, 0, 0], [-Q, 0, 0], [Q, 0, 0], [Q, 0, 0]], gyro_noise=1e-6, accel_noise=1e-6)
    np.testing.assert_allclose(fit.triad.scale_factor_error[0], 0.1, atol=1e-4)
    np.testing.assert_allclose(fit.triad.bias[0], 0.03, atol=1e-4)


def test_several_revolutions_are_counted() -> None:
    fit, _ = run([[5 * Q, 0, 0], [-9 * Q, 0, 0], [17 * Q, 0, 0], [-Q, 0, 0]])
    assert abs(fit.triad.scale_factor_error[0] - 0.1) < 1e-3


def test_an_axis_that_was_vertical_is_named_and_the_others_are_returned() -> None:
    turns = [[Q, 0, 0], [-Q, 0, 0], [0, Q, 0], [0, -Q, 0], [0, 0, Q], [0, 0, -Q]] * 2
    fit, _ = run(turns)
    assert fit.undetermined == ("gyro.scale_factor_error.z",)
    assert len(fit.advice) == 1
    assert "axis z was vertical" in fit.advice[0]
    assert "remount" in fit.advice[0]
    assert abs(fit.triad.scale_factor_error[1] + 0.05) < 5 * fit.standard_errors[4]
    assert fit.triad.scale_factor_error[2] == 0.0


def test_one_segment_and_the_bias_at_rest_give_the_scale() -> None:
    fit, _ = run([[Q, 0, 0]])
    assert "gyro.scale_factor_error.x" not in fit.undetermined
    assert abs(fit.triad.scale_factor_error[0] - 0.1) < 5 * fit.standard_errors[3]


def test_turns_about_two_axes_are_not_read_as_one() -> None:
    fit, _ = run([[Q, Q, 0], [-Q, -Q, 0]] * 3)
    assert "gyro.scale_factor_error.x" in fit.undetermined
    assert "no turn was about axis x alone" in fit.advice[0]


def test_an_accelerometer_that_sees_no_turn_gives_no_factor() -> None:
    _, truth = run([[Q, 0, 0], [-Q, 0, 0]] * 3)
    still = replace(truth.poses, accel=np.tile(truth.poses.accel[:1], (len(truth.poses), 1)))
    fit = gyro_solvers()["rotation_segment"].solve(
        truth.recording,
        still,
        find_turns(truth.recording, still),
        Triad(),
        gravity=GRAVITY,
        options={},
    )
    assert "gyro.scale_factor_error.x" in fit.undetermined


@pytest.mark.parametrize("seed", range(6))
def test_errors_are_as_large_as_said_where_turns_are_made_by_hand(seed: int) -> None:
    # A hand turns about no axis alone, and a drift is in every rest: 0.3 says what chi-square with
    # six degrees of freedom does in one recording of a hundred, 17 the same on the other side.
    rng = np.random.default_rng(seed)
    model = SensorModel(Triad(), GYRO)
    motion = bench_protocol(rng, poses=20, pose_duration=(2.0, 4.0))
    recording = simulate_sensor(motion, model, CONSUMER, rng=rng, rate=100.0)
    poses = find_poses(recording)
    fit = gyro_solvers()["rotation_segment"].solve(
        recording, poses, find_turns(recording, poses), Triad(), gravity=GRAVITY, options={}
    )
    known = np.isfinite(np.diag(fit.covariance))
    error = (fit.values - np.concatenate([GYRO.bias, GYRO.scale_factor_error]))[known]
    square = error @ np.linalg.solve(fit.covariance[np.ix_(known, known)], error)
    assert 0.3 < square * 6 / known.sum() < 17.0
