"""How a sensor is mounted in the frame of what moves it: a rotation, from both of its triads."""

from __future__ import annotations

import numpy as np

from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.truths import RecordingTruth
from calib.recording import Recording
from calib.rotation import nearest_rotation, rotvec_from_mat
from calib.types import FloatArray

_Signals = tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]

UNTURNED = 1e-3
"""Weight of no rotation in a mounting, relative to what was measured."""

FAR = np.radians(10.0)
"""Angle of a mounting that no misalignment of axes comes near to."""

ALIKE = 0.1
"""Share of the signals' powers, in sum, that the right mounting leaves at most: errors of 5 % of
scale leave a twentieth of that."""

ARM, FELT, EXACT = 0.3, 0.1, 1e-3
"""m that a sensor may be off the axis of a table of the usual size; the share of gravity that is
next to nothing: it tilts a mounting by 6 degrees; and that by which gravity alone is off, through a
low-pass. Any motion of a point is more."""

UNLIKE = 5.0
"""How many times more another frame must leave, or it is as good."""


def mounting(
    real: Recording, truth: RecordingTruth, alignment: Alignment
) -> tuple[FloatArray, float]:
    """Return the rotation from the truth's frame to s, and what share of the signals it leaves.

    Wahba's problem over rates and specific forces, by singular values. What is left is the power of
    the rates' differences relative to the rates', and the same of forces: of turns about one axis
    alone, the other way round and turned over are the same for a gyroscope.

    References
    ----------
    .. [1] F. L. Markley, "Attitude determination using vector observations and the singular value
       decomposition", J. Astronaut. Sci. 36, 1988, p. 245.
    """
    seen = both(real, truth, alignment)
    mat = _rotation(seen)
    return mat, _left(seen, mat)


def mounted_far(real: Recording, truth: RecordingTruth, alignment: Alignment) -> FloatArray | None:
    """Return the rotation from a simulation's frame to s, if it is large and explains the two.

    A small one is an effect like others, to be told from what turns the axes of one triad alone.
    """
    seen = both(real, truth, alignment)
    mat = _rotation(seen)
    if np.linalg.norm(rotvec_from_mat(mat)) < FAR:
        return None
    left = _left(seen, mat)
    return mat if left <= ALIKE and UNLIKE * left < _left(seen, np.eye(3)) else None


def _rotation(seen: _Signals) -> FloatArray:
    (gyro, rate), (accel, force) = seen
    product = gyro.T @ rate / max(float(np.square(rate).sum()), 1e-12)
    product += accel.T @ force / max(float(np.square(force).sum()), 1e-12)
    # A turn that nothing tells of (heading, on a table) is none.
    product += UNTURNED * np.linalg.norm(product) * np.eye(3)
    return nearest_rotation(product)


def both(real: Recording, truth: RecordingTruth, alignment: Alignment) -> _Signals:
    """Return what the recording and the truth have in common: rates beside rest, and forces.

    Where the truth's are those of a body that nothing moves, but turns, forces are those of samples
    at which an arm of `ARM` would make a sensor feel next to nothing: off the axis of a fast table
    it feels more than gravity. They may be none.
    """
    at = alignment.times(real.time)
    inside = truth.covers(at)
    state = truth.state(at[inside])
    gyro, rate = (r - np.median(r, axis=0) for r in (real.gyro[inside], state.rate))
    accel, force = real.accel[inside], state.force
    if _is_of_turns_alone(force, truth.gravity):
        slow = ARM * np.linalg.norm(state.gradient, axis=(1, 2)) < FELT * truth.gravity
        accel, force = accel[slow], force[slow]
    return (gyro, rate), (accel, force)


def _is_of_turns_alone(force: FloatArray, gravity: float) -> bool:
    """Whether (n, 3) forces are gravity alone, most of the time."""
    off = np.abs(np.linalg.norm(force, axis=1) - gravity)
    return bool(len(force)) and float(np.median(off)) < EXACT * gravity


def _left(both: _Signals, mat: FloatArray) -> float:
    """Return what shares of the signals' powers a rotation leaves, in sum."""
    return sum(
        float(np.square(seen - true @ mat.T).sum() / max(np.square(seen).sum(), 1e-12))
        for seen, true in both
    )
