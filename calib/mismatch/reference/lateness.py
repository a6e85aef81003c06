"""How much later than the accelerometer a gyroscope shows the same motion, roughly.

Shapes of a delay of some milliseconds are those of its derivative. One of tens of milliseconds is
not: beside it a hand's tremor looks like noise, and as a derivative it may be fitted on a wrong
hill. So it is roughly known before anything is judged; to find it is left to the search.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from calib.types import FloatArray

REACH = 0.3
"""s by which a triad may be off the truth's time."""

SPAN = 0.1
"""s over which changes are correlated: what is slow peaks at no lag, and tremor at many."""

LATE = 0.008
"""s: below it a derivative does. It is half a radian of a tremor of 10 Hz."""


def rough_delay(measured: FloatArray, true: FloatArray, interval: float) -> tuple[float, float]:
    """Return how late measured forces, and rates, come after the true ones, s.

    Parameters
    ----------
    measured, true : (n, 6) arrays
        Forces, then rates.
    interval : float, s
    """
    return _lag(measured[:, :3], true[:, :3], interval), _lag(
        measured[:, 3:], true[:, 3:], interval
    )


def _lag(measured: FloatArray, true: FloatArray, interval: float) -> float:
    """Return the lag at which the changes of (n, 3) signals match best, s; 0 at the search's end.

    Between samples it is that of a parabola.
    """
    from scipy import fft  # only comparisons need it

    span = max(1, round(SPAN / interval))
    a, b = measured[span:] - measured[:-span], true[span:] - true[:-span]
    most = min(round(REACH / interval), len(a) // 2)
    size = fft.next_fast_len(len(a) + most)
    spectrum = (fft.rfft(a, size, axis=0) * np.conj(fft.rfft(b, size, axis=0))).sum(axis=1)
    lag = np.arange(-most, most + 1)
    match = fft.irfft(spectrum, size)[lag]
    k = int(np.argmax(match))
    if not 0 < k < len(lag) - 1:
        return 0.0
    below, here, above = match[k - 1 : k + 2]
    return float((lag[k] + 0.5 * (below - above) / (below - 2 * here + above)) * interval)


def delaying(time: FloatArray, delay: float) -> sparse.csr_matrix:
    """Return what takes a signal at times (n,) to that a `delay` before, s: (n, n).

    A cubic through four samples; at the ends, and beside gaps, they are held.

    References
    ----------
    .. [1] T. I. Laakso et al., "Splitting the unit delay", IEEE Signal Processing Magazine 13(1),
       1996, p. 30, eq. (42): Lagrange interpolation.
    """
    n = len(time)
    at = np.clip(time - delay, time[0], time[-1])
    first = np.clip(np.searchsorted(time, at, side="right") - 1, 0, n - 2)
    u = np.clip((at - time[first]) / (time[first + 1] - time[first]), 0.0, 1.0)
    weights = (
        -u * (u - 1.0) * (u - 2.0) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        -(u + 1.0) * u * (u - 2.0) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    )
    column = np.clip(first[:, None] + np.arange(-1, 3), 0, n - 1)
    row = np.repeat(np.arange(n), 4)
    values = np.stack(weights, axis=1).ravel()
    return sparse.csr_matrix((values, (row, column.ravel())), shape=(n, n))
