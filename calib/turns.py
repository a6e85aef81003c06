"""Turns: the motion between one static pose and the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.effects.observed import observed_turns, since_and_during
from calib.effects.vibration import SHAKEN, quiet_level, vibration_variance
from calib.poses import Poses
from calib.recording import Recording
from calib.stillness import LONGEST_GAP
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


def find_holes(recording: Recording) -> FloatArray:
    """Return where a recording was not running, (k, 2) s: what turned then is in no sample."""
    step = np.diff(recording.time)
    before = np.flatnonzero(step > max(LONGEST_GAP, 5.0 * recording.interval))
    return np.stack((recording.time[before], recording.time[before + 1]), axis=1)


def overlapping(intervals: FloatArray, others: FloatArray) -> BoolArray:
    """Return which intervals (m, 2) have a part of one of others (k, 2), in the order of time."""
    begun = np.searchsorted(others[:, 0], intervals[:, 1])
    ended = np.searchsorted(others[:, 1], intervals[:, 0], side="right")
    return np.asarray(begun > ended)


class Shaking(NamedTuple):
    """When a sensor is moved between m poses, (m - 1, 2) s, and how much it is shaken.

    ``vibration`` (n, 3) is the variance of each sample's specific force, (m/s²)²; in rests that are
    no louder than quiet ones, and in turns beside them, it is ``quiet`` (3,): the sensor's noise.
    """

    moving: FloatArray
    vibration: FloatArray
    quiet: FloatArray


def turns_and_shaking(recording: Recording, poses: Poses) -> Shaking:
    """Find when motion begins and ends, and what shakes the sensor.

    As `calib.effects.observed` finds both in signals without more, so that a calibration corrects
    what a diagnosis finds. Where nothing turns, motion is over when the next pose begins.

    Parameters
    ----------
    recording : Recording
    poses : Poses
        At least one, of it, in the order of time.
    """
    time = recording.time
    found = observed_turns(time, recording.gyro - np.median(poses.gyro, axis=0), recording.accel)
    middle = poses.interval.mean(axis=1)
    first = np.searchsorted(found.end, middle[:-1])
    last = np.searchsorted(found.end, middle[1:]) - 1
    moving = np.repeat(poses.interval[1:, :1], 2, axis=1)
    some = last >= first
    moving[some] = np.stack((found.start[first[some]], found.end[last[some]]), axis=1)
    _, loud = since_and_during(time, found.start, found.quiet)
    vibration = vibration_variance(time, recording.accel, loud)
    level = np.stack(
        [vibration[a:b].mean(axis=0) for a, b in zip(poses.start, poses.stop, strict=True)]
    )
    quiet = np.array([quiet_level(own, SHAKEN) for own in level.T])
    shaken = np.asarray((level > SHAKEN * quiet).any(axis=1))
    begun = np.searchsorted(moving[:, 0], time, side="right")
    ended = np.searchsorted(moving[:, 1], time, side="left")
    shakes = (shaken[begun] & shaken[ended])[:, None]
    return Shaking(moving, np.where(shakes, vibration, quiet), quiet)
