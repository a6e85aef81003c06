"""How much later than the accelerometer a gyroscope shows the same motion, roughly.

Shapes of a delay of some milliseconds are those of its derivative. One of tens of milliseconds is
not: beside it a hand's tremor looks like noise, and as a derivative it may be fitted on a wrong
hill. So it is roughly known before anything is judged; to find it is left to the search.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from calib.types import FloatArray

REACH = 0.3
"""s by which a triad may be off the truth's time."""

SPAN = 0.1
"""s over which changes are correlated: what is slow peaks at no lag, and tremor at many."""

ENOUGH = 40_000
"""Samples that tell of it, at most."""

PASSES = 4
"""How often it is sought, each time about where it was found."""

TOLD = 0.5
"""Share of the changes that must be explained at the best lag: what feels nothing of the motion, as
an accelerometer on a table that turns about the vertical, tells of no lag."""

LATE = 0.008
"""s: below it a derivative does. It is half a radian of a tremor of 10 Hz."""


def rough_delay(measured: FloatArray, true: Sequence[FloatArray], interval: float) -> float | None:
    """Return how late a triad comes after the truth, s; None if that does not show.

    It is the lag at which the changes of what it measured are explained best by those of true
    signals, each with a factor (least squares); between samples that of a parabola.

    Parameters
    ----------
    measured : (n, 3) array
    true : arrays (n, 3)
        What the triad feels, and what it may feel besides: what a unit of a lever arm adds.
    interval : float, s
    """
    span = max(1, round(SPAN / interval))
    a, *bases = (signal[span:] - signal[:-span] for signal in (measured, *true))
    most = min(round(REACH / interval), len(a) // 4)
    late = 0.0
    # What moves at the ends draws the lag to zero, by a share of it.
    for _ in range(PASSES):
        shift = int(np.clip(round(late), -most, most))
        inner = slice(most, len(a) - most)
        moved = [b[most - shift : len(b) - most - shift] for b in bases]
        left = _lag(a[inner], moved, most)
        if left is None:
            return None
        late = shift + left
        if round(late) == shift:
            break
    return late * interval


def _lag(a: FloatArray, bases: Sequence[FloatArray], most: int) -> float | None:
    """Return the lag at which (n, 3) signals explain one best, in samples; None if none does."""
    from scipy import fft  # only comparisons need it

    size = fft.next_fast_len(len(a) + most)
    lag = np.arange(-most, most + 1)
    spectrum = fft.rfft(a, size, axis=0)
    match = np.empty((len(bases), len(lag)))
    for own, b in zip(match, bases, strict=True):
        product = spectrum * np.conj(fft.rfft(b, size, axis=0))
        own[:] = fft.irfft(product.sum(axis=1), size)[lag]
    flat = np.stack([b.ravel() for b in bases])
    power = np.einsum("kl,kl->l", match, np.linalg.pinv(flat @ flat.T, rcond=1e-9) @ match)
    k = int(np.argmax(power))
    if not 0 < k < len(lag) - 1 or power[k] < TOLD * float(np.square(a).sum()):
        return None
    below, here, above = power[k - 1 : k + 2]
    bend = below - 2 * here + above
    return float(lag[k] + (0.5 * (below - above) / bend if bend < 0 else 0.0))


def liveliest(rate: FloatArray) -> slice:
    """Return the part of a long recording in which rates (n, 3) change most, `ENOUGH` long."""
    starts = range(0, max(len(rate) - ENOUGH, 0) + 1, ENOUGH)
    first = max(starts, key=lambda i: float(rate[i : i + ENOUGH].var(axis=0).sum()))
    return slice(first, first + ENOUGH)


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
