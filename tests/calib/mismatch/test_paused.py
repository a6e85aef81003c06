"""Recordings that were stopped while the sensor was turned: rests alone, with holes between."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.recording import Recording
from calib.statics import find_poses

from .bench import GRAVITY, recording


def paused(real: Recording) -> Recording:
    """Return the rests of a recording, and nothing of the turns between them."""
    poses = find_poses(real)
    keep = np.concatenate([np.arange(a, b) for a, b in zip(poses.start, poses.stop, strict=True)])
    return Recording(
        real.time[keep],
        real.accel[keep],
        real.gyro[keep],
        "device",
        temperature=None if real.temperature is None else real.temperature[keep],
    )


@pytest.mark.long
def test_turns_that_nobody_recorded_disagree_with_nothing():
    found = diagnose_recording(paused(recording(poses=24)), gravity=GRAVITY)
    assert not found.unexplained
    assert not found.findings
    (lack,) = (m for m in found.missing if m.startswith("turns with all of their samples"))
    assert "in 23 of 23" in lack


@pytest.mark.long
def test_rests_alone_tell_of_products_of_gravity():
    term = Term("accel_cross_product", {"ky_xy": 4e-4})
    found = diagnose_recording(paused(recording(term, poses=30)), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "accel_cross_product"
    value = item.parameters["ky_xy"]
    assert value.sigma is not None
    assert abs(value.value - 4e-4) < 4.0 * value.sigma


def test_a_clock_that_is_set_in_a_recording_takes_no_time_for_the_years_between():
    real = recording(seed=4)
    late = replace(real, time=real.time + 1.7e9 * (np.arange(len(real)) > 0.5 * len(real)))
    found = diagnose_recording(late, gravity=GRAVITY)
    assert any("time is missing" in text for text in found.missing)


def test_what_fades_longer_than_a_recording_lasts_is_said_up_to_its_end():
    rng = np.random.default_rng(5)
    time = np.arange(1200) / 100.0
    accel = np.tile([0.0, 0.0, GRAVITY], (1200, 1)) + 0.03 * rng.normal(size=(1200, 3))
    accel[:, 2] += 0.2 * np.exp(-time / 4.0)
    still = Recording(time, accel, 5e-4 * rng.normal(size=(1200, 3)), "device")
    found = diagnose_recording(still, gravity=GRAVITY)
    assert found.findings or found.unexplained
    for item in (*found.findings, *found.unexplained):
        assert all(0.0 <= a <= b <= time[-1] + 0.01 for a, b in item.intervals)
