"""What a truth and a recording say of a motion between them errs unlike their difference."""

import numpy as np
import pytest

from calib.effects import get_effect
from calib.effects.base import State
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.reference.captured import Known
from calib.mismatch.reference.filters import smoothed
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.reference.witnessed import fast_densities, shared, witnessed
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.rotation import (
    mat_from_quat,
    quat_from_rotvec,
    quat_multiply,
    rotvec_from_mat,
)
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.motions import pendulum
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

GRAVITY = 9.80665
STEP, BAND = 0.02, 8.0


def test_what_two_witnesses_leave_goes_with_their_difference_no_more():
    rng, n = np.random.default_rng(1), 20_000
    time = STEP * np.arange(n)
    # The slope of white angles is as loud as the sensor's noise at 2 Hz, the bend of white places.
    white, equal = np.sqrt(2 * STEP), 2 * np.pi * 2.0
    known = Known(white, white, white / equal, STEP, position=white / equal**2)
    angle = rng.normal(size=(n, 6)) / equal
    noise = np.gradient(angle, STEP, axis=0)
    noise[:, :3] = np.gradient(noise[:, :3], STEP, axis=0) / equal
    of_truth, of_sensor = (
        smoothed(time, values, BAND) for values in (noise, rng.normal(size=(n, 6)))
    )
    state = State(time, of_truth[:, :3], of_truth[:, 3:])
    left = of_sensor - of_truth
    between = witnessed(state, left, known)
    error = np.hstack((between.force, between.rate))

    def alike(values: np.ndarray) -> np.ndarray:
        bend = np.gradient(np.gradient(values, STEP, axis=0), STEP, axis=0)
        both = np.mean(bend * left, axis=0)
        return np.asarray(both / np.sqrt(np.mean(bend**2, axis=0) * np.mean(left**2, axis=0)))

    assert (alike(of_truth) > 0.8).all()
    assert (np.abs(alike(error)) < 0.1).all()
    assert (error.std(axis=0) < 0.9 * np.minimum(of_truth.std(axis=0), of_sensor.std(axis=0))).all()


def test_angles_that_cameras_err_by_are_those_that_the_gyroscope_tells():
    """Of a body that turns, and feels gravity across the axis that they are about."""
    rng, n = np.random.default_rng(1), 20_000
    time = STEP * np.arange(n)
    swing = np.outer(np.sin(time), [1.0, 0.0, 0.0])
    true = mat_from_quat(quat_from_rotvec(swing))
    white, off = np.sqrt(2 * STEP), smoothed(time, rng.normal(0, 2e-3, (n, 3)), BAND)
    mat = true @ mat_from_quat(quat_from_rotvec(off))
    force, rate = GRAVITY * mat[:, 2, :], np.gradient(swing, STEP, axis=0)
    slope = np.gradient(off, STEP, axis=0) + np.cross(rate, off)
    noise = smoothed(time, rng.normal(size=(n, 6)) * [*[0.02] * 3, *[1e-3] * 3], BAND)
    left = np.hstack((GRAVITY * true[:, 2, :] - force, -slope)) + noise
    known = Known(0.02 * white, 1e-3 * white, 2e-3 * white, STEP)
    found = witnessed(State(time, force, rate + slope, mat_ns=mat), left, known)
    assert found.mat_ns is not None
    wrong = rotvec_from_mat(np.swapaxes(true, 1, 2) @ found.mat_ns)
    assert wrong.std() < 0.4 * off.std()
    assert np.std(found.force - GRAVITY * true[:, 2, :]) < 0.4 * np.std(left[:, :3] - noise[:, :3])
    assert np.std(found.rate - rate) < 0.2 * slope.std()


def test_what_shakes_one_of_them_is_no_motion_of_either():
    """A truth that took it over would look smoothed, by as much as it shakes."""
    rng, n = np.random.default_rng(1), 6000
    time, white = STEP * np.arange(n), np.sqrt(2 * STEP)
    known = Known(0.02 * white, 1e-3 * white, 1e-3 * white, STEP, position=1e-4 * white)
    left = rng.normal(size=(n, 6)) * [*[0.02] * 3, *[1e-3] * 3]
    shaken = (time > 40.0) & (time < 60.0)
    left[shaken, :3] += rng.normal(size=(shaken.sum(), 3))
    still = np.zeros((n, 3))
    found = witnessed(State(time, still, still), left, known)
    inside = (time > 42.0) & (time < 58.0)
    assert found.force[~shaken].std() > 1e-3
    assert found.force[inside].std() < 0.01


def test_what_is_made_of_a_rate_follows_it():
    """A gradient holds the noise of the rate's slope: an arm of -g / (2 pi f)², by gravity."""
    rng, n = np.random.default_rng(1), 5000
    time = STEP * np.arange(n)
    off = smoothed(time, rng.normal(0, 2e-3, (n, 3)), BAND)
    rate, still = np.gradient(off, STEP, axis=0), np.zeros((n, 3))
    plain = State(time, still, rate)
    given = State(
        time,
        still,
        rate,
        angular_acceleration=plain.rate_dot,
        known_gradient=plain.gradient,
    )
    white = np.sqrt(2 * STEP)
    left = np.hstack((still, -rate)) + rng.normal(0, 1e-5, (n, 6))
    found = witnessed(given, left, Known(1e-5 * white, 1e-5 * white, 2e-3 * white, STEP))
    assert np.std(found.rate_dot) < 0.1 * np.std(plain.rate_dot)
    assert np.std(found.gradient) < 0.1 * np.std(plain.gradient)


def test_the_noise_of_what_never_rests_is_that_of_its_fastest_changes():
    rng, n = np.random.default_rng(1), 20_000
    time = STEP * np.arange(n)
    swing = np.sin(2 * time)[:, None] * np.ones(3)
    for level in (0.02, 0.0):
        noise = level * rng.normal(size=(2, n, 3))
        found = fast_densities(Recording(time, 9.8 * swing + noise[0], swing + noise[1], "device"))
        # Without any it is as the quietest sensor has it.
        assert np.allclose(found, level * np.sqrt(2 * STEP), rtol=0.05, atol=1e-3 * (level == 0.0))
        assert min(found) > 0.0


def test_of_an_axis_that_hardly_turns_a_truth_has_nothing_to_say():
    rng, n = np.random.default_rng(1), 5000
    time = STEP * np.arange(n)
    motion = np.outer(np.sin(2 * time), [1.0, 0.0, 0.0])
    noise = smoothed(time, rng.normal(0, 0.1, (n, 6)), BAND)
    state = State(time, motion + noise[:, :3], motion + noise[:, 3:])
    measured = 1.02 * np.hstack((motion, motion)) + rng.normal(0, 1e-3, (n, 6))
    found = shared(state, measured)
    for values in (found.force, found.rate):
        # A scale factor is off by the share of noise in what it multiplies.
        assert np.allclose(values[:, 0], motion[:, 0], atol=0.4)
        assert (values[:, 1:].std(axis=0) < 0.3 * noise.std()).all()


@pytest.mark.parametrize(("seed", "amplitude"), [(0, 0.8), (4, 2.0)])
@pytest.mark.long
def test_a_swing_in_one_plane_is_nothing_else_beside_markers(seed, amplitude):
    """Of the axes across it the markers tell noise alone, and when it was let go neither tells."""
    rng = np.random.default_rng(seed)
    motion = pendulum(length=0.5, amplitude=amplitude, duration=60.0)
    model = SensorModel(Triad(rng.normal(0, 0.2, 3), rng.normal(0, 0.01, 3)))
    real = simulate(motion, model, CONSUMER, rng=rng, rate=100.0)
    time = np.arange(1.0, 59.0, 1 / 120.0)
    turning, path = motion.kinematics(time)
    assert path is not None
    shake = quat_from_rotvec(rng.normal(0, np.radians(0.1), (len(time), 3)))
    position = path.position + rng.normal(0, 2e-4, (len(time), 3))
    seen = ReferenceMotion(time, quat_multiply(turning.quat, shake), position)
    found = diagnose_reference(real, seen, gravity=GRAVITY)
    # Chance alone may say something, at p = 0.01.
    assert min((u.p_value for u in found.unexplained), default=1.0) > 5e-4
    assert {item.effect for item in found.findings} <= {"time_offset"}
    ((start, stop),) = found.summary["jumps"]["intervals"]
    assert start < 5.0 < stop


@pytest.mark.long
def test_noise_of_a_captured_motion_is_no_sharpening():
    """Slow hands, cameras that see 0.3 degrees: three standard errors, were other columns its."""
    effect, found = get_effect("reference_smoothing"), []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        motion = bench_protocol(
            rng, poses=30, first_pose=3.0, pose_duration=(2.0, 4.0), power_on=0.0, tremor=0.3
        )
        real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
        at = np.arange(0.5, motion.duration - 0.5, 0.01)
        turning, path = motion.kinematics(at)
        assert path is not None
        shake = quat_from_rotvec(rng.normal(0.0, np.radians(0.3), (len(at), 3)))
        place = path.position + rng.normal(0.0, 6e-4, (len(at), 3))
        seen = ReferenceMotion(at, quat_multiply(turning.quat, shake), place)
        samples = look_at_samples(real, find_poses(real))
        rows = compare_reference(real, seen, samples, gravity=GRAVITY)[0].rows()
        fitted = np.hstack((rows.baseline, rows.nuisance))
        whitener = make_whitener(rows, expected_levels(rows), contrast_variance(rows), fitted)
        columns = effect.columns(rows.state, {}).values()
        design = whitener.project(np.stack([rows.column(c) for c in columns], axis=1))
        covariance = np.linalg.inv(design.T @ design)
        value = covariance @ design.T @ whitener.project(rows.residual)
        found.append(value / np.sqrt(np.diag(covariance)))
    assert np.abs(np.mean(found, axis=0)).max() < 3.0 / np.sqrt(len(found))
