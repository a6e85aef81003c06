"""What a Recording promises."""

import numpy as np
import pytest

from calib import Recording
from calib.errors import EmptyRecordingError, InvalidSampleError


def a_recording(n: int = 10, **changes: object) -> Recording:
    rng = np.random.default_rng(0)
    values = {
        "time": np.arange(n) * 0.01,
        "accel": rng.normal(size=(n, 3)),
        "gyro": rng.normal(size=(n, 3)),
        "clock": "device",
    }
    return Recording(**(values | changes))  # type: ignore[arg-type]


def test_arrays_are_read_only_and_the_callers_are_not_frozen() -> None:
    mine = np.zeros((10, 3))
    recording = a_recording(accel=mine)
    with pytest.raises(ValueError, match="read-only"):
        recording.accel[0, 0] = 1
    mine[0, 0] = 1
    assert recording.samples_lost == 0


def test_time_must_increase_and_the_sample_is_named() -> None:
    time = np.arange(10) * 0.01
    time[7] = time[6]
    with pytest.raises(InvalidSampleError, match="sample 7"):
        a_recording(time=time)


def test_an_invalid_row_is_named() -> None:
    gyro = np.zeros((10, 3))
    gyro[4, 1] = np.nan
    with pytest.raises(InvalidSampleError, match="gyro is not finite at sample 4"):
        a_recording(gyro=gyro)


def test_no_samples_is_refused() -> None:
    with pytest.raises(EmptyRecordingError):
        a_recording(0)


def test_shapes_are_checked() -> None:
    with pytest.raises(ValueError, match="`accel`"):
        a_recording(accel=np.zeros((9, 3)))


def test_slices_and_channels() -> None:
    recording = a_recording(lost=np.array([0, 0, 5, 0, 0, 0, 0, 0, 0, 1]))
    assert recording.slice(2, 5).samples_lost == 5
    np.testing.assert_array_equal(recording.channel("gyro.y"), recording.gyro[:, 1])
