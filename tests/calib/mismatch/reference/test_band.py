"""What is fast in a truth: motion, if the recording has it too; noise, if it has not."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_against
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.band import (
    _low_passed,
    common_bands,
    fastest_noise,
    matched,
    noise_beside_exact,
    noise_of,
    thinned,
    too_few,
)
from calib.mismatch.reference.filters import NARROWEST, denoised, low_passed, smoothed
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER, NoiseModel

GRAVITY = 9.80665
SAME = Alignment(0.0, 0.0, 0.0)


def pair(
    name: str, *terms: Term, noise: NoiseModel, rate: float = 80.0, seed: int = 1
) -> tuple[Recording, Recording]:
    rng = np.random.default_rng(seed)
    motion = make_motion(name, rng=rng, duration=50.0, gravity=GRAVITY)
    real = simulate(motion, SensorModel(terms=terms), CONSUMER, rng=rng, rate=100.0)
    return real, simulate(motion, SensorModel(), noise, rng=rng, rate=rate)


@pytest.mark.parametrize("name", ["hand-held", "pendulum"])
@pytest.mark.parametrize("rate", [80.0, 200.0])
def test_a_motion_that_never_rests_is_no_noise(name: str, rate: float) -> None:
    real, exact = pair(name, noise=NoiseModel(), rate=rate)
    noise = noise_beside_exact(real, RecordingTruth(exact, GRAVITY), SAME, np.eye(3))
    assert noise is not None
    density = np.array([CONSUMER.accel_noise_density, CONSUMER.gyro_noise_density])
    assert noise == pytest.approx(density * np.sqrt(50.0), rel=0.1)


def test_a_motion_that_never_rests_is_no_noise_though_a_truth_saw_a_third_of_it() -> None:
    real, exact = pair("hand-held", noise=NoiseModel())
    part = RecordingTruth(exact.slice(len(exact) // 3, 2 * len(exact) // 3), GRAVITY)
    assert noise_beside_exact(real, part, SAME, np.eye(3)) is not None


def test_samples_that_show_nothing_fast_do_not_agree_throughout() -> None:
    real, noisy = pair("hand-held", noise=CONSUMER)
    truth = RecordingTruth(noisy, GRAVITY)
    slow = thinned(real, 10)
    assert common_bands(slow, truth, SAME, np.eye(3), forces=True) == (NARROWEST, NARROWEST)


def test_the_band_is_that_of_what_a_truth_saw_of_the_recording() -> None:
    """Of a third of it nothing was common, and what was compared ended at 5 Hz."""
    real, noisy = pair("hand-held", noise=CONSUMER.scaled(2.0))
    part = RecordingTruth(noisy.slice(len(noisy) // 3, 2 * len(noisy) // 3), GRAVITY)
    cut = real.slice(*np.searchsorted(real.time, part.span).tolist())
    whole, own = (common_bands(r, part, SAME, np.eye(3), forces=True) for r in (real, cut))
    assert min(own) > 1.5 * NARROWEST
    assert whole == pytest.approx(own, abs=1.0)


def test_captured_rates_agree_up_to_a_tremor_and_forces_up_to_the_gap_before() -> None:
    """A hand turns below 2 Hz and trembles at 8; what markers see of forces is noise up there."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 60.0, 0.01)
    turn = smoothed(time, rng.normal(size=(len(time), 3)), 1.5)
    tremor = smoothed(time, rng.normal(size=(len(time), 3)), 9.0)
    tremor -= smoothed(time, tremor, 7.0)
    rate = 5.0 * turn + tremor
    force = 20.0 * turn + 0.1 * tremor + [0.0, 0.0, 9.8]
    real, seen = (
        Recording(
            time,
            force + rng.normal(0.0, loud, rate.shape),
            rate + rng.normal(0.0, 0.2, rate.shape),
            "device",
        )
        for loud in (0.01, 0.5)
    )
    bare = RecordingTruth(seen, GRAVITY)
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
    for truth, forces, expected in (
        (bare, True, [(5.0, 5.5), (5.0, 5.5)]),
        (RecordingTruth(seen, GRAVITY, quat=quat), True, [(5.0, 5.5), (8.0, 11.0)]),
        (RecordingTruth(seen, GRAVITY, quat=quat), False, [(8.0, 11.0), (8.0, 11.0)]),
    ):
        found = common_bands(real, truth, SAME, np.eye(3), forces=forces)
        for own, (low, high) in zip(found, expected, strict=True):
            assert low <= own <= high


@pytest.mark.parametrize("name", ["hand-held", "pendulum"])
@pytest.mark.parametrize("rate", [80.0, 200.0])
@pytest.mark.parametrize("cutoff", [None, 25.0])
def test_noise_is_noise_though_a_low_pass_took_its_fastest_part(
    name: str, rate: float, cutoff: float | None
) -> None:
    real, noisy = pair(name, noise=CONSUMER, rate=rate)
    if cutoff is not None:
        noisy = low_passed(noisy, cutoff)
        assert (fastest_noise(noisy) < 0.1 * fastest_noise(real)).all()
    truth = RecordingTruth(noisy, GRAVITY)
    assert noise_beside_exact(real, truth, SAME, np.eye(3)) is None
    common = matched(real, truth, SAME, np.eye(3), spoilt=np.zeros(len(real), bool))
    assert common.limited
    assert not common.exact


@pytest.mark.long
@pytest.mark.parametrize("name", ["hand-held", "vibrating"])
def test_a_low_pass_is_found_beside_an_exact_motion_that_trembles_or_is_sampled_seldom(
    name: str,
) -> None:
    term = Term("bandwidth", {"gyro": 1.0, "gyro_cutoff": 30.0, "order": 1.0})
    real, exact = pair(name, term, noise=NoiseModel())
    found = diagnose_against(real, exact, gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "bandwidth"
    cutoff = item.parameters["gyro_cutoff"]
    assert cutoff.sigma is not None
    assert cutoff.value == pytest.approx(30.0, abs=4 * cutoff.sigma)
    assert not found.unexplained
    clean = pair(name, noise=NoiseModel())[0]
    assert diagnose_against(clean, exact, gravity=GRAVITY).verdict == "consistent"


def test_noise_of_the_fastest_differences_is_that_of_samples() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(4000) / 100.0
    slow = np.sin(2 * np.pi * 12.0 * time)[:, None] * np.ones(3)
    still = Recording(time, slow + rng.normal(0, 0.01, (4000, 3)), slow, "device")
    both = replace(still, gyro=slow + rng.normal(0, 0.002, (4000, 3)))
    assert fastest_noise(both) == pytest.approx([0.01, 0.002], rel=0.05)
    assert fastest_noise(still)[1] < 1e-4


@pytest.mark.parametrize("lsb", [0.5, 1.5, 2.0, 3.0, 4.0])
def test_rounding_to_coarse_counts_is_noise_though_rests_never_change(lsb: float) -> None:
    """They said that there was none, and so that no simulation had samples enough."""
    rng = np.random.default_rng(3)
    motion = make_motion("bench", rng=rng, duration=50.0, gravity=GRAVITY)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    exact = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=100.0)
    sigma = np.sqrt(50.0) * np.array([CONSUMER.accel_noise_density, CONSUMER.gyro_noise_density])
    step = lsb * sigma
    coarse = replace(
        real,
        accel=np.rint(real.accel / step[0]) * step[0],
        gyro=np.rint(real.gyro / step[1]) * step[1],
    )
    assert (noise_of(coarse) > 0.99 * step / np.sqrt(12.0)).all()
    assert (noise_of(coarse) < 1.5 * np.hypot(sigma, step / np.sqrt(12.0))).all()
    assert not too_few(coarse, RecordingTruth(exact, GRAVITY), SAME, np.eye(3))


def test_slow_motion_stays_where_white_noise_is_taken_away() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 60.0, 0.02)
    slow = np.stack((np.sin(3.0 * time), 9.8 + 0.1 * time, time > 30.0), axis=1)
    noisy = slow + rng.normal(0.0, 0.05, slow.shape)
    error = denoised(noisy, 0.05) - slow
    assert (np.abs(error.mean(axis=0)) < 3 * 0.05 / np.sqrt(len(time))).all()
    assert (error.std(axis=0) < [0.02, 0.02, 0.04]).all()
    # Without noise all of it stays.
    np.testing.assert_allclose(denoised(slow, 0.0), slow, atol=1e-9)


@pytest.mark.parametrize("make", ["low-pass", "noise"])
def test_a_low_pass_of_the_sensor_is_no_noise_of_the_truth(make: str) -> None:
    """Of a motion m that falls with frequency the recording has ``|H|² m``, or m of ``m + n``."""
    rng = np.random.default_rng(7)
    f = np.linspace(6.0, 40.0, 12)
    white, number = np.ones(12), np.full(12, 200.0)
    motion = 100.0 / np.square(f / 6.0)
    gain = 1.0 / np.sqrt(1.0 + np.square(f / 15.0))
    if make == "low-pass":
        shown, shared, left = motion, gain * motion, np.square(gain) * motion
    else:
        shown, shared, left = motion / gain, motion, motion
    power = (left + white) * (1.0 + rng.normal(size=12) / np.sqrt(number))
    assert _low_passed(shown, shared, power, white, number) == (make == "low-pass")
