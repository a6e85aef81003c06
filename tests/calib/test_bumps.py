"""What tilts a sensor is no misread sample: gravity stays where it brought it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.bumps import gravity_followed, is_tilt
from calib.measured import spikes_of
from calib.recording import Recording
from calib.rotation import mat_from_rotvec

RATE = 50.0
AT = 1000


def still(tilt: np.ndarray, pulse: np.ndarray) -> Recording:
    """Return 40 s of rest in which a gyroscope shows a pulse of one sample, and gravity a tilt."""
    rng = np.random.default_rng(2)
    time = np.arange(2000) / RATE
    force = np.tile([0.0, 6.0, 7.8], (2000, 1))
    force[AT:] = force[AT:] @ mat_from_rotvec(tilt)
    gyro = rng.normal(0, 1e-3, (2000, 3))
    gyro[AT] += RATE * pulse
    return Recording(time, force + rng.normal(0, 0.02, (2000, 3)), gyro, "device")


TILT = np.array([3e-3, 0.0, 0.0])


@pytest.mark.parametrize(
    ("tilt", "pulse", "found"),
    [(TILT, TILT, True), (0 * TILT, TILT, False), (-TILT, TILT, False), (TILT, 4 * TILT, False)],
    ids=["tilted", "misread", "the other way", "by far more"],
)
def test_a_pulse_that_gravity_follows_is_a_tilt(
    tilt: np.ndarray, pulse: np.ndarray, found: bool
) -> None:
    recording = still(tilt, pulse)
    assert is_tilt(recording, AT, AT + 1) is found
    assert len(spikes_of(recording)) == (not found)


def test_what_is_at_an_end_of_a_recording_is_compared_with_nothing() -> None:
    recording = still(TILT, TILT)
    assert not is_tilt(recording, 5, 6)
    assert not is_tilt(recording, 1995, 1996)


@given(st.floats(0.55, 1.8), st.integers(0, 1000))
def test_the_size_of_a_change_need_not_be_that_which_few_samples_tell(
    factor: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    change = rng.normal(size=3)
    error = np.full(3, np.linalg.norm(change) / 20.0)
    assert gravity_followed(change, change / factor, error)
    assert not gravity_followed(change, -change, error)
    assert not gravity_followed(change, 3.0 * change, error)
    assert not gravity_followed(change, change, 10.0 * error)
