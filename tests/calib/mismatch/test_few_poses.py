"""From few poses and turns nobody can tell what physics they differ by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import Gravity
from calib.effects import effects
from calib.effects.base import Term
from calib.mismatch import Diagnosis, diagnose_recording
from calib.mismatch.engine import _in_motion
from calib.mismatch.missing import with_turns
from calib.mismatch.samples.spectrum import LOUDER_THERE
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER
from calib.simulation.turntable import turntable
from calib.statics import find_poses

from .bench import GRAVITY, recording

_OF_POSE = Term("gyro_g_sensitivity", {"gxx": 5e-4, "gyz": -4e-4, "gzy": 3e-4})


def _diagnose(poses: int, *terms: Term, seed: int = 3) -> Diagnosis:
    return diagnose_recording(recording(*terms, poses=poses, seed=seed), gravity=GRAVITY)


@pytest.mark.parametrize("poses", [2, 3, 4])
def test_what_differs_between_few_poses_has_no_name(poses: int) -> None:
    found = _diagnose(poses, _OF_POSE, seed=5)
    assert {f.effect for f in found.findings} <= {"gyro_misalignment"}
    (left,) = found.unexplained
    assert left.follows == "the pose: too few of them to tell by what"
    assert set(left.channels) <= {"gyro.x", "gyro.y", "gyro.z"}
    assert any(text.startswith("enough poses") for text in found.missing)
    # Nor is what has no name a term of the model, which is applied.
    assert {t.effect for t in found.model.terms} == {f.effect for f in found.findings}


@pytest.mark.parametrize("poses", [1, 2, 3])
def test_of_few_poses_no_parameter_is_said_to_have_moved(poses: int) -> None:
    """What only goes with others seemed to be known to nothing, and to have moved by 5 %."""
    real = recording(poses=14)
    whole = diagnose_recording(real, gravity=GRAVITY)
    known = whole.calibration(real, gravity=Gravity(GRAVITY))
    assert known.complete
    few = real.slice(0, int(find_poses(real).stop[poses - 1]))
    found = diagnose_recording(few, gravity=GRAVITY, model=known.model).beside(known, few)
    assert found.moved == ()
    now = found.calibration(few, gravity=Gravity(GRAVITY))
    assert set(now.names) | set(now.undetermined) >= set(known.names)
    assert {name for name in known.names if name.startswith("accel.")} <= set(now.undetermined)
    if poses == 1:
        # What it says nothing of is as the calibration has it.
        for name in set(now.undetermined) & set(known.names):
            assert now.values[name] == pytest.approx(known.values[name], abs=1e-3)


@pytest.mark.parametrize("poses", [1, 2])
def test_what_few_poses_say_holds(poses: int) -> None:
    rng = np.random.default_rng(100 * poses)
    motion = bench_protocol(rng, poses=poses, first_pose=5.0, pose_duration=(5.0, 7.0))
    accel = Triad(rng.normal(0, 0.2, 3), rng.normal(0, 0.01, 3))
    true = SensorModel(accel, Triad(rng.normal(0, 0.01, 3)))
    real = simulate(motion, true, CONSUMER, rng=rng, rate=100.0)
    found = diagnose_recording(real, gravity=GRAVITY).calibration(real, gravity=Gravity(GRAVITY))
    truth = {**true.accel.parameters("accel"), **true.gyro.parameters("gyro")}
    assert {"gyro.bias.x", "gyro.bias.y", "gyro.bias.z"} <= set(found.names)
    for name, sigma in zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True):
        assert abs(found.values[name] - truth[name]) < 4.0 * sigma, name


@pytest.mark.long
def test_enough_poses_tell_it() -> None:
    assert "gyro_g_sensitivity" in {f.effect for f in _diagnose(9, _OF_POSE).findings}


def test_what_changes_within_few_rests_has_its_name() -> None:
    warm = Term("gyro_warm_up", {"kx": 0.02, "tau": 8.0})
    found = _diagnose(3, warm)
    assert {f.effect for f in found.findings} == {"gyro_warm_up"}
    assert found.unexplained == ()


@pytest.mark.parametrize("seed", [4, 6])
def test_of_few_shaken_poses_nothing_is_said_but_where_they_shake(seed: int) -> None:
    """What shakes their means allowed for sensors of many g, and no fit came back from there."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=9, first_pose=5.0, vibration=2.0)
    real = simulate(motion, SensorModel(), CONSUMER.scaled(0.1), rng=rng, rate=50.0)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert found.findings == ()
    assert {left.follows for left in found.unexplained} <= {LOUDER_THERE}


def test_two_turns_leave_the_gyroscope_open() -> None:
    slugs = {slug for slug, effect in effects().items() if _in_motion(effect)}
    assert {"gyro_misalignment", "gyro_anisoinertia", "accel_size_effect", "bandwidth"} <= slugs
    assert not {"gyro_g_sensitivity", "gyro_warm_up", "accel_quadratic", "earth_rate"} & slugs


def test_one_sample_is_undetermined() -> None:
    one = Recording(np.zeros(1), np.array([[0.0, 0.0, 9.8]]), np.zeros((1, 3)), "device")
    assert diagnose_recording(one, gravity=GRAVITY).verdict == "undetermined"


def test_on_the_faces_of_a_cube_turns_tell_of_the_axes_too() -> None:
    """Six directions of gravity leave nine parameters open, but for the turns between them."""
    rng = np.random.default_rng(2)
    motion = make_motion("rate-table", rng=rng, duration=120.0, gravity=GRAVITY)
    axes = Triad(rng.normal(0, 0.1, 3), rng.normal(0, 0.01, 3))
    real = simulate(motion, SensorModel(axes), CONSUMER, rng=rng, rate=50.0)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert not any(text.startswith("enough poses") for text in found.missing)


def test_what_few_faces_lack_is_said_with_what_else_would_do() -> None:
    rng = np.random.default_rng(3)
    motion = turntable((), faces=("+z", "-z", "+x", "-x", "+y", "-y"))
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=50.0)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert "6 distinct ones" in found.missing[0]
    assert "or 9 rests" in found.missing[0]


def test_what_turns_leave_open_is_said_by_name() -> None:
    lacks = ("enough poses: it has 6", "a valid clock")
    open_ = with_turns(lacks, 6, rests=12, left_open=["accel.misalignment.xy"])
    assert open_ == (
        "enough poses: it has 6; the turns between its 12 rests leave accel.misalignment.xy open",
        "a valid clock",
    )
    assert with_turns(lacks, 6, rests=12, left_open=[]) == ("a valid clock",)
    # From one pose there are no turns that tell.
    assert with_turns(lacks, 1, rests=2, left_open=[]) == lacks


@pytest.mark.long
def test_rests_that_lean_as_they_like_are_no_rival_of_axes_that_lie_askew() -> None:
    """In rests of minutes a fluctuation closes any turn; axes a degree askew do not go straight."""
    rng = np.random.default_rng(4)
    motion = bench_protocol(rng, poses=26, pose_duration=(12.0, 125.0), turn_duration=(1.2, 1.8))
    askew = dict(
        zip(("mxy", "mxz", "myx", "myz", "mzx", "mzy"), rng.normal(0, 0.009, 6), strict=True)
    )
    model = SensorModel(
        Triad(rng.normal(0, 0.1, 3)),
        Triad(rng.normal(0, 0.01, 3)),
        (Term("gyro_misalignment", askew),),
    )
    noise = replace(CONSUMER, gyro_noise_density=3e-4)
    found = diagnose_recording(simulate(motion, model, noise, rng=rng, rate=50.0), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["gyro_misalignment"]
    assert found.unexplained == ()
    for name, q in found.findings[0].parameters.items():
        assert q.value == pytest.approx(askew[name], abs=3.5 * q.sigma)
