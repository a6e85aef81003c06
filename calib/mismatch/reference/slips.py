"""Moments about which a truth and a sensor turn by different angles.

About a corner of a motion (`corners`) a truth is not known sample by sample, and nothing is judged
there. But from before to after it what both have turned by is the same, to what the sensor's own
samples miss of the corner: half a step of the rate, over half a sample. And of a gyroscope at rest
rounding may take, or add, half a count all along. A table that slips between two samples of its
profile, or an index that is read wrongly, makes such a corner and turns nothing.
"""

from __future__ import annotations

import numpy as np

from calib.faults import FALSE_ALARM, ROBUST
from calib.lsb import between_counts
from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.noise.hush import count_of
from calib.recording import CHANNELS
from calib.stillness import runs
from calib.types import BoolArray, FloatArray

SURE = 8.0
"""Standard errors by which angles differ, at least, beyond what samples may miss."""

SLIP = "a jump between two samples: reference and sensor turn by angles that differ by {:.2g}°"


def find_slips(
    time: FloatArray,
    left: FloatArray,
    rate: FloatArray,
    unknown: BoolArray,
    interval: float,
    unlike: FloatArray | float = 0.0,
) -> tuple[Unexplained, ...]:
    """Return where the angles differ, as unexplained.

    Parameters
    ----------
    time : (n,) array, s
    left, rate : (n, 3) arrays, rad/s
        What the gyroscope has beyond what the truth turns by, and its samples.
    unknown : (n,) array of bool
        Samples about corners.
    interval : float, s
    unlike : (n, 3) array, rad/s
        What filters that are taken into account may be wrong by.
    """
    if unknown.all():
        return ()
    known, lsb = left[~unknown], count_of(rate)
    noise = ROBUST * between_counts(np.abs(known - np.median(known, axis=0)), lsb, 0.5)
    unlike = np.broadcast_to(unlike, left.shape)
    out = []
    for start, stop in zip(*runs(unknown), strict=True):
        angle = interval * left[start:stop].sum(axis=0)
        missed = interval * (np.ptp(rate[start:stop], axis=0) + 0.5 * lsb * (stop - start))
        missed += interval * np.abs(unlike[start:stop].sum(axis=0))
        off = np.abs(angle) - missed - SURE * noise * interval * np.sqrt(stop - start)
        if (off > 0).any():
            axes = tuple(CHANNELS[3 + k] for k in np.flatnonzero(off > 0))
            where = ((float(time[start]), float(time[stop - 1])),)
            follows = SLIP.format(np.degrees(np.linalg.norm(angle)))
            out.append(Unexplained(axes, where, follows, FALSE_ALARM))
    return tuple(out)
