"""One turn in which something happened: it is said, and hides nothing else."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import Diagnosis, diagnose_recording
from calib.recording import Recording
from calib.statics import find_poses

from ..bench import GRAVITY, recording, with_added

ODD = "this one turn"


def in_turn(real: Recording, number: int, seconds: float) -> np.ndarray:
    """Return the samples of so many seconds in the middle of a turn, as 0 and 1."""
    poses = find_poses(real)
    middle = 0.5 * (real.time[poses.stop[number]] + real.time[poses.start[number + 1]])
    return 1.0 * (np.abs(real.time - middle) <= 0.5 * seconds)


@cache
def plain() -> Recording:
    return recording(seed=3, poses=16)


def diagnosed(real: Recording) -> Diagnosis:
    return diagnose_recording(real, gravity=GRAVITY)


@pytest.mark.parametrize(
    ("channel", "size", "seconds"),
    [("gyro.y", 0.05, 0.2), ("gyro.x", -0.1, 0.1), ("gyro.z", 0.1, 0.1)],
)
def test_a_turn_that_a_gyroscope_misread_is_said_with_channel_and_moment(
    channel: str, size: float, seconds: float
) -> None:
    pulse = in_turn(plain(), 6, seconds + 0.021)
    found = diagnosed(with_added(plain(), {channel: size * pulse}))
    assert found.findings == ()
    (left,) = found.unexplained
    assert left.follows.startswith(ODD)
    assert channel in left.channels
    assert all(c.startswith("gyro") for c in left.channels)
    start, stop = left.intervals[0]
    at = plain().time[pulse > 0]
    assert start <= at.mean() <= stop
    assert stop - start < 1.0


def test_an_accelerometer_s_turn_is_off_in_velocity() -> None:
    pulse = in_turn(plain(), 6, 0.3)
    found = diagnosed(with_added(plain(), {"accel.z": 3.0 * pulse}))
    (left,) = found.unexplained
    assert left.follows.startswith(ODD)
    assert "m/s" in left.follows
    assert "accel.z" in left.channels
    assert not any(c.startswith("gyro") for c in left.channels)


def test_nothing_is_said_of_turns_that_are_alike() -> None:
    found = diagnosed(plain())
    assert found.verdict == "consistent"
    # Nor where many do not close: that is noise of turns.
    rng = np.random.default_rng(1)
    pulses = sum(rng.normal(0, 0.05) * in_turn(plain(), k, 0.2) for k in range(15))
    assert not any(
        u.follows.startswith(ODD)
        for u in diagnosed(with_added(plain(), {"gyro.y": np.asarray(pulses)})).unexplained
    )


@pytest.mark.parametrize(("number", "seed"), [(3, 6), (3, 7), (4, 3), (5, 3)])
def test_turns_that_follow_each_other_are_said_as_one(number: int, seed: int) -> None:
    """A gyroscope is late for a while: many turns do not close, and they are no noise of all."""
    real = recording(seed=seed, poses=20)
    poses = find_poses(real)
    start, stop = poses.interval[5, 1], poses.interval[5 + number, 0]
    inside = (real.time > start - 0.5) & (real.time < stop + 0.5)
    late = np.roll(real.gyro, 1, axis=0)
    found = diagnosed(replace(real, gyro=np.where(inside[:, None], late, real.gyro)))
    assert found.findings == ()
    (left,) = found.unexplained
    assert left.follows.startswith(f"these {number} turns: they do not close, by up to ")
    assert left.intervals[0] == pytest.approx((start, stop), abs=1.0)


@pytest.mark.long
def test_two_turns_are_said_and_hide_no_effect() -> None:
    term = Term("gyro_scale_asymmetry", {"kx": 1.5e-3, "ky": 0.0, "kz": 0.0})
    whole = recording(term, seed=3, poses=26)
    sure = diagnosed(whole)
    assert [f.effect for f in sure.findings] == ["gyro_scale_asymmetry"]
    odd = 0.05 * in_turn(whole, 4, 0.2), 0.1 * in_turn(whole, 15, 0.2)
    found = diagnosed(with_added(whole, {"gyro.z": odd[0], "gyro.y": odd[1]}))
    assert [f.effect for f in found.findings] == ["gyro_scale_asymmetry"]
    assert [u.follows.split(":")[0] for u in found.unexplained] == [ODD, ODD]
    before, after = (d.findings[0].parameters["kx"] for d in (sure, found))
    assert after.value == pytest.approx(before.value, abs=2.0 * (before.sigma or 0.0))
    assert (after.sigma or 0.0) < 1.3 * (before.sigma or 0.0)
