"""Knocks of a sensor that is put down, beside markers: what its samples fold of them.

The ring of a table is over in some hundredths of a second, and of micrometres: markers see nothing
of it. Nor do its samples average to the zero that it moves by, where no filter limits them before
they are taken: what is above half of their rate is folded to anywhere below. How much that is, the
power that they have just below half of the rate tells; the turn before has none there.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.reference.colour import PASSED
from calib.mismatch.reference.corners import fast_power
from calib.recording import Recording
from calib.types import FloatArray

ORDER = 8
"""Of the differences that tell of a ring: they pass all at half of the rate, a quarter at 3/8 and
nothing at 1/8, where a hand trembles. In a narrower band what is folded may cancel what is not,
as the ring begins between two samples."""

STANDS_OUT = 9.0
"""Power, relative to that of noise, from which on it is that of a knock: one in a million samples
has as much by chance."""


def struck(recording: Recording, time: FloatArray, bands: tuple[float, float]) -> FloatArray:
    """Return the variance that knocks have in samples through a low-pass, (n, 2), of both triads.

    Where power just below half of the rate stands out of the noise, what is folded is as noise of
    that power, on any axis. Elsewhere it is 0. The low-pass has not spread it yet.

    Parameters
    ----------
    recording : Recording
        As it was sampled.
    time : (n,) array, s
        Where it is asked for, on the recording's clock.
    bands : two floats, Hz
        Cut-offs of the low-passes of both, `calib.mismatch.reference.filters.smoothed`.
    """
    power = np.stack([fast_power(x, ORDER) for x in (recording.accel, recording.gyro)], axis=1)
    power[power < STANDS_OUT * np.median(power, axis=0)] = 0.0
    reach = max(1, round(float(np.median(np.diff(time))) / recording.interval))
    window = np.full(reach, 2.0 * PASSED * recording.interval / reach)
    near = [
        np.convolve(own, band * window, mode="same")
        for own, band in zip(power.T, bands, strict=True)
    ]
    return np.stack([np.interp(time, recording.time, own) for own in near], axis=1)
