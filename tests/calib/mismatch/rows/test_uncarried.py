"""What a hand still carries when it turns no more is no rest; what moves slowly is left in."""

import numpy as np
import pytest

from calib.mismatch.rows.uncarried import uncarried
from calib.poses import average_poses
from calib.recording import Recording
from calib.types import FloatArray

RATE = 100.0


def two_rests(push: FloatArray) -> tuple[Recording, FloatArray]:
    """Return 5 s of rest, 2 s of a turn and 5 s of rest, `push` (m,) from the turn's end on."""
    time = np.arange(0.0, 12.0, 1 / RATE)
    turning = (time >= 5.0) & (time < 7.0)
    angle = np.clip((time - 5.0) / 2.0, 0.0, 1.0) * 1.2
    accel = 9.81 * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    gyro = np.where(turning, 0.6, 0.0)[:, None] * [0.0, 1.0, 0.0]
    accel[700 : 700 + len(push), 1] += push
    rng = np.random.default_rng(1)
    noisy = accel + rng.normal(0, 0.02, accel.shape), gyro + rng.normal(0, 0.002, gyro.shape)
    edges = np.array([0, 700]), np.array([500, 1200])
    recording = Recording(time, *noisy, "device")
    return recording, uncarried(recording, average_poses(recording, *edges)).interval


def test_a_rest_begins_when_nothing_carries_the_sensor_any_more() -> None:
    """It moved by 0.65 m/s² in one, and the turn before it was a bias in a window."""
    push = 1.5 * np.sin(np.linspace(0.0, 2 * np.pi, 35, endpoint=False))
    _, interval = two_rests(push)
    assert interval[0] == pytest.approx([0.0, 4.99], abs=0.011)
    assert 7.3 <= interval[1, 0] <= 7.75
    assert interval[1, 1] == pytest.approx(11.99)


@pytest.mark.parametrize("size", [0.0, 0.02])
def test_what_settles_for_seconds_is_left_in(size: float) -> None:
    _, interval = two_rests(size * np.exp(-np.arange(400) / RATE / 1.5))
    assert interval == pytest.approx(np.array([[0.0, 4.99], [7.0, 11.99]]), abs=0.011)
