"""Where a simulation without noise is turned to: what its own rates lead to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.mismatch.reference.truths import RecordingTruth
from calib.rotation import integrate_rate, quat_from_rotvec, quat_multiply, rotate

PARTS = 8
"""Parts of a simulation that must have gravity in one direction."""

DRIFT = np.deg2rad(1.0)
"""Up to which that direction may differ among them: its gyroscopes are as good as perfect."""


def oriented(truth: RecordingTruth) -> RecordingTruth:
    """Return a simulation's truth with orientations, if its rates and its forces agree on them.

    ``d(mat_ns)/dt = mat_ns @ skew(rate)``, up to a heading that nothing tells. Motion of the hand
    leaves the mean of the forces along gravity.
    """
    own = truth.recording
    quat = integrate_rate(own.time, own.gyro)
    force = rotate(quat, own.accel)
    up = force.mean(axis=0)
    up /= np.linalg.norm(up)
    each = np.stack([part.mean(axis=0) for part in np.array_split(force, PARTS)])
    lean = np.arccos(np.clip(each @ up / np.linalg.norm(each, axis=1), -1.0, 1.0))
    if lean.max() > DRIFT:
        return truth
    axis = np.cross(up, [0.0, 0.0, 1.0])
    size = float(np.linalg.norm(axis))
    angle = float(np.arctan2(size, up[2]))
    # Straight down there is no axis, and any will do.
    turn = axis / size * angle if size > 0 else np.array([angle, 0.0, 0.0])
    return replace(truth, quat=quat_multiply(quat_from_rotvec(turn), quat))
