"""Alignment to the housing: truth recovered within its standard errors, wrong faces refused."""

import numpy as np
import pytest

from calib.calibration import Calibration, Gravity, PoseTable, TriadSummary
from calib.errors import ImuError, InsufficientMotionError
from calib.housing import FACES, FacePose, align_to_housing
from calib.model import SensorModel, Triad
from calib.rotation import mat_from_rotvec

ACCEL = Triad(np.array([0.1, -0.2, 0.3]), np.array([0.02, -0.01, 0.01]))


def calibration(mat_hs: np.ndarray, rng: np.random.Generator, sigma: float) -> Calibration:
    """Return one whose poses stood on the six faces, each off by sigma rad."""
    up = np.vstack([np.eye(3)[k] * sign for k in range(3) for sign in (1, -1)])
    tilted = np.array([mat_from_rotvec(rng.normal(0, sigma, 3)) @ row for row in up])
    measured = ACCEL.distort(9.8 * tilted @ mat_hs)
    interval = np.arange(6)[:, None] * 10.0 + np.array([0.0, 5.0])
    summary = TriadSummary("exact", np.zeros((6, 1)), "m/s²", interval, 1, 1.0)
    return Calibration(
        SensorModel(ACCEL),
        (),
        np.zeros((0, 0)),
        (),
        Gravity(9.8),
        accel=summary,
        poses=PoseTable(interval, measured, np.zeros((6, 3))),
    )


BY_TIME = [FacePose(face, time=10.0 * k + 2) for k, face in enumerate(FACES)]


def test_the_rotation_is_recovered_within_its_standard_errors() -> None:
    rng = np.random.default_rng(0)
    scores = []
    for _ in range(300):
        truth = mat_from_rotvec(rng.normal(0, 1, 3))
        found = align_to_housing(calibration(truth, rng, 0.003), BY_TIME).housing
        assert found is not None
        left = found.mat_hs @ truth.T
        error = 0.5 * np.array(
            [left[2, 1] - left[1, 2], left[0, 2] - left[2, 0], left[1, 0] - left[0, 1]]
        )
        scores.append((error / found.sigma) ** 2)
        assert np.linalg.det(found.mat_hs) == pytest.approx(1.0)
    # Squares over a variance of 9 degrees of freedom: 9 / 7 on average, of 900 ± 0.08.
    assert 1.0 < np.mean(scores) < 1.6


def test_two_faces_by_number_are_enough() -> None:
    truth = mat_from_rotvec(np.array([0.02, -0.01, 1.5]))
    faces = [FacePose("+X", pose=1), FacePose("-Z", pose=6)]
    aligned = align_to_housing(calibration(truth, np.random.default_rng(1), 0.0), faces)
    assert aligned.housing is not None
    np.testing.assert_allclose(aligned.housing.mat_hs, truth, atol=1e-9)


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([], "do not determine"),
        ([FacePose("+X", pose=1)], "do not determine"),
        ([FacePose("+X", pose=1), FacePose("-X", pose=2)], "not opposite"),
        ([FacePose("+X", pose=1), FacePose("+Y", pose=4), FacePose("+Z", pose=5)], "° from face"),
        ([FacePose("+X", pose=1), FacePose("+Y", pose=7)], "not one of the 6 poses"),
        ([FacePose("+X", time=7.0), FacePose("+Y", pose=3)], "nearest is"),
        ([FacePose("+X", pose=1), FacePose("+X", time=2.0)], "twice"),
        ([FacePose("+W", pose=1), FacePose("+Y", pose=3)], "must be one of"),
    ],
)
def test_faces_that_cannot_be(faces: list[FacePose], message: str) -> None:
    known = calibration(np.eye(3), np.random.default_rng(2), 0.001)
    with pytest.raises(ValueError, match=r".") as caught:
        align_to_housing(known, faces)
    assert message in str(caught.value)
    assert isinstance(caught.value, InsufficientMotionError) == (
        "determine" in message or "opposite" in message
    )
    assert isinstance(caught.value, ImuError) or "`" in str(caught.value)
