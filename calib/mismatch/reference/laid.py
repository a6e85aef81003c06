"""How the axes of a recording lie beside those of a truth: swapped, or with the wrong sign.

A scale factor of -1 takes up a sign, and nine free numbers of a matrix any order. So before
anything is fitted, each of the 48 ways P to lay three axes onto three is judged by what it leaves
of the power of vectors y beside the best multiple of P x,

    e(P) = 1 - tr(P' C)^2 / (sum |x|^2 sum |y|^2),   C = sum y x',

of forces as they are (gravity is in them), and of rates beside their mean (a bias is not). What is
turned by an angle a leaves ``sin^2 a``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.axis_error import ORDERS, signed_permutation
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.mounted import UNLIKE
from calib.mismatch.reference.truths import near
from calib.recording import Recording
from calib.rotation import skew
from calib.types import FloatArray

ALIKE = 0.05
"""What the right way leaves, at most: a sensor that is mounted at 13 degrees leaves as much. One
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
        number, _ = reading(own, true)
        if number:
            out[triad] = number
    return out


def reading(
    seen: FloatArray, true: FloatArray, about: FloatArray | None = None
) -> tuple[int, float]:
    """Return in which of the `ORDERS` a triad reads (n, 3) vectors, and how many times as large.

    These may be turned by any angle about an axis, (3,), if one is given: ``R(t) = cos(t) (I - u
    u') + sin(t) [u]x + u u'``, so that any trace is ``a cos(t) + b sin(t) + c``, and at most
    ``|(a, b)| + c``. The factor is 0 where no way explains what it reads.
    """
    power = float(np.square(true).sum() * np.square(seen).sum())
    if not power:
        return 0, 0.0
    ways = np.stack([signed_permutation(k) for k in range(len(ORDERS))])
    cross = np.einsum("kji,jl->kil", ways, seen.T @ true)  # P' C
    along = np.einsum("kii->k", cross)
    if about is not None:
        c = np.einsum("i,kij,j->k", about, cross, about)
        turn = np.einsum("kij,ij->k", cross, skew(about))  # tr(R' C) = C : R
        along = np.hypot(along - c, turn) + c
    left = 1.0 - np.square(np.maximum(along, 0.0)) / power
    best, number = float(left.min()), 0
    if best > ALIKE:
        return 0, 0.0
    if left[0] > max(UNLIKE * best, ALIKE):
        tied = np.flatnonzero(left <= TIED * best + 1e-6)
        changed = np.count_nonzero(ways[tied] - np.eye(3), axis=(1, 2))
        number = int(tied[int(np.argmin(changed))])
    return number, float(along[number] / np.square(true).sum())
