"""What rivals can explain at most, from the rows that they touch: their columns need no look.

A rival's whitened columns w are zero but on the rows R of its channels and of turns. With B the
orthonormal basis of what is fitted, to which y is orthogonal, and ``z = w - B B'w``,

    (y'z)² / z'z = (y_R'w)² / w'(I - B_R B_R')w <= y_R'(I - B_R B_R')^-1 y_R,

whatever w is, and the logarithm of a Bayes factor is at most half of that. Where an effect explains
far more, such rivals change nothing. Where that is not enough, what the columns Z of rivals explain
together, ``y'Z inv(Z'Z) Z'y``, bounds all that combine them in windows.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.noise import Whitener
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray

TOGETHER = (*((c,) for c in CHANNELS), CHANNELS[:3], CHANNELS[3:])
"""Channels that a rival is on: one of them, or those of a triad."""

NOTHING = 40.0
"""How far behind, in log evidence, all rivals together are less than the last digit of a number."""

ROUNDED = 1e-12
"""Share of a direction's power that rounding leaves of what is fitted there."""


def factors_that_count(
    stack: Stack, rows: Rows, whitener: Whitener, y: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return log B of all candidates but rivals that are `NOTHING`, -inf for these; and which.

    Parameters
    ----------
    stack, rows : Stack, Rows
    whitener : Whitener
        With all that is fitted projected out.
    y : (m,) array
        Whitened projected residual.
    """
    which = stack.physical
    factors = stack.log_bayes_factors(whitener, y, which=which)
    least = float((factors + stack.weight).max()) - NOTHING
    rivals = ~which
    for channels in TOGETHER:
        # Nothing is below zero.
        if least > 0 and most_explained(rows, whitener, y, channels) < least:
            rivals &= ~stack.of_channels(channels, physical=False)
    if rivals.any():
        own = stack.log_bayes_factors(whitener, y, which=rivals, least=least)
        factors = np.maximum(factors, own)
    return factors, factors > -np.inf


def most_explained(
    rows: Rows, whitener: Whitener, y: FloatArray, channels: tuple[str, ...]
) -> float:
    """Return the log-likelihood that anything on some channels can gain at most.

    It is not known, and infinite, where rounding leaves no positive matrix.
    """
    own = np.isin(rows.channel, [-1, *map(CHANNELS.index, channels)])
    basis, left = whitener.basis[own], y[own]
    along = basis.T @ left
    open_ = (1.0 + ROUNDED) * np.eye(len(along)) - basis.T @ basis
    try:
        root = linalg.cholesky(open_, lower=True)
    except linalg.LinAlgError:
        return np.inf
    told = linalg.solve_triangular(root, along, lower=True)
    return 0.5 * float(left @ left + told @ told)
