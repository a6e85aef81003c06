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
    parts = np.stack([part.mean(axis=0) for part in np.array_split(force, PARTS)])
    size = np.linalg.norm(parts, axis=1)
    if not size.all():
        return truth
    up = force.mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-300)
    if np.arccos(np.clip(parts @ up / size, -1.0, 1.0)).max() > DRIFT:
        return truth
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, up[2]))
    # Straight down there is no axis, and any will do.
    turn = axis / sine * angle if sine > 0 else np.array([angle, 0.0, 0.0])
    return replace(truth, quat=quat_multiply(quat_from_rotvec(turn), quat))
