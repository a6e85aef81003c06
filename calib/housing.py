"""Align the sensor frame to its housing, from poses on known faces of the housing.

With unit vectors u_k of the calibrated specific force and e_k of the housing's face that was up,
``e_k = mat_hs @ u_k + n``: Wahba's problem, solved by the singular value decomposition.

References
----------
.. [1] F. L. Markley, "Attitude determination using vector observations and the singular value
   decomposition", J. Astronautical Sciences 36(3), 1988, eqs. (9), (15) and (25).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.calibration import Calibration, Housing
from calib.errors import InsufficientMotionError
from calib.recording import AXES

FACES = tuple(sign + axis.upper() for axis in AXES for sign in "+-")

WRONG_FACE = np.radians(30.0)
"""A pose further than this from the face that was named stood on another one."""


@dataclass(frozen=True)
class FacePose:
    """A pose and the face of the housing that was up in it.

    ``time`` is a moment within the pose, recording s; or ``pose`` its number, from 1.
    """

    up: str
    time: float | None = None
    pose: int | None = None


def align_to_housing(calibration: Calibration, faces: Sequence[FacePose]) -> Calibration:
    """Return the calibration with the rotation of the sensor in its housing.

    The standard errors follow from how the poses scatter about their faces, which is how square the
    housing and level the table were; at least from the noise of the accelerometer's own residuals.

    Parameters
    ----------
    calibration : Calibration
        With its table of poses.
    faces : sequence of FacePose
        At least two faces that are not opposite.

    Raises
    ------
    ValueError
        If a face, time or number names no pose, or a pose stood on another face than was said.
    InsufficientMotionError
        If the faces do not determine the rotation.
    """
    table = calibration.poses
    if table is None:
        raise ValueError("`calibration` has no table of poses to align by")
    index = [_find_pose(table.interval, face) for face in faces]
    if len(set(index)) < len(index):
        raise ValueError("`faces` names a pose twice")
    true = calibration.model.accel.correct(table.accel[index])
    sensed = true / np.linalg.norm(true, axis=1, keepdims=True)
    known = np.array([_face(face.up) for face in faces]).reshape(-1, 3)
    # Information about a rotation in the frame h: each direction leaves the turn about itself free.
    information = len(known) * np.eye(3) - known.T @ known
    if len(known) < 2 or np.linalg.eigvalsh(information)[0] < 0.5:
        raise InsufficientMotionError(
            f"{len(known)} poses on {', '.join(face.up for face in faces) or 'no face'} do not "
            "determine how the sensor sits in the housing; name two faces that are not opposite"
        )
    left, _, right = np.linalg.svd(known.T @ sensed)
    sign = np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)])
    mat_hs = left @ sign @ right
    residual = known - sensed @ mat_hs.T
    angle = 2 * np.arcsin(np.clip(np.linalg.norm(residual, axis=1) / 2, 0, 1))
    if angle.max() > WRONG_FACE:
        k = int(np.argmax(angle))
        a, b = table.interval[index[k]]
        raise ValueError(
            f"`faces`: the pose at {a:.2f} to {b:.2f} s is {np.degrees(angle[k]):.0f}° from face "
            f"{faces[k].up} up; check which face was up"
        )
    freedom = 2 * len(known) - 3
    floor = 0.0
    if calibration.accel is not None:
        floor = (calibration.accel.residual_rms / calibration.gravity.value) ** 2
    variance = max(float((angle**2).sum()) / freedom, floor)
    sigma = np.sqrt(np.diag(variance * np.linalg.inv(information)))
    rms = float(np.sqrt((angle**2).mean()))
    return replace(calibration, housing=Housing(mat_hs, sigma, rms, len(known)))


def _face(name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    if name not in FACES:
        raise ValueError(f"`up` must be one of {', '.join(FACES)}, got {name!r}")
    out = np.zeros(3)
    out[AXES.index(name[1].lower())] = 1.0 if name[0] == "+" else -1.0
    return out


def _find_pose(interval: np.ndarray[tuple[int, int], np.dtype[np.float64]], face: FacePose) -> int:
    if face.pose is not None:
        if not 1 <= face.pose <= len(interval):
            raise ValueError(f"`pose` {face.pose} is not one of the {len(interval)} poses found")
        return face.pose - 1
    if face.time is None:
        raise ValueError("`faces` needs a time or a pose for each face")
    inside = np.flatnonzero((interval[:, 0] <= face.time) & (face.time <= interval[:, 1]))
    if not len(inside):
        near = int(np.argmin(np.abs(interval - face.time).min(axis=1)))
        a, b = interval[near]
        raise ValueError(
            f"`time` {face.time:g} s is in no static pose; the nearest is {a:.2f} to {b:.2f} s"
        )
    return int(inside[0])
