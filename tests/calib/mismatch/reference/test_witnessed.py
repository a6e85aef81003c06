"""What a truth and a recording say of a motion between them errs unlike their difference."""

import numpy as np

from calib.effects import get_effect
from calib.effects.base import State
from calib.mismatch import ReferenceMotion
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.reference.band import smoothed
from calib.mismatch.reference.colour import Colour
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.reference.witnessed import witnessed
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

GRAVITY = 9.80665
STEP, BAND = 0.02, 8.0


def test_what_two_witnesses_leave_goes_with_their_difference_no_more():
    rng, n = np.random.default_rng(1), 20_000
    time = STEP * np.arange(n)
    # The slope of white angles is as loud as the sensor's noise at 2 Hz, the bend of white places.
    ratio = [Colour(0.0, 2.0**-4), Colour(2.0**-2, 0.0)]
    angle = rng.normal(size=(n, 6)) / (2 * np.pi * 2.0)
    noise = np.gradient(angle, STEP, axis=0)
    noise[:, :3] = np.gradient(noise[:, :3], STEP, axis=0) / (2 * np.pi * 2.0)
    of_truth, of_sensor = (
        smoothed(time, values, BAND) for values in (noise, rng.normal(size=(n, 6)))
    )
    state = State(time, of_truth[:, :3], of_truth[:, 3:])
    left = of_sensor - of_truth
    between = witnessed(state, left, ratio)
    error = np.hstack((between.force, between.rate))

    def alike(values: np.ndarray) -> np.ndarray:
        bend = np.gradient(np.gradient(values, STEP, axis=0), STEP, axis=0)
        both = np.mean(bend * left, axis=0)
        return np.asarray(both / np.sqrt(np.mean(bend**2, axis=0) * np.mean(left**2, axis=0)))

    assert (alike(of_truth) > 0.8).all()
    assert (np.abs(alike(error)) < 0.1).all()
    assert (error.std(axis=0) < 0.9 * np.minimum(of_truth.std(axis=0), of_sensor.std(axis=0))).all()


def test_noise_of_a_captured_motion_is_no_sharpening():
    """Slow hands, cameras that see 0.3 degrees: three standard errors, were other columns its."""
    effect, found = get_effect("reference_smoothing"), []
    for seed in range(3):
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
    assert np.abs(np.mean(found, axis=0)).max() < 1.5
