"""Noise density of a sensor that a hand holds: where in its spectrum hands do little.

A hand sways below a few hertz, and trembles between 8 and 12 Hz [1]_. Above, what a sensor says is
its own noise. But many low-pass that, and then it says little of noise as slow as a turn. So it is
believed where it is the same still higher, and more than rounding to counts makes. Where it is not,
the median counts of three bands that hands do little in: one may be a hand's still, and one may be
filtered.

References
----------
.. [1] Elble, Koller, "Tremor", Baltimore 1990: physiologic tremor of the hand, 8 to 12 Hz.
"""

from __future__ import annotations

import numpy as np

from calib.poses import Poses
from calib.recording import Recording
from calib.types import FloatArray

WINDOW = 2.0
"""s of one periodogram."""

BANDS = ((2.0, 3.5), (3.5, 6.0), (16.0, 25.0))
"""Hz: between swaying and trembling, and above."""

HIGHER = (26.0, 45.0)
"""Hz."""

FLAT = 0.5
"""Share of its power that noise has at least in the higher band, if it is not low-passed."""

COUNTS = 4.0
"""Times the variance of rounding, above which noise is more than that."""

MOST = 500
"""Periodograms at most."""


def quiet_density(recording: Recording, poses: Poses) -> FloatArray | None:
    """Return the one-sided power density of each channel between what hands do, (6,), per Hz.

    None where no rest lasts for a window, or samples are too far apart.
    """
    step = recording.interval
    width = round(WINDOW / step) if step > 0 else 0
    starts = [
        np.arange(a, b - width + 1, width) for a, b in zip(poses.start, poses.stop, strict=True)
    ]
    start = np.concatenate(starts)
    if width < 2 or not len(start):
        return None
    own = start[:: -(-len(start) // MOST)].astype(np.int64)[:, None] + np.arange(width)
    values = np.concatenate((recording.accel[own], recording.gyro[own]), axis=2)
    change = np.abs(np.diff(values, axis=1)).reshape(-1, values.shape[2])
    taper = np.hanning(width + 2)[1:-1]
    values -= values.mean(axis=1, keepdims=True)
    power = np.square(np.abs(np.fft.rfft(values * taper[:, None], axis=1)))
    power *= 2.0 * step / np.square(taper).sum()
    frequency = np.fft.rfftfreq(width, step)

    def level(low: float, high: float) -> FloatArray | None:
        band = (frequency >= low) & (frequency < min(high, 0.5 / step))
        if band.sum() < 2:
            return None
        # The median of chi-squared is less than its mean. The taper makes neighbours alike.
        freedom = 2.0 * band.sum() / 1.5
        usual = (1.0 - 2.0 / (9.0 * freedom)) ** 3
        return np.asarray(np.median(power[:, band].mean(axis=1), axis=0) / usual)

    each = [found for band in BANDS if (found := level(*band)) is not None]
    if not each:
        return None
    usual = np.median(each, axis=0) if len(each) > 2 else np.min(each, axis=0)
    higher = level(*HIGHER)
    if higher is None:
        return np.asarray(usual)
    count = np.array([np.quantile(c[c > 0], 0.05) if c.any() else 0.0 for c in change.T])
    believed = (higher > FLAT * each[-1]) & (each[-1] > COUNTS * np.square(count) * step / 6.0)
    return np.asarray(np.where(believed, np.minimum(each[-1], usual), usual))
