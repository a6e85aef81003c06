"""Turns: the motion between one static pose and the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.effects.observed import observed_turns, since_and_during
from calib.effects.vibration import vibration_variance
from calib.poses import Poses
from calib.recording import Recording
from calib.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Turns:
    """Segments of motion, each between two poses that follow each other.

    Parameters
    ----------
    before, after : (m,) arrays of int
        Index of the pose at either end.
    start, stop : (m,) arrays of int
        Samples ``[start, stop)``: ``start`` is inside the pose before, ``stop - 1`` inside the pose
        after, so that the rate is integrated from rest to rest.
    interval : (m, 2) array, s
        Recording seconds of samples ``start`` and ``stop - 1``.
    """

    before: IntArray
    after: IntArray
    start: IntArray
    stop: IntArray
    interval: FloatArray

    def __len__(self) -> int:
        return len(self.start)

    def select(self, which: BoolArray | IntArray) -> Turns:
        """Return some of the turns: an index array or a mask."""
        return Turns(
            self.before[which],
            self.after[which],
            self.start[which],
            self.stop[which],
            self.interval[which],
        )


def find_turns(recording: Recording, poses: Poses) -> Turns:
    """Return the turns of a recording: one between every two poses that follow each other.

    A turn runs from the last sample of the pose before to the first of the pose after, both of
    them at rest. Motion before the first pose and after the last belongs to no turn: only one of
    its ends has a known direction of gravity. A stretch in which the sensor was only pushed, or
    shaken for a minute, is a turn like any other: what it is worth follows from its noise.

    Parameters
    ----------
    recording : Recording
    poses : Poses
        Of this recording, in the order of time.

    Raises
    ------
    ValueError
        If the poses overlap, are out of order or lie outside of the recording.
    """
    start, stop = poses.stop[:-1] - 1, poses.start[1:] + 1
    order = np.stack([poses.start, poses.stop], axis=1).ravel()
    if len(poses) and (order[0] < 0 or order[-1] > len(recording) or (np.diff(order) < 0).any()):
        raise ValueError(
            f"`poses` must follow each other within the recording's {len(recording)} samples"
        )
    index = np.arange(max(len(poses) - 1, 0))
    interval = np.stack([recording.time[start], recording.time[stop - 1]], axis=1)
    return Turns(index, index + 1, start, stop, interval)


def motion_of_turns(recording: Recording, poses: Poses) -> tuple[FloatArray, FloatArray]:
    """Return when motion between poses begins and ends, (m, 2) s, and the vibration, (n, 3).

    Both as `calib.effects.observed` finds them in a corrected recording, so that a calibration
    corrects what a diagnosis finds. Where nothing turns, motion is over when the next pose begins.

    Parameters
    ----------
    recording : Recording
        Of n samples.
    poses : Poses
        Of it, in the order of time.
    """
    rate = recording.gyro - (np.median(poses.gyro, axis=0) if len(poses) else 0.0)
    starts, ends = observed_turns(recording.time, rate)
    _, turning = since_and_during(recording.time, starts, ends)
    middle = poses.interval.mean(axis=1)
    first = np.searchsorted(ends, middle[:-1])
    last = np.searchsorted(ends, middle[1:]) - 1
    over = np.repeat(poses.interval[1:, :1], 2, axis=1)
    some = last >= first
    over[some] = np.stack((starts[first[some]], ends[last[some]]), axis=1)
    return over, vibration_variance(recording.time, recording.accel, turning)
