"""Held-out blocks: what a finding is worth on poses and turns that did not see it.

Folds take every fifth pose with the turn that follows it; where there are fewer poses than folds,
every fifth part of a rest. With ``r`` the whitened residual after
the fit of all rows and ``Q`` an orthonormal basis of the fitted columns, what a fit *without* the
rows B would have left there is ``(I - Q_B Q_B')^-1 r_B``: no fit is repeated. Directions that only
B determines (the attitude of a pose that is held out) have no prediction and are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from calib.mismatch.noise.noise import Whitener, make_whitener
from calib.mismatch.rows.arrow import Factor
from calib.mismatch.rows.rows import Kind, Rows
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

FOLDS = 5

UNTOLD = 1e-4
"""Share of a direction of rows that others must tell, or nothing of it can be foretold."""

TOLD = 1e-6
"""Share of the precision of a direction of rows that others must leave, or they foretell nothing
of it."""

_UNITS = {Kind.ATTITUDE: "rad", Kind.VELOCITY: "m/s"}


class HeldOut(NamedTuple):
    """Residual RMS on held-out blocks before and after, beside what noise alone leaves."""

    before: float
    after: float
    noise_floor: float
    unit: str
    rows: str
    gain: float
    channels: Mapping[str, tuple[float, float]] = {}


class LeftOut(NamedTuple):
    """What a fit says of each block from all others.

    ``square`` (m,) are its errors squared where parameters alone foretell, ``floor`` what noise
    leaves of them, and ``whitener`` is that of this. For each block there are ``(values, vectors,
    pull)``: the precision of what is foretold with all noise, and by that how far it is missed, in
    units of each row's.
    """

    whitener: Whitener
    square: FloatArray
    floor: FloatArray
    blocks: list[tuple[FloatArray, FloatArray, FloatArray]]


def leave_out(
    rows: Rows, mean: FloatArray, residual: FloatArray, *, levels: FloatArray, contrast: FloatArray
) -> LeftOut:
    """Return what the fit of (m, p) columns to the residual says of each block from all others."""
    still = with_drift_as_jitter(rows, levels)
    whitener = make_whitener(rows, still, contrast, mean, coupled=False)
    square, floor = _squares(rows, whitener, residual)
    floor = at_most_left(rows, square, floor)
    return LeftOut(whitener, square, floor, _blocks(rows, mean, residual, levels, contrast))


def with_drift_as_jitter(rows: Rows, levels: FloatArray) -> FloatArray:
    """Return the levels of noise by which parameters alone predict, as no drift is interpolated."""
    still = np.array(levels)
    names = [c.name for c in rows.components]
    for i, name in enumerate(names):
        if name.endswith((" walk", " flicker")):
            still[names.index(f"{name.split(' ')[0]} jitter")] += 0.5 * still[i]
            still[i] = 0.0
    return still


def at_most_left(rows: Rows, square: FloatArray, floor: FloatArray) -> FloatArray:
    """Return what noise leaves of rows, (m,) squares: beside a noisy truth at most what is left.

    Where windows are restless samples scatter by more than in quiet ones, and of what colour that
    is nobody knows: rows are weighed by it as if it were white. But most of it is fast (shaking
    that markers do not follow), and means err by two to four times less. All that is left is noise
    at most.
    """
    if not rows.clustered:
        return floor
    out = floor.copy()
    groups = np.stack((rows.kind, rows.channel // 3, rows.restless), axis=1)
    for group in np.unique(groups, axis=0):
        own = (groups == group).all(axis=1)
        if (total := float(floor[own].sum())) > 0:
            out[own] *= min(1.0, float(square[own].sum()) / total)
    return out


def held_out(
    rows: Rows,
    fitted_before: FloatArray,
    columns: FloatArray,
    residual: FloatArray,
    *,
    levels: FloatArray,
    contrast: FloatArray,
    channels: tuple[str, ...],
    after: LeftOut | None = None,
) -> HeldOut:
    """Leave out every block in turn, without and with the columns of one finding.

    Parameters
    ----------
    rows : Rows
    fitted_before : (m, p) array
        Columns of all else that is fitted.
    columns : (m, k) array
        Of the finding.
    residual : (m,) array
        With the finding's part in it.
    levels, contrast : arrays
        Noise, as the search ends with it.
    channels : tuple of str
        What the finding touches: the rows that are reported are of these channels.
    after : LeftOut, optional
        By the fit of all these columns, if it is known: beside several findings it is the same.

    Returns
    -------
    HeldOut
        RMS in physical units over the kind of rows in which the finding shows most, and before and
        after on each channel of these; ``gain`` is the log-likelihood gained on all held-out rows,
        drift being noise.
    """
    before = leave_out(rows, fitted_before, residual, levels=levels, contrast=contrast)
    if after is None:
        every = np.hstack((fitted_before, columns))
        after = leave_out(rows, every, residual, levels=levels, contrast=contrast)
    which, label, unit = _telling_rows(rows, before.whitener, columns, channels)
    size = [float(np.sqrt(side.square[which].mean())) for side in (before, after)]
    gain, errors = _gain(before, after)
    if gain > 0 and size[1] >= size[0]:
        # Small beside the jitter of single rows, but not beside the noise of all of them.
        return HeldOut(errors[0], errors[1], 1.0, "1", "all rows, in standard errors", gain)
    each = {}
    for c in np.unique(rows.channel[which & (rows.channel >= 0)]):
        own = which & (rows.channel == c)
        without, with_it = (float(np.sqrt(side.square[own].mean())) for side in (before, after))
        each[CHANNELS[c]] = (without, with_it)
    noise = float(np.sqrt(after.floor[which].mean()))
    return HeldOut(size[0], size[1], noise, unit, label, gain, each)


def fold_of(rows: Rows) -> IntArray:
    """Return the fold of each row."""
    _, order = np.unique(rows.block, return_inverse=True)
    if order.max() < FOLDS - 1:
        _, order = np.unique(rows.segment, return_inverse=True)
    return np.asarray(order % FOLDS)


def pose_levels(rows: Rows, channels: tuple[str, ...]) -> FloatArray:
    """Return steps from pose to pose at rest, (m, k); none in one pose, or with enough of them.

    Of fewer poses than folds none can be left out: what follows the direction of gravity or changes
    between two of them fits any such steps. What these leave is seen within rests and in turns.
    """
    means = (rows.kind == Kind.MEAN) & rows.is_rest[rows.segment]
    poses = np.unique(rows.block[means])
    if not 1 < len(poses) < FOLDS:
        return np.zeros((len(rows.kind), 0))
    own = [means & (rows.channel == CHANNELS.index(c)) for c in channels]
    steps = [
        1.0 * (rest & (rows.block == a)) - (rest & (rows.block == b))
        for rest in own
        for a, b in pairwise(poses)
    ]
    return np.column_stack(steps)


def _telling_rows(
    rows: Rows, whitener: Whitener, columns: FloatArray, channels: tuple[str, ...]
) -> tuple[BoolArray, str, str]:
    power = np.square(whitener.project(columns)).sum(axis=1)
    touched = np.isin(rows.channel, [CHANNELS.index(c) for c in channels])
    best = (-1.0, np.zeros(len(power), bool), "", "")
    for kind in Kind:
        for triad, unit in (("accel", "m/s²"), ("gyro", "rad/s")):
            own = rows.kind == kind
            label = kind.name.lower()
            if kind in (Kind.MEAN, Kind.CONTRAST):
                own &= touched & (rows.channel // 3 == (0 if triad == "accel" else 1))
                where = "at rest" if rows.is_rest.any() else "over windows"
                label = f"{triad} {'means' if kind == Kind.MEAN else 'changes'} {where}"
            else:
                unit = _UNITS[kind]
                label = f"{label} closure of turns"
            if own.any() and power[own].sum() > best[0]:
                best = (float(power[own].sum()), own, label, unit)
    return best[1], best[2], best[3]


def _squares(rows: Rows, whitener: Whitener, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the held-out error of each row squared, and the square that noise alone leaves."""
    left, basis = whitener.project(residual), whitener.basis
    factor = _of_its_own(whitener.factor)
    fold = fold_of(rows)
    square, floor = np.zeros(len(left)), np.zeros(len(left))
    for k in range(FOLDS):
        own = np.flatnonzero(fold == k)
        if not len(own):
            continue
        # With B the basis in this fold, errors are those of ``inv(I - B B')``: of the directions
        # ``B v`` of eigenvectors v of B'B, whose values s are shares that the others do not tell.
        shares, vectors = np.linalg.eigh(basis[own].T @ basis[own])
        along = basis[own] @ vectors
        told = shares < 1.0 - UNTOLD
        more = np.where(told, 1.0, -1.0) / np.where(told, 1.0 - shares, shares)
        error = left[own] + along @ (more * (along.T @ left[own]))
        # Without walks the covariance does not couple segments, so neither does its factor.
        square[own] = np.square(_colour(rows, factor, whitener.scale, own, error[:, None])[:, 0])
        spread = np.square(_colour(rows, factor, whitener.scale, own, along)) @ more
        floor[own] = np.maximum(spread + _variance(rows, factor, whitener.scale, own), 0.0)
    return square, floor


def _of_its_own(factor: Factor) -> FloatArray:
    """Return the triangle of the covariance that closures have where rests beside them are known.

    But for a walk they have it with nothing at rest, unless a hand holds the sensor: what it turned
    on average in a rest is told there, as rates are in a turn.
    """
    out = factor.dense()
    others = np.setdiff1d(np.arange(len(out)), factor.border)
    out[np.ix_(factor.border, others)] = 0.0
    return out


def _variance(rows: Rows, factor: FloatArray, scale: FloatArray, own: IntArray) -> FloatArray:
    """Return the variance of rows `own`, which must be closed under the covariance."""
    dense = own < rows.n_dense
    out = np.empty(len(own))
    out[dense] = np.square(factor[np.ix_(own[dense], own[dense])]).sum(axis=1)
    out[~dense] = np.square(scale[own[~dense] - rows.n_dense])
    return out


def _colour(
    rows: Rows, factor: FloatArray, scale: FloatArray, own: IntArray, values: FloatArray
) -> FloatArray:
    """Undo the whitening of rows `own`, which must be closed under the covariance."""
    out = np.empty_like(values)
    dense = own < rows.n_dense
    out[dense] = factor[np.ix_(own[dense], own[dense])] @ values[dense]
    out[~dense] = values[~dense] * scale[own[~dense] - rows.n_dense, None]
    return out


def _blocks(
    rows: Rows,
    mean: FloatArray,
    residual: FloatArray,
    levels: FloatArray,
    contrast: FloatArray,
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return what is foretold of each block with the full noise model, as `LeftOut` has it.

    What other blocks foretell of the rows B is normal, with the precision ``P_BB`` of all rows
    beneath the fit, and misses them by ``P_BB^-1 (P y)_B``.
    """
    whitener = make_whitener(rows, levels, contrast, mean, coupled=False)
    hidden = whitener.unwhiten_transposed(whitener.basis)
    pull = whitener.unwhiten_transposed(whitener.project(residual)[:, None])[:, 0]
    out = []
    for own, scale, alone in _unfitted(rows, levels, contrast):
        felt = hidden[own] / scale[:, None]
        values, vectors = np.linalg.eigh(alone - felt @ felt.T)
        # Directions that only this block determines have no power left.
        good = values > TOLD
        out.append((values[good], vectors[:, good], pull[own] / scale))
    return out


def _unfitted(
    rows: Rows, levels: FloatArray, contrast: FloatArray
) -> list[tuple[IntArray, FloatArray, FloatArray]]:
    """Return the rows of each block, and their precision where nothing is fitted.

    That is the root of each row's own, and the matrix in units of these. The last is kept: it is
    the same with and without every finding.
    """
    key = levels.tobytes(), contrast.tobytes()
    known, blocks = rows.kept.get("unfitted", (None, []))
    if known == key:
        return list(blocks)
    fold, dense = fold_of(rows), rows.n_dense
    half = rows.arrow.factorise(levels).solve_transposed(np.eye(dense))
    root = np.sqrt(np.append(np.einsum("ij,ij->i", half, half), 1.0 / contrast))
    blocks = []
    for k in range(FOLDS):
        own = np.flatnonzero(fold == k)
        if not len(own):
            continue
        precision = np.eye(len(own))
        first = half[own[own < dense]] / root[own[own < dense], None]
        precision[: len(first), : len(first)] = first @ first.T
        blocks.append((own, root[own], precision))
    rows.kept["unfitted"] = key, blocks
    return blocks


def _told_by_both(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the directions that the larger fit foretells and the other does too.

    It has fewer of its own only where rounding takes some of them.
    """
    few = before.shape[1]
    if after.shape[1] <= few:
        return after
    return np.asarray(after @ np.linalg.svd(after.T @ before)[0][:, :few])


def _gain(before: LeftOut, after: LeftOut) -> tuple[float, tuple[float, float]]:
    """Return the held-out log-likelihood gained, with the full noise model.

    Who is vague pays for the width of what is foretold [1]_. Both are judged by what the larger fit
    foretells, the rest nobody can compare.

    Beside it the RMS of the normalised prediction errors before and after.

    References
    ----------
    .. [1] Gneiting, Raftery, "Strictly proper scoring rules, prediction, and estimation",
       JASA 102, 2007, sec. 4.1 (the logarithmic score).
    """
    gain, square, number = 0.0, np.zeros(2), 0
    for pair in zip(before.blocks, after.blocks, strict=True):
        told = _told_by_both(*(vectors for _, vectors, _ in pair))
        for i, (values, vectors, pull) in enumerate(pair):
            spread = (told.T @ vectors) / np.sqrt(values)
            error = spread @ ((vectors.T @ pull) / np.sqrt(values))
            # Not of the product, which has lost half of the digits.
            root = np.asarray(np.linalg.qr(spread.T, mode="r"))
            missed = float(np.square(np.linalg.solve(root.T, error)).sum())
            width = float(np.log(np.abs(np.diagonal(root))).sum())
            gain += (-0.5 * missed - width) * (1 if i else -1)
            square[i] += missed
        number += told.shape[1]
    errors = np.sqrt(square / max(number, 1))
    return gain, (float(errors[0]), float(errors[1]))
