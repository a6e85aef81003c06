"""Every gyroscope method of the registry: truth recovered, errors honest, bad poses found."""

import numpy as np
import pytest
from gyro_motion import GRAVITY, Motion, Truth, noisy, simulate

from calib.fit import Fit
from calib.model import Triad
from calib.rotation import mat_from_rotvec
from calib.solvers import gyro_solvers
from calib.turns import find_turns

GYRO = Triad([0.3, -0.6, 0.3], [0.1, -0.05, 0.2])
METHODS = sorted(gyro_solvers())
ANGLE = np.pi / 2


def spins() -> np.ndarray:
    """Return 30 quarter turns, ten about each axis, each about an axis that is level then."""
    rng, left, mat, turns = np.random.default_rng(4), np.repeat(np.arange(3), 10), np.eye(3), []
    while len(left):
        level = [i for i in left if abs(mat[2, i]) < 0.1]
        if not level:  # only an axis that stands upright is left: begin again
            left, mat, turns = np.repeat(np.arange(3), 10), np.eye(3), []
            continue
        axis = rng.choice(level)
        turns.append(rng.choice([-1, 1]) * ANGLE * np.eye(3)[axis])
        mat = mat @ mat_from_rotvec(turns[-1])
        left = np.delete(left, np.flatnonzero(left == axis)[0])
    return np.array(turns)


CLEAN = simulate(
    Motion(spins(), rest=2.0, rate=40.0, ramp=0.1),
    GYRO,
    rng=np.random.default_rng(0),
    gyro_noise=0.0,
    accel_noise=0.0,
)
RATE = ANGLE / 1.8
"""Of the plateau: half of each ramp's 10 % is lost."""


def solve(method: str, truth: Truth) -> Fit:
    turns = find_turns(truth.recording, truth.poses)
    return gyro_solvers()[method].solve(
        truth.recording,
        truth.poses,
        turns,
        Triad(),
        gravity=GRAVITY,
        options={"table_rate": RATE * np.ones(len(turns))},
    )


@pytest.mark.parametrize("method", METHODS)
def test_truth_is_recovered_with_honest_errors_and_nothing_is_lost(method: str) -> None:
    truth = np.array(list(GYRO.parameters("gyro").values()))
    nees, left_out = [], 0
    for seed in range(30):
        fit = solve(
            method,
            noisy(CLEAN, rng=np.random.default_rng(seed), gyro_noise=0.005, accel_noise=0.02),
        )
        assert not fit.undetermined
        error = fit.values - truth[: len(fit.values)]
        left_out += bool(fit.excluded)
        nees.append(error @ np.linalg.solve(fit.covariance, error) / len(error))
        assert fit.method == method
        assert fit.residual_unit == "rad"
        assert len(fit.residuals) == len(fit.intervals)
    # A mean of 30 chi-squares with 6 degrees of freedom, over 6, is 1 +- 0.11; an inflation that
    # cannot be negative, and is estimated from few segments, makes it somewhat smaller.
    assert 0.65 < np.mean(nees) < 1.3
    # Three tests at 1 % a recording: 30 recordings make 0.9; six or more has a chance of 3e-4.
    assert left_out < 6


@pytest.mark.parametrize("method", METHODS)
def test_data_without_noise_is_solved_and_nothing_is_left_out(method: str) -> None:
    fit = solve(
        method, noisy(CLEAN, rng=np.random.default_rng(0), gyro_noise=1e-7, accel_noise=1e-7)
    )
    truth = np.array(list(GYRO.parameters("gyro").values()))
    np.testing.assert_allclose(fit.values, truth[: len(fit.values)], atol=3e-5)
    assert not fit.excluded


@pytest.mark.parametrize("method", METHODS)
def test_a_turn_that_was_disturbed_is_found_by_time(method: str) -> None:
    truth = noisy(CLEAN, rng=np.random.default_rng(3), gyro_noise=0.005, accel_noise=0.02)
    turns = find_turns(truth.recording, truth.poses)
    k = 7
    gyro = truth.recording.gyro.copy()
    inside = slice(turns.start[k] + 20, turns.stop[k] - 20)
    gyro[inside] += 0.3 * np.sign(spins()[k])
    object.__setattr__(truth.recording, "gyro", gyro)
    fit = solve(method, truth)
    low, high = turns.interval[k]
    found = [low <= e.interval[0] < e.interval[1] <= high for e in fit.excluded]
    assert sum(found) == 1
    assert len(found) <= 2  # one recording in a hundred loses a good turn as well
    good = np.array(list(GYRO.parameters("gyro").values()))[: len(fit.values)]
    assert (np.abs(fit.values - good) < 5 * fit.standard_errors).all()


@pytest.mark.parametrize("method", METHODS)
def test_no_pose_is_refused(method: str) -> None:
    from calib.errors import InsufficientMotionError
    from calib.poses import average_poses

    none = np.zeros(0, np.int64)
    poses = average_poses(CLEAN.recording, none, none)
    turns = find_turns(CLEAN.recording, poses)
    with pytest.raises(InsufficientMotionError):
        gyro_solvers()[method].solve(
            CLEAN.recording, poses, turns, Triad(), gravity=GRAVITY, options={"table_rate": 1.0}
        )
