"""Comparisons without noise: what the computation errs by is no effect."""

from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.effects.base import Term
from calib.errors import ImuError, NoCommonMotionError, RecordingError
from calib.mismatch import diagnose_against, diagnose_recording, diagnose_reference
from calib.mismatch.noise.hush import least_noise
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.floor import audible_beside, interpolation_error
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel

GRAVITY = 9.80665
WAYS = [diagnose_against, diagnose_reference]
MISALIGNED = Term("gyro_misalignment", {"mxy": 0.005, "mzx": -0.004})


@cache
def motion() -> Motion:
    rng = np.random.default_rng(6)
    return bench_protocol(rng, poses=8, first_pose=1.0, pose_duration=(2.0, 3.0))


def made(rate: float, *terms: Term, noise: NoiseModel | None = None) -> Recording:
    model, rng = SensorModel(terms=terms), np.random.default_rng(7)
    return simulate(motion(), model, noise or NoiseModel(), rng=rng, rate=rate)


def rounded(recording: Recording, digits: int) -> Recording:
    accel, gyro = recording.accel.round(digits), recording.gyro.round(digits)
    return replace(recording, accel=accel, gyro=gyro)


@pytest.mark.parametrize("diagnose", WAYS)
@pytest.mark.parametrize(("rate", "other"), [(50, 64), (50, 80), (100, 64), (50, 50)])
def test_two_simulations_of_one_motion_are_consistent(diagnose, rate, other):
    found = diagnose(made(rate), made(other), gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert found.summary["alignment"]["offset"] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(("rate", "other"), [(50, 80), (50, 50)])
@pytest.mark.long
def test_a_term_of_one_is_found_with_its_size(rate, other):
    found = diagnose_against(made(rate, MISALIGNED), made(other), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["gyro_misalignment"]
    assert not found.unexplained
    for name, value in MISALIGNED.parameters.items():
        assert found.findings[0].parameters[name].value == pytest.approx(value, rel=1e-3)


def test_a_step_among_samples_that_are_alike_leaves_no_channel_stuck():
    step = Term("gyro_bias_step", {"bx": 0.001, "moment": 14.0})
    found = diagnose_against(made(50, step), made(50), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["gyro_bias_step"]
    assert not found.unexplained


@pytest.mark.parametrize(
    ("diagnose", "noisy", "other"), [(WAYS[0], True, False), (WAYS[1], False, True)]
)
def test_noise_in_one_of_them_is_no_effect(diagnose, noisy, other):
    real, truth = (made(r, noise=CONSUMER if n else None) for r, n in ((50, noisy), (64, other)))
    assert diagnose(real, truth, gravity=GRAVITY).verdict == "consistent"


@pytest.mark.parametrize("digits", [4, 6])
def test_digits_of_a_file_are_nothing_but_counts(digits):
    real, truth = rounded(made(50), digits), rounded(made(64), digits)
    found = diagnose_against(real, truth, gravity=GRAVITY)
    assert {f.effect for f in found.findings} <= {"quantization"}
    assert not found.unexplained


def test_a_copy_with_noise_is_still_refused():
    real = made(50, noise=CONSUMER)
    with pytest.raises(NoCommonMotionError, match="one recording"):
        diagnose_against(real, real, gravity=GRAVITY)


@pytest.mark.parametrize(("rate", "other"), [(50, 64), (50, 80), (100, 64)])
def test_where_splines_agree_the_error_between_samples_is_small(rate, other):
    real, truth = made(rate), RecordingTruth(made(other), GRAVITY)
    known = truth.covers(real.time)
    own = truth.state(real.time)
    wrong = np.hstack((own.force - real.accel, own.rate - real.gyro)) / least_noise(real.interval)
    said = interpolation_error(truth, real.time, np.eye(3)) / least_noise(real.interval)
    exact = known & (said < 0.1).all(axis=1)
    assert exact[known].mean() > 0.5
    assert np.square(wrong[known]).sum(axis=0).min() > 1e3
    assert np.square(wrong[exact]).sum(axis=0).max() < 40.0


def test_at_a_sample_nothing_is_between():
    truth = RecordingTruth(made(64), GRAVITY)
    assert interpolation_error(truth, truth.recording.time, np.eye(3)).max() < 1e-12


def test_a_recording_with_noise_stays_as_it_is():
    real, truth = made(50, noise=CONSUMER), RecordingTruth(made(64), GRAVITY)
    good = np.zeros(len(real), bool)
    same = Alignment(0.0, 0.0, 0.0, 1.0)
    assert audible_beside(real, truth, same, np.eye(3), good) is None
    heard = audible_beside(made(50), truth, same, np.eye(3), good)
    assert heard is not None
    assert 0.0 < heard.spoilt.mean() < 0.5


def _with(gyro=None, accel=None):
    real = made(50)
    parts = {"gyro": gyro, "accel": accel}
    return replace(real, **{k: f(getattr(real, k)) for k, f in parts.items() if f})


@pytest.mark.parametrize("values", [1e6, 1e30, 1e200])
def test_values_that_no_unit_makes_are_refused_by_name(values):
    loud = _with(gyro=lambda x: x * values)
    ways = [
        lambda: diagnose_recording(loud, gravity=GRAVITY),
        lambda: diagnose_against(loud, made(64), gravity=GRAVITY),
        lambda: diagnose_reference(loud, made(64), gravity=GRAVITY),
        lambda: diagnose_against(made(50), loud, gravity=GRAVITY),
    ]
    for number, way in enumerate(ways):
        if values > 1e6:
            with pytest.raises(RecordingError, match=r"gyro\.x .* reaches .*e\+"):
                way()
        elif number == 3:
            with pytest.raises(NoCommonMotionError, match="times as fast"):
                way()
        else:
            assert [f.effect for f in way().findings] == ["unit_error"]


@pytest.mark.parametrize(
    "bad",
    [
        {"gyro": lambda x: 0.0 * x, "accel": lambda x: 0.0 * x},
        {"gyro": lambda x: x * [0.0, 1.0, 1.0]},
        {"gyro": lambda x: x * [0.0, 1.0, 1.0] + [1e6, 0.0, 0.0]},
        {"accel": lambda x: x * [1.0, 1.0, 0.0] + [0.0, 0.0, 9.8]},
        {"gyro": lambda x: x + 1e6},
        {"accel": lambda x: 0.0 * x},
    ],
)
@pytest.mark.long
def test_columns_that_do_not_move_end_in_a_verdict_or_a_clear_error(bad):
    real, good = _with(**bad), made(64)
    for one, other in ((real, good), (good, real)):
        for diagnose in WAYS:
            with suppress(ImuError):
                found = diagnose(one, other, gravity=GRAVITY)
                assert found.findings or found.unexplained or found.missing
    assert diagnose_recording(real, gravity=GRAVITY).verdict != "consistent"


def test_a_channel_that_is_stuck_is_named():
    real = made(50, noise=CONSUMER)
    real = replace(real, gyro=real.gyro * [0.0, 1.0, 1.0])
    found = diagnose_against(real, made(64), gravity=GRAVITY)
    assert found.verdict == "unexplained"
    assert found.unexplained[0].channels == ("gyro.x",)
    with pytest.raises(NoCommonMotionError, match=r"gyro\.x: it is stuck"):
        diagnose_reference(made(64, noise=CONSUMER), real, gravity=GRAVITY)


def test_gaps_everywhere_are_said():
    """A slow reference is compared over stretches that a log without half of its samples lacks."""
    recording, reference = made(100, noise=CONSUMER), made(20, noise=CONSUMER)
    kept = np.random.default_rng(8).random(len(recording)) > 0.5
    parts = {n: getattr(recording, n)[kept] for n in ("time", "accel", "gyro", "temperature")}
    with pytest.raises(NoCommonMotionError, match="torn by gaps"):
        diagnose_reference(replace(recording, **parts, lost=None), reference, gravity=GRAVITY)
