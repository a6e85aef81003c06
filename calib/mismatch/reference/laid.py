"""How the axes of a recording lie beside those of a simulation: swapped, or with the wrong sign.

A scale factor of -1 takes up a sign, and nine free numbers of a matrix any order. So before
anything is fitted, each of the 48 ways P to lay three axes onto three is judged by what it leaves,

    e(P) = sum |y - P x|^2 / sum (|y|^2 + |x|^2),

of forces as they are (gravity is in them), and of rates beside their mean (a bias is not). A turn
by an angle a leaves ``1 - cos a`` of what it turns.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.axis_error import ORDERS, signed_permutation
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.mounted import UNLIKE
from calib.mismatch.reference.truths import near
from calib.recording import Recording
from calib.types import FloatArray

ALIKE = 0.03
"""What the right way leaves, at most: a sensor that is mounted at 14 degrees leaves as much. One
that is mounted at a larger angle has no right way."""

TIED = 1.5
"""Up to so many times the least is as little: of axes that nothing turns about, all ways are alike,
and the one that changes least is said."""

FEWEST = 50
"""Samples that tell of it, at least."""


def laid(real: Recording, simulated: Recording, alignment: Alignment) -> Mapping[str, int]:
    """Return the numbers of the `ORDERS` in which a triad shows the axes of a simulation.

    Of triads that show them as they are nothing is returned.
    """
    at = alignment.times(real.time)
    known = (at >= simulated.time[0]) & (at <= simulated.time[-1]) & near(simulated.time, at)
    if known.sum() < FEWEST:
        return {}
    out = {}
    for triad in ("accel", "gyro"):
        own, true = getattr(real, triad)[known], getattr(simulated, triad)
        true = np.stack([np.interp(at[known], simulated.time, v) for v in true.T], axis=1)
        if triad == "gyro":
            own, true = own - own.mean(axis=0), true - true.mean(axis=0)
        number = _likeliest(own, true)
        if number:
            out[triad] = number
    return out


def _likeliest(own: FloatArray, true: FloatArray) -> int:
    """Return the number of the way in which (n, 3) vectors show those that are true."""
    total = float(np.square(own).sum() + np.square(true).sum())
    if not total:
        return 0
    both = own.T @ true
    ways = np.stack([signed_permutation(k) for k in range(len(ORDERS))])
    left = np.maximum(1.0 - 2.0 * np.einsum("kij,ij->k", ways, both) / total, 0.0)
    best = float(left.min())
    if best > ALIKE or left[0] < max(UNLIKE * best, ALIKE):
        return 0
    tied = np.flatnonzero(left <= TIED * best + 1e-6)
    changed = [int(np.count_nonzero(ways[k] - np.eye(3))) for k in tied]
    return int(tied[int(np.argmin(changed))])
