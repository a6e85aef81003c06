"""Signals at other times, and a little beyond their ends."""

import numpy as np
import pytest

from calib.effects import get_effect
from calib.effects.base import Signals
from calib.effects.resampling import FURTHER, resample


def test_a_parabola_goes_on_beyond_uneven_ends_and_is_held_then():
    rng = np.random.default_rng(1)
    time = np.sort(rng.uniform(0.0, 1.0, 12))
    values = np.stack((1 + 2 * time - 3 * time**2, time**2), axis=1)
    before, after = time[1] - time[0], time[-1] - time[-2]
    at = np.array([time[0] - 0.4 * before, 0.5, time[-1] + 2.5 * after])
    true = np.stack((1 + 2 * at - 3 * at**2, at**2), axis=1)
    assert resample(time, values, at) == pytest.approx(true, abs=1e-12)
    last = time[-1] + FURTHER * after * np.array([1.0, 3.0])
    assert np.ptp(resample(time, values, last), axis=0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("count", [1.0, 3.0, 0.999])
def test_who_ends_in_a_motion_loses_samples_and_does_not_stop(count: float):
    time = np.arange(400) / 100.0
    moving = np.sin(2 * np.pi * 0.7 * time)[:, None] * np.ones(3)
    effect = get_effect("dropped_samples")
    shown = effect.transform(time, Signals(moving, moving), {"count": count, "moment": 2.0})
    true = np.sin(2 * np.pi * 0.7 * (time + 0.01 * count * (time >= 2.0)))
    assert np.abs(shown.gyro[:, 0] - true).max() < 1e-3
