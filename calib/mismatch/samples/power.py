"""Periodograms of samples at rest: their frequencies, and what stands above its neighbours."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from calib.recording import CHANNELS
from calib.types import FloatArray

LENGTH = 128
"""Samples of one periodogram."""

NEIGHBOURS = 12
"""Frequencies on either side that a line is compared with."""

CLAIM = 1e-4
"""Family-wise p-value below which something is reported."""

LOUDER = 4.0
"""A rest counts as louder only if its noise power is this many times the usual."""


def frequencies(bins: int, interval: float) -> FloatArray:
    """Return the frequencies of a periodogram's bins, without the first two, Hz."""
    return (np.arange(bins) + 2) / (LENGTH * interval)


def above(power: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean over rests at each frequency, its floor, and the p-value of all at once.

    A line stands above both sides: motion of a hand, whose power falls with frequency, does not.
    """
    bins, number = power.shape
    # Each counts by its own noise: one rest that shakes would be all of the mean, and tell as one.
    level = np.median(power, axis=0)
    mean = power @ (level.mean() / np.maximum(level, np.finfo(float).tiny)) / number
    # At low frequencies it goes on as it falls; half the sampling rate mirrors every spectrum.
    padded = np.pad(np.log(mean), (NEIGHBOURS, 0), mode="reflect", reflect_type="odd")
    padded = np.pad(padded, (0, NEIGHBOURS), mode="symmetric")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
    sides = around[:, :NEIGHBOURS], around[:, NEIGHBOURS + 1 :]
    floor = np.exp(np.maximum(*(np.median(side, axis=1) for side in sides)))
    # What the floor itself scatters by, beyond what chance does, widens every test.
    scatter = np.median(np.abs(np.log(mean / floor))) / 0.6745
    freedom = min(2.0 * number, 2.0 / max(scatter**2, 1e-9) + 2.0)
    return mean, floor, chdtrc(freedom, freedom * mean / floor) * bins * len(CHANNELS)
