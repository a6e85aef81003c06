"""Noise of a truth that counts as exact: all samples together show it, and effects take it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.faults import values_of
from calib.mismatch import diagnose_against
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.band import fastest_noise, matched
from calib.mismatch.reference.filters import smoothed
from calib.mismatch.reference.quieted import quieted
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import NoiseModel

GRAVITY = 9.80665
LOUD = NoiseModel(accel_noise_density=1e-2, gyro_noise_density=1e-3)
WHITE = np.repeat([1e-2, 1e-3], 3)


def bench(rng: np.random.Generator) -> Motion:
    return bench_protocol(rng, poses=20, first_pose=3.0, pose_duration=(2.0, 5.0))


def pair(
    *terms: Term, rate: float, other: float, relative: float, seed: int
) -> tuple[Recording, Recording]:
    rng = np.random.default_rng(seed)
    motion = bench(rng)
    real = simulate(motion, SensorModel(terms=terms), LOUD, rng=rng, rate=rate)
    return real, simulate(motion, SensorModel(), LOUD.scaled(relative), rng=rng, rate=other)


def exact_and_noisy(relative: float, *, rate: float = 200.0) -> tuple[Recording, Recording]:
    motion = bench(np.random.default_rng(3))
    rng = np.random.default_rng(4)
    exact, noisy = (
        simulate(motion, SensorModel(), LOUD.scaled(part), rng=rng, rate=rate)
        for part in (0.0, relative)
    )
    return exact, noisy


def quiet(recording: Recording) -> Recording:
    return quieted(
        RecordingTruth(recording, GRAVITY), WHITE, 20_000, most=most_of(recording)
    ).recording


def most_of(recording: Recording) -> np.ndarray:
    return np.repeat(fastest_noise(recording), 3)


def test_where_a_truth_has_noise_alone_it_is_taken_away() -> None:
    exact, noisy = exact_and_noisy(0.06)
    before = values_of(noisy) - values_of(exact)
    error = values_of(quiet(noisy)) - values_of(exact)
    assert (error.std(axis=0) < 0.5 * before.std(axis=0)).all()
    # Nowhere is more of the motion lost than the recording's own noise hides.
    assert (np.abs(error) < 0.5 * WHITE * np.sqrt(100.0)).all()


def test_what_a_low_pass_takes_of_a_truth_is_none_of_what_it_errs_by() -> None:
    """Of ``x + n`` it would take n, and of ``-n`` are the differences."""
    exact, noisy = exact_and_noisy(0.06)

    def common(truth: Recording) -> np.ndarray:
        values = values_of(truth)
        fast = values - np.apply_along_axis(np.convolve, 0, values, np.full(9, 1 / 9), "same")
        return np.asarray((fast * (values - values_of(exact))).sum(axis=0))

    assert (common(quiet(noisy)) < 0.1 * common(noisy)).all()


def test_a_truth_without_noise_stays_as_it_is() -> None:
    exact, noisy = exact_and_noisy(1e-3)
    for own in (exact, noisy):
        truth = RecordingTruth(own, GRAVITY)
        assert quieted(truth, WHITE, 20_000, most=most_of(own)) is truth


def test_a_truth_of_few_samples_a_second_stays_as_it_is() -> None:
    _, noisy = exact_and_noisy(0.06, rate=6.0)
    np.testing.assert_array_equal(values_of(quiet(noisy)), values_of(noisy))


def test_a_knock_is_no_noise() -> None:
    _, noisy = exact_and_noisy(0.06)
    knock = np.zeros((len(noisy), 3))
    knock[2000:2003] = 5.0
    struck = replace(noisy, accel=noisy.accel + knock)
    change = quiet(struck).accel - quiet(noisy).accel
    assert np.abs(change - knock).max() < 0.1 * 5.0


def test_what_shakes_all_the_time_is_no_noise() -> None:
    """At all frequencies alike, but for the fastest: those show how loud the noise is."""
    _, noisy = exact_and_noisy(0.06)
    shake = np.random.default_rng(5).normal(0.0, 0.5, (len(noisy), 3))
    shaken = replace(noisy, accel=noisy.accel + smoothed(noisy.time, shake, 60.0))
    assert (quiet(shaken).accel - shaken.accel).std() < 0.2 * 0.1  # of the recording's noise


def test_noise_of_captured_motion_is_that_of_derivatives_and_stays() -> None:
    real, noisy = pair(rate=125.0, other=100.0, relative=0.06, seed=1)
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (len(noisy), 1))
    for known in (None, quat):
        truth = RecordingTruth(noisy, GRAVITY, quat=known)
        spoilt = np.zeros(len(real), bool)
        used = matched(real, truth, Alignment(0.0, 0.0, 0.0), np.eye(3), spoilt=spoilt).truth
        assert (used is truth) == (known is not None)


@pytest.mark.long
@pytest.mark.parametrize(
    ("rate", "other", "relative", "seed"), [(400.0, 200.0, 0.097, 0), (250.0, 200.0, 0.06, 10)]
)
def test_noise_of_a_quieter_simulation_is_no_low_pass(
    rate: float, other: float, relative: float, seed: int
) -> None:
    """Both triads had one, of 40 Hz, to within 5 %."""
    found = diagnose_against(
        *pair(rate=rate, other=other, relative=relative, seed=seed), gravity=GRAVITY
    )
    assert found.verdict == "consistent"


@pytest.mark.long
@pytest.mark.parametrize(
    ("triad", "cutoff", "order"), [("both", 6.0, 1), ("gyro", 10.0, 2), ("accel", 8.0, 2)]
)
def test_a_low_pass_is_found_alone_beside_a_quieter_simulation(
    triad: str, cutoff: float, order: int
) -> None:
    """Beside that of one triad was another, of both."""
    term = Term("bandwidth", {triad: 1.0, f"{triad}_cutoff": cutoff, "order": float(order)})
    found = diagnose_against(
        *pair(term, rate=250.0, other=200.0, relative=0.06, seed=10), gravity=GRAVITY
    )
    (item,) = found.findings
    assert item.effect == "bandwidth"
    value = item.parameters[f"{triad}_cutoff"]
    assert value.sigma is not None
    assert abs(value.value - cutoff) < 4 * value.sigma
    assert item.parameters["order"].value == order
    assert found.verdict == "explained"
