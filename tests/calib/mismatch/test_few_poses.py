"""From few poses and turns nobody can tell what physics they differ by."""

from __future__ import annotations

import numpy as np
import pytest

from calib.effects import effects
from calib.effects.base import Term
from calib.mismatch import Diagnosis, diagnose_recording
from calib.mismatch.engine import _in_motion
from calib.recording import Recording

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


def test_enough_poses_tell_it() -> None:
    assert "gyro_g_sensitivity" in {f.effect for f in _diagnose(9, _OF_POSE).findings}


def test_what_changes_within_few_rests_has_its_name() -> None:
    warm = Term("gyro_warm_up", {"kx": 0.02, "tau": 8.0})
    found = _diagnose(3, warm)
    assert {f.effect for f in found.findings} == {"gyro_warm_up"}
    assert found.unexplained == ()


def test_two_turns_leave_the_gyroscope_open() -> None:
    slugs = {slug for slug, effect in effects().items() if _in_motion(effect)}
    assert {"gyro_misalignment", "gyro_anisoinertia", "accel_size_effect", "bandwidth"} <= slugs
    assert not {"gyro_g_sensitivity", "gyro_warm_up", "accel_quadratic", "earth_rate"} & slugs


def test_one_sample_is_undetermined() -> None:
    one = Recording(np.zeros(1), np.array([[0.0, 0.0, 9.8]]), np.zeros((1, 3)), "device")
    assert diagnose_recording(one, gravity=GRAVITY).verdict == "undetermined"
