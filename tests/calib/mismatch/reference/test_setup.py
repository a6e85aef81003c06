"""A setup moves as the columns say: by the frame, the clock, and the parameters of the sensor."""

import numpy as np

from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.setup import BASELINE, Setup
from calib.model import SensorModel
from calib.rotation import mat_from_rotvec

START = Setup(
    SensorModel(),
    Alignment(1.0, 0.0, 10.0, 0.9),
    mat_from_rotvec(np.array([0.3, 0, 0])),
    np.zeros(2),
)


def test_steps_go_to_their_parameters() -> None:
    steps = {n: 1e-3 * (k + 1) for k, n in enumerate(BASELINE)}
    moved = START.moved(steps, np.array([0.01, 1e-5]), (), turned=False)
    found = moved.model.accel.parameters("accel") | moved.model.gyro.parameters("gyro")
    for name, step in steps.items():
        np.testing.assert_allclose(found[name], step, err_msg=name)
    np.testing.assert_array_equal(moved.mat_sr, START.mat_sr)
    # A sensor that is later by a delay says at t what was true before.
    assert moved.alignment.offset == START.alignment.offset - 0.01
    assert moved.alignment.stretch == -1e-5


def test_a_frame_turns_the_vectors_of_the_truth() -> None:
    rho, errors = np.array([1e-4, -2e-4, 3e-4]), np.array([0.1, 0.2])
    moved = START.moved({}, np.array([0.0, 0.0, *rho, *errors]), (), turned=True)
    force = START.mat_sr @ np.array([1.0, 2.0, 3.0])
    change = moved.mat_sr @ np.array([1.0, 2.0, 3.0]) - force
    np.testing.assert_allclose(change, np.cross(force, rho), atol=1e-6)
    np.testing.assert_array_equal(moved.errors, errors)
