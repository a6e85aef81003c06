"""What a recording tells by itself of heat, vibration and rests, at the times of a comparison."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import State
from calib.mismatch.reference.sensed import (
    ALWAYS_MOVING,
    SETTLED,
    find_stillness,
    find_warmth,
    vibration,
)
from calib.statics import find_poses

from ..bench import recording


def test_warmth_is_put_into_a_state_and_there_is_none_without_a_thermometer() -> None:
    real = recording(poses=6)
    assert real.temperature is not None
    time = real.time[100:400]
    known = find_warmth(real, time)
    state = known.put_into(State(time, real.accel[100:400], real.gyro[100:400]))
    assert state.temperature is not None
    assert state.temperature == pytest.approx(real.temperature[100:400], abs=0.2)
    assert known.typical == pytest.approx(np.median(real.temperature[100:400]), abs=0.2)
    none = find_warmth(replace(real, temperature=None), time)
    assert none.temperature is None
    assert none.slope is None
    assert none.typical is None


def test_rests_are_samples_of_the_times_that_are_compared() -> None:
    real = recording(poses=6)
    poses = find_poses(real)
    # Every other sample, from one second on.
    time = real.time[50::2]
    still = find_stillness(real, time)
    assert len(still.rests) == len(poses)
    assert not len(still.settled)
    assert still.densities is None
    for (first, last), start, stop in zip(
        still.rests[1:], poses.start[1:], poses.stop[1:], strict=True
    ):
        assert time[first] == pytest.approx(real.time[start], abs=2 * real.interval)
        assert time[last - 1] == pytest.approx(real.time[stop - 1], abs=3 * real.interval)
    assert still.gyro == pytest.approx(poses.gyro)
    assert not len(ALWAYS_MOVING.rests)


def test_beside_markers_rests_end_before_a_low_pass_shows_the_motion() -> None:
    real = recording(poses=6)
    still = find_stillness(real, real.time, band=10.0)
    assert still.densities is not None
    apart = SETTLED / 10.0 / real.interval
    assert len(still.settled) == len(still.rests)
    assert still.settled[:, 0] - still.rests[:, 0] == pytest.approx(apart, abs=1.0)
    assert still.rests[:, 1] - still.settled[:, 1] == pytest.approx(apart, abs=1.0)


def test_a_rest_vibrates_by_its_noise_however_large_the_bias() -> None:
    real = recording(poses=6)
    bias = np.array([0.3, -0.2, 0.1])
    shaken = replace(real, gyro=real.gyro + bias)
    poses = find_poses(real)
    here = real.time[poses.start[2] + 20 : poses.stop[2] - 20]
    quiet = vibration(real, here, bias=np.zeros(3))
    assert quiet.shape[1] == 3
    assert vibration(shaken, here, bias=bias) == pytest.approx(quiet)
