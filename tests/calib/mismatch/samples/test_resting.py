"""What samples at rest show, without that of which findings are the cause."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.samples.resting import look_at_rests, unsaid
from calib.mismatch.samples.spectrum import LINE as A_LINE
from calib.mismatch.samples.spectrum import LOUDER_THERE, look_at_spectrum
from calib.mismatch.samples.within import look_within
from calib.poses import average_poses
from calib.recording import Recording

LOUD = Unexplained(("accel.x", "accel.y"), ((3.0, 9.0),), LOUDER_THERE, 1e-9)
LINE = Unexplained(("accel.x",), ((0.0, 20.0), (30.0, 40.0)), "a line at 21 Hz", 1e-9)


def found(effect, channels, **moments):
    values = {name: SimpleNamespace(value=value) for name, value in moments.items()}
    return SimpleNamespace(effect=effect, channels=channels, parameters=values)


def test_what_shakes_a_sensor_is_the_cause_of_louder_noise_and_of_no_line():
    shaken = found("accel_vibration_rectification", ("accel.z",))
    assert unsaid((LOUD, LINE), [shaken]) == (LINE,)
    known = [Term("gyro_vibration_rectification", {"kx": 1e-3})]
    assert unsaid((LOUD, LINE), [], known=known) == (LINE,)
    assert unsaid((LOUD, LINE), [found("accel_warm_up", ("accel.x",))]) == (LOUD, LINE)


@pytest.mark.parametrize(
    ("channel", "moment", "left"),
    [
        ("accel.x", 35.0, ((0.0, 20.0),)),
        ("accel.x", 25.0, LINE.intervals),
        ("gyro.x", 35.0, LINE.intervals),
    ],
)
def test_a_rest_in_which_a_bias_steps_has_a_spectrum_of_its_own(channel, moment, left):
    step = found(f"{channel.split('.')[0]}_bias_step", (channel,), moment=moment)
    (item,) = unsaid((LINE,), [step])
    assert item.intervals == left
    assert unsaid((LOUD,), [found("accel_bias_step", ("accel.y",), moment=5.0)]) == ()


def test_a_line_in_some_rests_is_said_once():
    rng = np.random.default_rng(4)
    time = np.arange(24_000) / 100.0
    accel, gyro = 0.04 * rng.normal(size=(2, len(time), 3)) + [[[0.0, 0.0, 9.8]], [[0.0, 0.0, 0.0]]]
    gyro[:, 1] += ((time > 60.0) & (time < 130.0)) * 0.08 * np.sin(2 * np.pi * 3.6 * time)
    recording = Recording(time, accel, gyro, "device")
    start = np.arange(0, len(time), 800)
    poses = average_poses(recording, start, start + 650)
    assert [item.follows[: len(A_LINE)] for item in look_at_spectrum(recording, poses)] == [A_LINE]
    assert [item.channels for item in look_within(recording, poses)] == [("gyro.y",)]
    (item,) = look_at_rests(recording, poses)
    assert float(item.follows.removeprefix(A_LINE).split()[0]) == pytest.approx(3.6, abs=0.05)


def test_a_line_whose_pace_wanders_is_as_long_as_what_it_makes_restless():
    rng = np.random.default_rng(6)
    time = np.arange(24_000) / 100.0
    accel, gyro = 0.04 * rng.normal(size=(2, len(time), 3)) + [[[0.0, 0.0, 9.8]], [[0.0, 0.0, 0.0]]]
    pace = 2 * np.pi * np.cumsum(np.interp(time, [60.0, 100.0, 130.0], [20.0, 24.0, 40.0])) / 100.0
    gyro[:, 1] += ((time > 60.0) & (time < 130.0)) * 0.06 * np.sin(pace)
    recording = Recording(time, accel, gyro, "device")
    start = np.arange(0, len(time), 800)
    poses = average_poses(recording, start, start + 650)
    alone, (restless,) = look_at_spectrum(recording, poses), look_within(recording, poses)
    (item,) = look_at_rests(recording, poses)
    ((begin, end),), ((a, b),) = item.intervals, restless.intervals
    assert begin <= a
    assert end >= b
    assert (begin, end) == pytest.approx((60.0, 130.0), abs=15.0)
    # By itself it is said where its pace is even.
    assert np.ptp(alone[0].intervals[0]) < end - begin
