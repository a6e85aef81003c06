"""What a session warns of early: clipping, swapped axes, a vertical turn, a sensor warming up."""

from __future__ import annotations

import numpy as np

from calib.closure import closure_residual
from calib.effects.axis_error import ORDERS, signed_permutation
from calib.poses import Poses
from calib.recording import AXES, Recording
from calib.rotation import integrate_rate, mat_from_quat, rotvec_from_mat
from calib.turns import Turns
from calib.types import FloatArray

CLIPPED = 0.998
"""Of full scale: where a sensor reads no higher."""
TILTED = np.radians(20)
"""Turns that tilt the sensor by less than this tell little of its axes."""
CLOSES, MISSES = np.radians(12), np.radians(30)
"""An uncalibrated sensor closes a turn within the first; swapped axes miss the second."""
VERTICAL = np.radians(25)
LARGE_TURN = np.radians(40)
WARMING = 0.02
"""K/s; faster than this a sensor is not settled (a room changes by 1 K in several minutes)."""


def clipping_warning(recording: Recording) -> str | None:
    """Return a warning if a channel is at its full scale."""
    device = recording.device
    clipped = []
    for triad, full_scale in (("accel", device.accel_full_scale), ("gyro", device.gyro_full_scale)):
        if full_scale is not None:
            high = np.abs(getattr(recording, triad)).max(axis=0) >= CLIPPED * full_scale
            clipped += [
                f"{triad}.{axis}" for axis, is_high in zip(AXES, high, strict=True) if is_high
            ]
    if not clipped:
        return None
    return f"{', '.join(clipped)} reached full scale: turn more slowly, and set it down gently."


def warm_up_warning(poses: Poses) -> str | None:
    """Return a warning if temperature still rises from pose to pose."""
    if poses.temperature is None or len(poses) < 2:
        return None
    middle = poses.interval.mean(axis=1)[-4:]
    slope = float(np.polyfit(middle, poses.temperature[-4:], 1)[0])
    if abs(slope) < WARMING:
        return None
    return (
        f"The sensor's temperature changes by {60 * slope:+.1f} K a minute: it is still warming "
        "up. Wait, or its bias will wander under the calibration."
    )


def turn_warnings(recording: Recording, poses: Poses, turns: Turns) -> list[str]:
    """Return warnings about the axes of the turns so far."""
    if not len(turns):
        return []
    ups = poses.accel / np.linalg.norm(poses.accel, axis=1, keepdims=True)
    before, after = ups[turns.before], ups[turns.after]
    bias = poses.gyro.mean(axis=0)
    mats = _rotations(recording, turns, bias)
    out = []
    vertical = _vertical(mats[-1], before[-1])
    if vertical:
        out.append(vertical)
    tilted = np.arccos(np.clip(np.sum(before * after, axis=1), -1, 1)) > TILTED
    if tilted.sum() >= 2:
        wrong = _axes(recording, turns, bias, before[tilted], after[tilted], tilted)
        if wrong:
            out.append(wrong)
    return out


def _rotations(recording: Recording, turns: Turns, bias: FloatArray) -> FloatArray:
    mats = np.empty((len(turns), 3, 3))
    for k in range(len(turns)):
        part = slice(int(turns.start[k]), int(turns.stop[k]))
        rate = recording.gyro[part] - bias
        mats[k] = mat_from_quat(integrate_rate(recording.time[part], rate)[-1])
    return mats


def _vertical(mat: FloatArray, up: FloatArray) -> str | None:
    rotvec = rotvec_from_mat(mat)
    angle = float(np.linalg.norm(rotvec))
    if angle < LARGE_TURN or abs(float(rotvec @ up)) < np.cos(VERTICAL) * angle:
        return None
    return (
        f"The last turn ({np.degrees(angle):.0f}°) was about the vertical: gravity does not see "
        "it. Lay the sensor on its side and turn it about the same axis."
    )


def _axes(
    recording: Recording,
    turns: Turns,
    bias: FloatArray,
    before: FloatArray,
    after: FloatArray,
    tilted: np.ndarray,
) -> str | None:
    """Try all signed permutations of the gyroscope's axes; say so if another one fits."""
    chosen = Turns(*(getattr(turns, n)[tilted] for n in Turns.__dataclass_fields__))

    def miss(rate_map: FloatArray) -> float:
        total = 0.0
        for k in range(len(chosen)):
            part = slice(int(chosen.start[k]), int(chosen.stop[k]))
            rate = (recording.gyro[part] - bias) @ rate_map.T
            mat = mat_from_quat(integrate_rate(recording.time[part], rate)[-1])
            residual = closure_residual(before[k : k + 1], (mat @ after[k])[None])
            total += float(np.sum(residual**2))
        return float(np.sqrt(total / len(chosen)))

    if miss(np.eye(3)) < MISSES:
        return None
    misses = [miss(signed_permutation(number).T) for number in range(len(ORDERS))]
    best = int(np.argmin(misses))
    if misses[best] > CLOSES:
        return None
    columns = signed_permutation(best).T
    names = ", ".join(
        f"{'-' if row.sum() < 0 else ''}{AXES[int(np.argmax(np.abs(row)))]}" for row in columns
    )
    return (
        "The turns fit gravity only if the gyroscope's axes are read as "
        f"({names}): its axes are swapped or have a wrong sign. Set the axis map first."
    )
