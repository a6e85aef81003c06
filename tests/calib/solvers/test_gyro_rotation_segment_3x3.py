"""The default gyroscope method: recovery, honest errors, robustness, and what it cannot know."""

from dataclasses import replace

import numpy as np
import pytest
from gyro_motion import GRAVITY, Motion, Truth, noisy, protocol, simulate

from calib.directions import closure_errors
from calib.fit import Fit
from calib.model import SensorModel, Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.simulate import Sampling
from calib.simulate import simulate as simulate_recording
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import NoiseModel
from calib.solvers import gyro_solvers
from calib.statics import find_poses
from calib.turns import find_turns

GYRO = Triad(
    [0.01, -0.02, 0.015],
    [0.02, -0.03, 0.01],
    np.array([[0, 0.01, -0.02], [0.015, 0, 0.005], [-0.01, 0.02, 0]]),
)
TRUTH = np.array(list(GYRO.parameters("gyro").values()))


def solve(truth: Truth, accel: Triad | None = None) -> Fit:
    return gyro_solvers()["rotation_segment_3x3"].solve(
        truth.recording,
        truth.poses,
        find_turns(truth.recording, truth.poses),
        accel or Triad(),
        gravity=GRAVITY,
        options={},
    )


def test_without_noise_the_answer_is_exact() -> None:
    truth = simulate(
        Motion(protocol(), rate=400.0),
        GYRO,
        rng=np.random.default_rng(0),
        gyro_noise=1e-9,
        accel_noise=1e-9,
    )
    np.testing.assert_allclose(solve(truth).values, TRUTH, atol=2e-6)


def test_several_revolutions_and_large_errors() -> None:
    gyro = Triad([0.3, -0.6, 0.3], [0.1, -0.05, 0.2])
    turns = np.concatenate([protocol(), np.pi * np.diag([5.5, 6.5, 0.0])])
    truth = simulate(Motion(turns, turn=4.0), gyro, rng=np.random.default_rng(3))
    fit = solve(truth)
    error = fit.values - np.array(list(gyro.parameters("gyro").values()))
    assert not fit.excluded
    assert (np.abs(error / fit.standard_errors) < 4.5).all()


def test_a_vertical_axis_is_named_and_the_rest_is_returned() -> None:
    # z stays vertical in all its turns, and no other axis is turned far.
    q = np.pi / 2
    turns = [[q, 0, 0], [-q, 0, 0], [0, q, 0], [0, -q, 0], [0, 0, q], [0, 0, q], [0, 0, -q]] * 3
    fit = solve(simulate(Motion(np.array(turns)), GYRO, rng=np.random.default_rng(1)))
    assert "gyro.scale_factor_error.z" in fit.undetermined
    assert "gyro.scale_factor_error.x" not in fit.undetermined
    assert any("axis z was vertical" in text and "remount" in text for text in fit.advice)
    known = np.array([n not in fit.undetermined for n in fit.names])
    errors = (fit.values - TRUTH)[known] / fit.standard_errors[known]
    assert (np.abs(errors[3:5]) < 5).all()
    assert np.isnan(fit.standard_errors[~known]).all()


def test_an_axis_that_never_turned_is_named() -> None:
    q = np.pi / 2
    turns = np.array([[q, 0, 0], [0, q, 0], [-q, 0, 0], [0, -q, 0]] * 4)
    fit = solve(simulate(Motion(turns), GYRO, rng=np.random.default_rng(1)))
    assert set(fit.undetermined) == {
        "gyro.scale_factor_error.z",
        "gyro.misalignment.xz",
        "gyro.misalignment.yz",
    }
    assert any("axis z hardly turned" in text for text in fit.advice)


@pytest.mark.parametrize("milli_g", [5, 50])
def test_a_bumped_pose_is_found_and_left_out(milli_g: float) -> None:
    truth = simulate(Motion(protocol()), GYRO, rng=np.random.default_rng(5))
    bumped = truth.poses.accel.copy()
    k = 9
    side = np.cross(bumped[k], [0.3, 0.5, 0.8])
    bumped[k] += milli_g / 1000 * GRAVITY * side / np.linalg.norm(side)
    object.__setattr__(truth.poses, "accel", bumped)
    fit = solve(truth)
    assert [e.interval for e in fit.excluded] == [tuple(truth.poses.interval[k])]
    assert (np.abs((fit.values - TRUTH) / fit.standard_errors) < 4.5).all()


def bench(gyro: Triad, seed: int, **options: float) -> tuple[Recording, Poses]:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=25, temperature=None, hold_tremor=options["hold_tremor"])
    noise = NoiseModel(accel_noise_density=2e-3, gyro_noise_density=1e-4)
    sampling = Sampling(lost=options["lost"], lost_run=3)
    recording = simulate_recording(
        motion, SensorModel(gyro=gyro), noise, rng=rng, rate=100.0, sampling=sampling
    )
    return recording, find_poses(recording)


@pytest.mark.parametrize(
    ("hold_tremor", "lost", "bound"), [(0.0, 0.0, 1e-4), (1.0, 0.0, 5e-4), (0.0, 0.01, 5e-4)]
)
def test_laid_down_held_in_a_hand_and_with_gaps(
    hold_tremor: float, lost: float, bound: float
) -> None:
    # A hand that sways by 0.3 degrees, and one sample in thirty lost, would cost 1 % if ignored.
    recording, poses = bench(GYRO, 11, hold_tremor=hold_tremor, lost=lost)
    turns = find_turns(recording, poses)
    fit = gyro_solvers()["rotation_segment_3x3"].solve(
        recording, poses, turns, Triad(), gravity=GRAVITY, options={}
    )
    assert not fit.undetermined
    assert np.sqrt(np.mean((fit.values - TRUTH)[3:] ** 2)) < bound
    held, plain = (
        np.linalg.norm(
            closure_errors(
                recording, poses, turns, Triad(), fit.triad, gain=np.full(len(poses), gain)
            ),
            axis=1,
        )
        for gain in (float(hold_tremor > 0), 0.0)
    )
    assert np.median(held) < 2e-3
    if hold_tremor:
        assert np.median(held) < np.median(plain) / 3


def test_a_minute_of_shaking_is_left_out_and_said() -> None:
    shaking = np.random.default_rng(6).normal(0, 40, (1, 3))
    turns = np.concatenate([protocol(), shaking])
    fit = solve(simulate(Motion(turns), GYRO, rng=np.random.default_rng(2)))
    assert [e.reason.split(" that")[0] for e in fit.excluded] == ["the turn is so long"]
    assert (np.abs((fit.values - TRUTH) / fit.standard_errors) < 4.5).all()


def test_errors_of_the_accelerometer_reach_the_parameters_as_stated() -> None:
    accel = Triad([0.1, 0.2, 0.1], [0.02, 0.01, 0.0], 0.01 * np.tril(np.ones((3, 3)), -1))
    truth = simulate(Motion(protocol()), GYRO, rng=np.random.default_rng(0), accel=accel)
    values = accel.parameters("accel")

    def solved(**changed: float) -> Fit:
        return solve(truth, accel.with_parameters(values | changed))

    stated = solved().accel_sensitivity
    assert stated is not None
    for name in ("accel.bias.x", "accel.scale_factor_error.y", "accel.misalignment.zx"):
        high, low = (solved(**{name: values[name] + h}).values for h in (1e-4, -1e-4))
        change = (high - low) / 2e-4
        column = stated[:, list(values).index(name)]
        np.testing.assert_allclose(column, change, atol=0.03 * np.abs(change).max())


@pytest.mark.long
def test_the_covariance_covers_a_bias_that_wanders_and_no_more_where_it_does_not() -> None:
    clean = simulate(
        Motion(protocol()),
        GYRO,
        rng=np.random.default_rng(0),
        gyro_noise=0.0,
        accel_noise=0.0,
    )
    for walk in (0.0, 2e-4):  # rad/s per root second
        squares = []
        for seed in range(12):
            rng = np.random.default_rng(seed)
            truth = noisy(clean, rng=rng, gyro_noise=0.002, accel_noise=0.02)
            steps = rng.normal(0, walk * np.sqrt(truth.recording.interval), truth.rate.shape)
            drift = np.cumsum(steps, axis=0)
            recording = replace(truth.recording, gyro=truth.recording.gyro + drift)
            spans = zip(truth.poses.start, truth.poses.stop, strict=True)
            means = np.array([drift[a:b].mean(axis=0) for a, b in spans])
            poses = replace(truth.poses, gyro=truth.poses.gyro + means)
            fit = solve(Truth(recording, poses, truth.rate, truth.mat_ns))
            moment = drift[rng.integers(len(drift))]
            error = fit.values[:3] - GYRO.bias - moment
            squares.append(error @ np.linalg.solve(fit.covariance[:3, :3], error) / 3)
        # A mean of 36 squares is 1 +- 0.24; those of one wandering path are less independent.
        assert 0.4 < np.mean(squares) < 2.0, walk
