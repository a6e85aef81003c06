"""What the noise of captured orientations makes of means."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.transform import Rotation

from calib.effects.base import State
from calib.mismatch.reference.captured import (
    Felt,
    Known,
    coning,
    mean_covariance,
    moved_by,
    sensor_densities,
    wobble,
)
from calib.mismatch.reference.filters import smoothed
from calib.mismatch.reference.steadied import steadied
from calib.model import SensorModel
from calib.rotation import mat_from_rotvec
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

STEP = 0.02
WINDOW = 50


def turning(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return orientations (n, 3, 3) that turn ever faster, and their rates (n, 3)."""
    rate = np.linspace(0.0, 4.0, n)[:, None] * np.array([0.6, -0.5, 0.62])
    mat = np.empty((n, 3, 3))
    mat[0] = np.eye(3)
    for k in range(1, n):
        mat[k] = mat[k - 1] @ mat_from_rotvec(STEP * 0.5 * (rate[k] + rate[k - 1]))
    return mat, rate


def averages(number: int, n: int) -> tuple[list[sparse.csr_matrix], np.ndarray]:
    """Return the means of windows as functionals of six channels, and their weights.

    Not up to their ends, where a derivative would be one-sided.
    """
    mean = np.zeros((number, n))
    for k in range(number):
        mean[k, k * WINDOW + 2 : (k + 1) * WINDOW - 2] = 1.0 / (WINDOW - 4)
    functional = []
    for c in range(6):
        rows = np.zeros((6 * number, n))
        rows[c::6] = mean
        functional.append(sparse.csr_matrix(rows))
    return functional, mean


def seen_wrong(mat: np.ndarray, rate: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the true force and rate (n, 6) minus those of orientations that are off by angles."""
    force = np.einsum("nji,j->ni", mat, [0.0, 0.0, 9.8])
    off = np.einsum("nij,njk->nik", mat, mat_from_rotvec(angle))
    felt = np.einsum("nji,j->ni", off, [0.0, 0.0, 9.8])
    turned = np.einsum("nji,nj->ni", mat_from_rotvec(angle), rate) + np.gradient(
        angle, STEP, axis=0
    )
    return np.hstack((force - felt, rate - turned))


def test_means_err_as_angles_say():
    """Against the differences themselves, their angles and the sensor's own noise drawn anew."""
    n, rng = 8 * WINDOW, np.random.default_rng(1)
    mat, rate = turning(n)
    force = np.einsum("nji,j->ni", mat, [0.0, 0.0, 9.8])
    state = State(STEP * np.arange(n), force, rate)
    functional, mean = averages(8, n)
    known = Known(2e-3, 1e-4, 3e-4, STEP)
    felt = Felt.of(functional, state, STEP)
    expected = mean_covariance(felt, known)
    sigma = np.array(known[:3]) / np.sqrt(2.0 * STEP)
    trials = np.empty((1000, 48))
    for row in trials:
        left = seen_wrong(mat, rate, rng.normal(0.0, sigma[2], (n, 3)))
        left += rng.normal(size=(n, 6)) * np.repeat(sigma[:2], 3)
        row[:] = (mean @ left).ravel()
    found = trials.T @ trials / len(trials)
    scale = np.sqrt(np.diag(expected))
    assert np.allclose(np.diag(found) / np.diag(expected), 1.0, atol=0.2)
    assert np.abs((found - expected) / np.outer(scale, scale)).max() < 0.15
    # What is across gravity is noisy, what is along it is not.
    up = mean @ force / 9.8
    along = np.zeros((8, 48))
    for k, axis in enumerate(up):
        along[k, 6 * k : 6 * k + 3] = axis / np.linalg.norm(axis)
    quiet = np.einsum("ki,ij,kj->k", along, expected, along)
    assert (quiet < 2.0 * known.accel**2 / (2.0 * STEP * (WINDOW - 4))).all()
    assert (np.square(scale).reshape(8, 6)[:, :3].max(axis=1) > 2.5 * quiet[0]).all()
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", along, found, along), quiet, rtol=0.2)


def test_a_position_moves_the_mean_force_of_all_axes_and_comes_back():
    n, rng = 8 * WINDOW, np.random.default_rng(7)
    mat, rate = turning(n)
    force = np.einsum("nji,j->ni", mat, [0.0, 0.0, 9.8])
    state = State(STEP * np.arange(n), force, rate, mat_ns=mat)
    functional, mean = averages(8, n)
    known = Known(1e-9, 1e-9, 1e-9, STEP, position=1e-5)
    felt = Felt.of(functional, state, STEP)
    expected = mean_covariance(felt, known)[np.arange(48) % 6 < 3][:, np.arange(48) % 6 < 3]
    trials = np.empty((1000, 24))
    for row in trials:
        position = rng.normal(0.0, known.position / np.sqrt(2.0 * STEP), (n, 3))
        bend = np.zeros((n, 3))
        bend[1:-1] = np.diff(position, n=2, axis=0) / STEP**2
        row[:] = (mean @ np.einsum("nji,nj->ni", mat, bend)).ravel()
    found = trials.T @ trials / len(trials)
    scale = np.sqrt(np.diag(expected))
    assert np.allclose(np.diag(found) / np.diag(expected), 1.0, atol=0.2)
    assert np.abs((found - expected) / np.outer(scale, scale)).max() < 0.15


def test_where_a_rest_is_steady_means_err_as_its_lines_do():
    """A body at rest, turned, and at rest: its truth is drawn anew, and steadied each time."""
    n, rng = 12 * WINDOW, np.random.default_rng(8)
    time = STEP * np.arange(n)
    moving = (time > 4.0) & (time < 8.0)
    rate = np.where(moving, 1.5 * np.sin(np.pi * (time - 4.0) / 4.0) ** 2, 0.0)[:, None] * [1, 0, 0]
    mat = mat_from_rotvec(np.cumsum(rate, axis=0) * STEP)
    force = np.einsum("nji,j->ni", mat, [0.0, 0.0, 9.8])
    state = State(time, force, rate)
    functional, mean = averages(12, n)
    known = Known(5e-4, 1e-6, 3e-4, STEP)
    felt = Felt.of(functional, state, STEP)
    sigma = np.array(known[:3]) / np.sqrt(2.0 * STEP)
    rests = np.array([[1, 198], [402, 599]])
    still = np.repeat([True, False, True], 24)
    gyro = np.arange(72) % 6 >= 3
    trials, expected = np.empty((200, 72)), np.zeros((72, 72))
    for row in trials:
        angle = smoothed(STEP * np.arange(n), rng.normal(0.0, sigma[2], (n, 3)), 8.0)
        left = seen_wrong(mat, rate, angle)
        steady = steadied(time, rate - left[:, 3:], rests, angle=3e-4, interval=STEP, band=8.0)
        assert steady is not None
        left += rng.normal(size=(n, 6)) * np.repeat(sigma[:2], 3)
        row[:] = (mean @ left).ravel() - moved_by(felt, steady.moved)
        expected += mean_covariance(felt, known, steady) / len(trials)
    scale = np.sqrt(np.diag(expected))
    ratio = np.sqrt(np.mean(np.square(trials), axis=0)) / scale
    # Up to the edge of its band only, noise of the same density is less.
    assert (ratio < 1.25).all()
    assert (ratio[still] > 0.3).all()
    # Two rests are all that there is to tell whether the body sways.
    raw = np.sqrt(np.diag(mean_covariance(felt, known)))
    assert (scale[still & gyro] < 0.6 * raw[still & gyro]).all()


def test_what_angles_make_of_themselves_does_not_come_back():
    n, cutoff, density = 100_000, 4.0, 0.01
    rng = np.random.default_rng(4)
    white = rng.normal(0.0, density / np.sqrt(2.0 * STEP), (n, 3))
    angle = smoothed(STEP * np.arange(len(white)), white, cutoff)
    # From the orientations themselves: what they turn by, without what the angles do.
    step = rotvec_between(angle[:-1], angle[1:])
    rate = (step - np.diff(angle, axis=0)) / STEP
    means = rate[: n // WINDOW * WINDOW - WINDOW].reshape(-1, WINDOW, 3).mean(axis=1)
    expected = coning(density, cutoff) ** 2 / (2.0 * WINDOW * STEP)
    assert means.var() == pytest.approx(expected, rel=0.2)


def rotvec_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (n, 3) from one orientation to the next."""
    turned = Rotation.from_rotvec(first).inv() * Rotation.from_rotvec(second)
    return np.asarray(turned.as_rotvec())


def test_angles_that_wander_are_felt_as_they_are_and_come_back():
    n, rng = 8 * WINDOW, np.random.default_rng(2)
    mat, rate = turning(n)
    force = np.einsum("nji,j->ni", mat, [0.0, 0.0, 9.8])
    state = State(STEP * np.arange(n), force, rate)
    functional, mean = averages(8, n)
    nodes = STEP * WINDOW * np.arange(9.0)
    felt = Felt.of(functional, state, STEP)
    found = wobble(felt, state.time, Known(2e-3, 1e-4, 3e-4, STEP), nodes)
    error = rng.normal(0.0, 1e-4, (9, 3))
    angle = np.stack([np.interp(state.time, nodes, own) for own in error.T], axis=1)
    seen = (mean @ seen_wrong(mat, rate, angle)).ravel()
    np.testing.assert_allclose(-(found.response @ error.T.ravel()), seen, atol=2e-6)
    # At rest the mean rates of all windows add up to what the first and last angle differ by.
    still = replace(state, rate=0.0 * rate)
    felt = Felt.of(functional, still, STEP)
    at_rest = wobble(felt, still.time, Known(2e-3, 1e-4, 3e-4, STEP), nodes)
    total = np.ones(8) @ at_rest.matrix[3::6, 3::6] @ np.ones(8)
    assert total < 3.0 / (WINDOW * STEP) ** 2
    assert total < 0.25 * np.trace(at_rest.matrix[3::6, 3::6])


@pytest.mark.parametrize("vibration", [0.0, 10.0])
def test_a_sensors_own_noise_is_that_of_its_quiet_rests(vibration):
    rng = np.random.default_rng(3)
    motion = bench_protocol(
        rng, poses=12, pose_duration=(3.0, 4.0), tremor=0.3, vibration=vibration
    )
    recording = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    poses = find_poses(recording)
    found = sensor_densities(recording, np.stack((poses.start, poses.stop), axis=1))
    assert found is not None
    assert 0.9 < found[0] / CONSUMER.accel_noise_density < 1.1
    assert 0.9 < found[1] / CONSUMER.gyro_noise_density < 1.1
    assert sensor_densities(recording, np.zeros((0, 2), np.int64)) is None
