"""Turns: the motion between one static pose and the next."""

from __future__ import annotations

from dataclasses import dataclass

from calib.types import FloatArray, IntArray


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
