"""Spectra of two that saw one motion, of the parts that both know.

Beside what only one of them saw, nothing is common: a reference of a third of a recording would
seem to know next to nothing of its motion.

References
----------
.. [1] P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE
   Transactions on Audio and Electroacoustics AU-15(2), 1967, p. 70: means over parts that overlap.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.stillness import runs
from calib.types import BoolArray, FloatArray, IntArray

PART = 2.0
"""s of a part, where so many are known without a gap that there are `FEWEST` of them."""

FEWEST, SHORTEST = 8, 16
"""Parts whose mean tells a spectrum, and samples of the shortest."""


class Spectra(NamedTuple):
    """Power of two signals of three channels, and what they share, by frequency (m,), Hz.

    ``one`` and ``other`` (m, 3) are their power densities, ``cross`` (m, 3) is complex; ``number``
    is that of the parts which, end to end, are as long as what was used.
    """

    frequency: FloatArray
    one: FloatArray
    other: FloatArray
    cross: FloatArray
    number: float

    def coherence(self) -> FloatArray:
        """Return the share of their powers that is common, (m, 3): 0 of what stands still."""
        power = self.one * self.other
        return np.where(power > 0, np.square(np.abs(self.cross)), 0.0) / np.where(
            power > 0, power, 1.0
        )


def spectra_of(
    one: FloatArray, other: FloatArray, rate: float, known: BoolArray, window: str
) -> Spectra | None:
    """Return the spectra of two (n, 3) signals where both are known; None if that is too short.

    Parameters
    ----------
    one, other : (n, 3) arrays
    rate : float, Hz
    known : (n,) array of bool
    window : str
        Of each part, as scipy names them.
    """
    from scipy.signal import csd, welch  # half a second to import

    length = min(int(known.sum()) // FEWEST, round(PART * rate))
    first = _parts(known, length)
    while length >= 2 * SHORTEST and len(first) < FEWEST:
        length //= 2
        first = _parts(known, length)
    if length < SHORTEST or not len(first):
        return None
    at = first[:, None] + np.arange(length)
    frequency, own = welch(one[at], rate, window, nperseg=length, axis=1)
    _, seen = welch(other[at], rate, window, nperseg=length, axis=1)
    _, both = csd(one[at], other[at], rate, window, nperseg=length, axis=1)
    used = np.zeros(len(known), bool)
    used[at.ravel()] = True
    return Spectra(
        frequency, own.mean(axis=0), seen.mean(axis=0), both.mean(axis=0), used.sum() / length
    )


def _parts(known: BoolArray, length: int) -> IntArray:
    """Return where parts of so many known samples begin, every half of one."""
    every = max(1, length // 2)
    starts = [np.arange(a, b - length + 1, every) for a, b in zip(*runs(known), strict=True)]
    return np.concatenate([np.zeros(0, np.int64), *starts])
