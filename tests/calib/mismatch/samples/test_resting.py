"""What samples at rest show, without that of which findings are the cause."""

from types import SimpleNamespace

import pytest

from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.samples.resting import unsaid
from calib.mismatch.samples.spectrum import LOUDER_THERE

LOUD = Unexplained(("accel.x", "accel.y"), ((3.0, 9.0),), LOUDER_THERE, 1e-9)
LINE = Unexplained(("accel.x",), ((0.0, 20.0), (30.0, 40.0)), "a line at 21 Hz", 1e-9)


def found(effect, channels, **moments):
    values = {name: SimpleNamespace(value=value) for name, value in moments.items()}
    return SimpleNamespace(effect=effect, channels=channels, parameters=values)


def test_what_shakes_a_sensor_is_the_cause_of_louder_noise_and_of_no_line():
    shaken = found("accel_vibration_rectification", ("accel.z",))
    assert unsaid((LOUD, LINE), [shaken]) == (LINE,)
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
