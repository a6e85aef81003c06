"""A sensor that slips in its mount, beside a truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_against
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from tests.calib.mismatch.reference.test_against import GRAVITY, recorded, sensor, simulation

SLIP = np.radians([0.3, -0.8, 0.5])
AT = 21.3
"""s, in the recording's own time."""


def slipped(turn: np.ndarray, *, jolt: bool, seed: int = 2) -> Recording:
    """Return a recording whose sensor is turned by a rotation vector from a moment on.

    With ``jolt`` its gyroscope measures that it turns, as one that turns with its mount does.
    """
    real, model = recorded(seed=seed), sensor(np.random.default_rng(seed))
    accel, gyro = model.accel.correct(real.accel), model.gyro.correct(real.gyro)
    after, back = real.time >= AT, mat_from_rotvec(-turn)
    accel[after], gyro[after] = accel[after] @ back.T, gyro[after] @ back.T
    if jolt:
        gyro[int(np.argmax(after))] += turn / real.interval
    return replace(real, accel=model.accel.distort(accel), gyro=model.gyro.distort(gyro))


@pytest.mark.parametrize(("size", "jolt"), [(1.0, False), (1.0, True), (0.03, True), (5.0, True)])
def test_a_slip_is_one_statement_with_its_moment_and_angle(size: float, jolt: bool):
    turn = size * SLIP
    real = slipped(turn, jolt=jolt)
    found = diagnose_against(real, simulation(), gravity=GRAVITY)
    assert not found.findings
    (item,) = found.unexplained
    ((start, stop),) = item.intervals
    assert start == pytest.approx(AT, abs=0.1 if size > 0.1 else 5.0)
    assert stop > real.time[-1] - 5.0
    assert item.channels == ("accel.x", "accel.y", "accel.z", "gyro.x", "gyro.y", "gyro.z")
    said, number = item.follows.split(", by ")
    assert said == "a slip of the sensor in its mount"
    angle = float(number.removesuffix("°"))
    assert angle == pytest.approx(np.degrees(np.linalg.norm(turn)), rel=0.1)
