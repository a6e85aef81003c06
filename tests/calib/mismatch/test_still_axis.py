"""Axes that a sensor never turned about: what it shows there is how the others turned, askew."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from calib.types import FloatArray

GRAVITY, RATE = 9.80665, 50.0
ACCEL, GYRO = 0.01, 5e-4
"""Noise of one sample."""


def turned(axes: FloatArray, misalignment: FloatArray, seed: int) -> Recording:
    """Return rests of 3 s, and turns of a motor about some of the sensor's axes (k, 3) between."""
    rng = np.random.default_rng(seed)
    mat = mat_from_rotvec(rng.normal(0.0, 1.0, 3))
    force, rate = [np.repeat((mat.T @ [0, 0, GRAVITY])[None], 200, axis=0)], [np.zeros((200, 3))]
    share = np.linspace(0.0, 1.0, round(1.6 * RATE) + 1)[1:]
    done = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    pace = 30.0 * np.square(share * (1.0 - share)) / 1.6
    for k in range(30):
        axis = axes[k % len(axes)]
        angle = rng.uniform(0.8, 2.8) * rng.choice([-1.0, 1.0])
        every = mat @ mat_from_rotvec(angle * done[:, None] * axis)
        mat = every[-1]
        rest = np.repeat((mat.T @ [0, 0, GRAVITY])[None], round(3.0 * RATE), axis=0)
        force += [GRAVITY * every[:, 2], rest]
        rate += [angle * pace[:, None] * axis, np.zeros((len(rest), 3))]
    true_force, true_rate = np.vstack(force), np.vstack(rate)
    bias, scale = rng.normal(0.0, 0.02, 3), rng.normal(0.0, 0.01, 3)
    gyro = true_rate @ (np.diag(1.0 + scale) + misalignment).T + bias
    noise = rng.normal(size=(len(gyro), 6)) * np.repeat([ACCEL, GYRO], 3)
    time = np.arange(len(gyro)) / RATE
    return Recording(time, true_force + noise[:, :3], gyro + noise[:, 3:], "device")


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_the_axis_that_never_turned_has_a_misalignment_and_no_scale_factor_of_minus_one(seed):
    two = np.eye(3)[:2]
    there = np.zeros((3, 3))
    there[2, 0] = 2e-3
    found = diagnose_recording(turned(two, there, seed), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "gyro_misalignment"
    assert item.channels == ("gyro.z",)
    value = item.parameters["mzx"]
    assert value.sigma is not None
    assert abs(value.value - 2e-3) < 4.0 * value.sigma < 4e-4
    assert not found.unexplained
    clean = diagnose_recording(turned(two, np.zeros((3, 3)), seed), gravity=GRAVITY)
    assert not clean.findings
    assert not clean.unexplained


@pytest.mark.long
def test_what_no_pose_shows_has_not_moved_since_a_calibration():
    """With turns about x alone gravity is never along it: its scale factor may be anything."""
    axes = np.eye(3)[:1]
    known = SensorModel(Triad(), Triad())
    found = diagnose_recording(turned(axes, np.zeros((3, 3)), 3), gravity=GRAVITY, model=known)
    assert not found.findings
    assert not found.unexplained
    sigma = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    for name, value in {
        **found.model.accel.parameters("accel"),
        **found.model.gyro.parameters("gyro"),
    }.items():
        if ".bias." not in name and name in sigma:
            assert abs(value) < 4.0 * sigma[name] + 0.05, name
            assert sigma[name] < 0.06, name


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_turns_about_one_axis_leave_half_of_a_calibration_open_and_that_is_said(seed):
    found = diagnose_recording(turned(np.eye(3)[:1], np.zeros((3, 3)), seed), gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert not found.findings
    (missing,) = [text for text in found.missing if text.startswith("motion that determines")]
    assert "accel.scale_factor_error.x" in missing


@pytest.mark.long
def test_what_priors_hold_has_absorbed_no_more_than_there_was():
    two = np.eye(3)[:2]
    there = np.zeros((3, 3))
    there[2, 0] = 2e-3
    (item,) = diagnose_recording(turned(two, there, 1), gravity=GRAVITY).findings
    # A part is within 5 %, and that holds it; it was -4.1 and 2.6 once.
    assert all(abs(a.shift) < 0.2 for a in item.absorbed_by if "scale" in a.parameter)
