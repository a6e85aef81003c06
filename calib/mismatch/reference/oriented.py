"""Where a simulation, or another IMU, is turned to: what its own rates lead to.

Those of a simulation without noise lead there. Of another IMU rests say where up is, and its rates
what happens in between. Heading is carried by the turns: up to a few degrees it is known but for
the one that it began with, which nothing tells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.mismatch.reference.stilled import find_rests
from calib.mismatch.reference.truths import RecordingTruth
from calib.rotation import integrate_rate, quat_from_rotvec, quat_multiply, rotate
from calib.types import FloatArray

PARTS = 8
"""Parts of a simulation that must have gravity in one direction."""

DRIFT = np.deg2rad(1.0)
"""Up to which that direction may differ among them: its gyroscopes are as good as perfect."""

LED = np.deg2rad(20.0)
"""By which another IMU's rates may lead off from one rest to the next: a scale factor error of 3 %
of a turn and a half, and a pose or two that the accelerometer's bias tilts."""


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
    return replace(truth, quat=quat_multiply(quat_from_rotvec(_upright(up)), quat))


def oriented_at_rests(truth: RecordingTruth) -> RecordingTruth:
    """Return another IMU's truth with orientations, if its rates lead from rest to rest.

    What they lead to is turned upright at each rest, and on the way there by as much of that as the
    share of the way. Its gyroscope reads nothing at rest (`carried.settled`).
    """
    own = truth.recording
    rests = find_rests(own)
    if len(rests) < 2:
        return truth
    quat = integrate_rate(own.time, own.gyro)
    middle = (rests.start + rests.stop) // 2
    led, turns = [np.array([[1.0, 0.0, 0.0, 0.0]])], []
    for there, force in zip(quat[middle, None], rests.accel, strict=True):
        up = rotate(quat_multiply(led[-1], there), force[None])[0]
        turns.append(_upright(up / max(float(np.linalg.norm(up)), 1e-300)))
        led.append(quat_multiply(quat_from_rotvec(turns[-1][None]), led[-1]))
    turn = np.stack(turns)
    if np.linalg.norm(turn[1:], axis=1).max() > LED:
        return truth
    begins, ends = own.time[rests.start], own.time[rests.stop - 1]
    reached = np.minimum(np.searchsorted(ends, own.time), len(rests) - 1)
    left = np.append(-np.inf, ends)[reached]
    share = np.ones(len(quat))
    way = reached > 0
    share[way] = (own.time - left)[way] / np.maximum(begins[reached] - left, 1e-9)[way]
    turned = quat_from_rotvec(np.clip(share, 0.0, 1.0)[:, None] * turn[reached])
    return replace(
        truth,
        quat=quat_multiply(turned, quat_multiply(np.concatenate(led)[reached], quat)),
    )


def _upright(up: FloatArray) -> FloatArray:
    """Return the shortest turn that makes a unit vector point up, as a rotation vector."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, up[2]))
    # Straight down there is no axis, and any will do.
    return axis / sine * angle if sine > 0 else np.array([angle, 0.0, 0.0])
