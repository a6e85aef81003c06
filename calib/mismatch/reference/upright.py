"""Which way is up in the world of motion capture: some have y up, or a floor that nobody levelled.

Rates alone tell how a sensor is mounted on the body, and a sensor that is mounted so feels gravity
along one direction of the world. Where that is far from z, the world is turned until it is z.
"""

from __future__ import annotations

import numpy as np

from calib.gravity import STANDARD_GRAVITY
from calib.rotation import nearest_rotation, quat_from_rotvec
from calib.types import FloatArray

TIPPED = float(np.radians(20.0))
"""Angle from z beyond which up is another direction; less is a floor that leans, which is found."""

STEADY = 0.9
"""Share of gravity, or of what a sensor feels if that is less, that must have one direction in the
world: it is mounted to within some degrees, and what it accelerates comes back."""

PLAIN = 0.01
"""Power of the turns about a second axis, relative to the first: of one axis alone nobody knows how
the sensor is turned about it."""


def vertical(
    mat_nb: FloatArray, rate: FloatArray, gyro: FloatArray, accel: FloatArray
) -> FloatArray | None:
    """Return the direction (3,) that is up in the world, None where that is not to be told.

    It is an axis if that is near.

    Parameters
    ----------
    mat_nb : (n, 3, 3) array
        Orientations of the body in the world.
    rate, gyro : (n, 3) arrays, rad/s
        What turns it by these, and what the sensor says.
    accel : (n, 3) array, m/s²
        By the sensor.
    """
    rate, gyro = (values - np.median(values, axis=0) for values in (rate, gyro))
    product = gyro.T @ rate
    power = np.linalg.svd(product, compute_uv=False)
    if power[1] < PLAIN * power[0]:
        return None
    felt = np.einsum("nij,nj->ni", mat_nb, accel @ nearest_rotation(product)).mean(axis=0)
    size = float(np.linalg.norm(felt))
    if size < STEADY * min(float(np.linalg.norm(accel, axis=1).mean()), STANDARD_GRAVITY):
        return None
    c = int(np.argmax(np.abs(felt)))
    if abs(felt[c]) > np.cos(TIPPED) * size:
        # What a world leans by beside an axis is its own: a finding.
        felt, size = np.sign(felt[c]) * np.eye(3)[c], 1.0
    return np.asarray(felt / size)


def turn_up(up: FloatArray) -> FloatArray:
    """Return the shortest rotation that takes the unit vector `up` (3,) to z, a quaternion (4,)."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.asarray(quat_from_rotvec(np.arctan2(sine, up[2]) * axis[None])[0])


def in_words(up: FloatArray) -> str:
    """Return the axis of the world that is up, or the direction."""
    if np.abs(up).max() == 1.0:
        c = int(np.argmax(np.abs(up)))
        return f"{'-' if up[c] < 0 else ''}{'xyz'[c]}"
    return ", ".join(f"{v:.2f}" for v in up)
