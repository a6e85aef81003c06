"""Counts that are coarse beside the noise: rounding is said, and nothing that it mimics."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from ..bench import GRAVITY
from ..bench import recording as simulated

NOISE = {"accel": CONSUMER.accel_noise_density * 5.0, "gyro": CONSUMER.gyro_noise_density * 5.0}
"""Of one sample at 50 Hz."""


@cache
def recorded(seed: int) -> Recording:
    return bench(seed, duration=90.0)


def bench(seed: int, *terms: Term, duration: float) -> Recording:
    rng = np.random.default_rng(seed)
    motion = make_motion("bench", rng=rng, duration=duration, gravity=9.80665)
    accel, gyro = Triad(rng.normal(0, 0.2, 3)), Triad(rng.normal(0, 0.01, 3))
    model = SensorModel(accel, gyro, terms=terms)
    return simulate(motion, model, CONSUMER, rng=rng, rate=50.0)


@pytest.mark.parametrize(
    ("seed", "triad", "times"), [(131, "gyro", 12.0), (132, "gyro", 25.0), (131, "accel", 25.0)]
)
@pytest.mark.long
def test_counts_of_many_times_the_noise_leave_nothing_else_to_say(
    seed: int, triad: str, times: float
) -> None:
    made = recorded(seed)
    lsb = times * NOISE[triad]
    coarse = replace(made, **{triad: np.round(getattr(made, triad) / lsb) * lsb})
    found = diagnose_recording(coarse, gravity=9.80665)
    assert [f.effect for f in found.findings] == ["quantization"]
    assert found.findings[0].parameters[f"{triad}_lsb"].value == pytest.approx(lsb, rel=1e-3)
    assert not found.unexplained
    assert any("finer counts" in text for text in found.missing)


ASYMMETRY = Term("gyro_scale_asymmetry", {"kx": 4e-3, "ky": -4e-3, "kz": 4e-3})
QUADRATIC = Term("accel_quadratic", {"kx": 3e-3, "ky": -3e-3, "kz": 3e-3})


@pytest.mark.parametrize(
    ("triad", "term", "shown"),
    [("gyro", ASYMMETRY, "only its turns tell"), ("accel", QUADRATIC, "only means of its rests")],
)
@pytest.mark.long
def test_something_tells_of_coarse_counts(triad: str, term: Term, shown: str) -> None:
    """In a turn a gyroscope passes many counts; and means of rests err in a way that is known."""
    made = bench(137, term, duration=120.0)
    lsb = 12.0 * NOISE[triad]
    coarse = replace(made, **{triad: np.round(getattr(made, triad) / lsb) * lsb})
    found = diagnose_recording(coarse, gravity=9.80665)
    assert any(shown in text for text in found.missing)
    assert not found.unexplained
    counts, effect = found.findings
    assert (counts.effect, effect.effect) == ("quantization", term.effect)
    for name, true in term.parameters.items():
        value = effect.parameters[name]
        assert value.sigma is not None
        assert abs(value.value - true) < 4.0 * value.sigma


@pytest.mark.parametrize(
    ("kind", "seed", "duration", "noise", "rate", "lsb"),
    [
        pytest.param("vibrating", 9, 120.0, 0.1, 50.0, 0.2, id="shaken in a third of its rests"),
        pytest.param("record-player", 1, 60.0, 1.0, 100.0, 0.3, id="stuck in a rest"),
    ],
)
@pytest.mark.long
def test_coarse_counts_of_an_accelerometer_are_all_that_is_found(
    kind: str, seed: int, duration: float, noise: float, rate: float, lsb: float
) -> None:
    rng = np.random.default_rng(seed)
    motion = make_motion(kind, rng=rng, duration=duration, gravity=9.80665)
    made = simulate(motion, SensorModel(), CONSUMER.scaled(noise), rng=rng, rate=rate)
    coarse = replace(made, accel=np.round(made.accel / lsb) * lsb)
    found = diagnose_recording(coarse, gravity=9.80665)
    assert [f.effect for f in found.findings] == ["quantization"]


@pytest.mark.long
def test_rounding_that_is_half_hidden_follows_nothing() -> None:
    """What the Earth turns moves levels between counts: their errors follow the orientation."""
    rng = np.random.default_rng(22)
    motion = bench_protocol(rng, poses=30, pose_duration=(5.0, 7.0))
    model = SensorModel(terms=(Term("earth_rate", {"north": 5.08e-5, "up": 5.23e-5}),))
    made = simulate(motion, model, CONSUMER.scaled(0.1), rng=rng, rate=50.0)
    lsb = 4.0 * 0.1 * NOISE["gyro"]
    found = diagnose_recording(replace(made, gyro=np.round(made.gyro / lsb) * lsb), gravity=9.80665)
    assert [f.effect for f in found.findings] == ["quantization", "earth_rate"]
    assert not found.unexplained


@pytest.mark.long
def test_counts_that_noise_hides_are_no_matter() -> None:
    made = recorded(134)
    lsb = 0.5 * NOISE["gyro"]
    found = diagnose_recording(replace(made, gyro=np.round(made.gyro / lsb) * lsb), gravity=9.80665)
    assert found.verdict == "consistent"
    assert not any("finer counts" in text for text in found.missing)


@pytest.mark.parametrize("seed", [135, 136])
@pytest.mark.long
def test_an_extreme_value_that_is_stuck_once_is_no_full_scale(seed: int) -> None:
    made = recorded(seed)
    gyro = made.gyro.copy()
    at = int(np.argmax(np.abs(gyro[:, 2])))
    gyro[at : at + 30, 2] = gyro[at, 2] * 1.02
    found = diagnose_recording(replace(made, gyro=gyro), gravity=9.80665)
    assert not found.findings
    (item,) = found.unexplained
    assert item.channels == ("gyro.z",)
    assert "stuck" in item.follows
    assert item.intervals[0][0] == pytest.approx(made.time[at], abs=0.1)


@pytest.mark.parametrize("share", [0.8, 0.94])
@pytest.mark.long
def test_a_full_scale_is_one_if_it_is_reached_but_once(share: float) -> None:
    made = recorded(137)
    limit = share * float(np.abs(made.gyro).max())
    found = diagnose_recording(replace(made, gyro=np.clip(made.gyro, -limit, limit)), gravity=9.8)
    assert found.findings[0].effect == "saturation"
    assert found.findings[0].parameters["gyro_full_scale"].value == pytest.approx(limit)


@pytest.mark.long
def test_a_bias_that_sticks_to_a_coarse_count_at_rest_is_no_second_finding() -> None:
    for seed in (3, 5):
        recording = simulated(seed=seed)
        lsb = 1.6e-3
        gyro = np.round(recording.gyro / lsb) * lsb
        found = diagnose_recording(replace(recording, gyro=gyro), gravity=GRAVITY)
        assert [f.effect for f in found.findings] == ["quantization"]
        assert not found.unexplained


def test_counts_are_coarse_though_decimals_cut_their_size() -> None:
    recording = simulated(seed=3)
    lsb = 2 * np.radians(2000.0) / 65536
    gyro = np.round(np.round(recording.gyro / 1.5 / lsb) * lsb, 6)
    (finding,) = look_at_samples(replace(recording, gyro=gyro), find_poses(recording)).findings
    assert finding.parameters["gyro_lsb"].value == pytest.approx(lsb, rel=1e-4)


def test_counts_are_coarse_though_a_rest_has_a_few_jerks() -> None:
    recording = simulated(seed=3)
    poses = find_poses(recording)
    gyro = np.round(recording.gyro / 1.6e-3)
    gyro[(poses.start + poses.stop) // 2, 2] += 40
    (finding,) = look_at_samples(replace(recording, gyro=1.6e-3 * gyro), poses).findings
    assert finding.effect == "quantization"
    assert finding.channels == ("gyro.x", "gyro.y", "gyro.z")


@pytest.mark.long
def test_means_off_by_coarse_counts_are_no_second_finding() -> None:
    for seed in (3, 5):
        recording = simulated(seed=seed)
        lsb = 0.1
        accel = np.round(recording.accel / lsb) * lsb
        found = diagnose_recording(replace(recording, accel=accel), gravity=GRAVITY)
        assert [f.effect for f in found.findings] == ["quantization"]
        assert not found.unexplained
