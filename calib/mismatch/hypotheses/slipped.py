"""A sensor that slips in its mount: when, and by how much.

From a moment on both triads see the truth from a frame that is turned by a rotation vector v,

    s' = R(v) s = s + v x s + ...,

and a gyroscope that turns with its mount sees itself do so: by ``-v`` within a few samples. A truth
that was made up may turn nothing on the way, so both are tried.

Rows know of a degree what is quadratic in it. So columns are those about the rotation that was
found: ``e_j x R(v) s`` about each axis j, and what is left of ``R(v) s - s`` beside ``v x R(v) s``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.factors import log_bayes_factor
from calib.mismatch.hypotheses.peak import close_in
from calib.mismatch.hypotheses.windows import moved_window, typical_size
from calib.mismatch.noise.noise import Whitener
from calib.mismatch.rows.rows import Rows
from calib.rotation import mat_from_rotvec, rotvec_from_mat
from calib.types import FloatArray

TURN = ("turn_x", "turn_y", "turn_z")
"""The rotation vector that was found, rad, in the shape of a candidate."""

JOLT = "jolt"
"""1 in the shape where the gyroscope saw the slip itself."""

MOMENTS = 17
"""Moments about the one that was found that are tried: within a segment on either side."""

MOST = 0.7
"""rad that a sensor slips by at most; what leads beyond is no slip, and is not followed."""

PASSES = 3
"""How often the rotation is found anew: of 0.1 rad the first leaves 5e-3, the second 1e-5."""


def angle_of(candidate: Candidate) -> float | None:
    """Return by how much a sensor slipped, rad; None of what is no slip, or not placed yet."""
    if TURN[0] not in candidate.shape:
        return None
    return float(np.linalg.norm([candidate.shape[k] for k in TURN]))


def slip_columns(rows: Rows, candidate: Candidate) -> FloatArray:
    """Return the (m, 4) columns of a slip about the rotation that was found."""
    start, stop = _window(candidate)
    state, time = rows.state, rows.state.time
    turn = np.array([candidate.shape[k] for k in TURN])
    first = int(np.searchsorted(time, start))
    last = int(np.searchsorted(time, stop, side="right"))
    within = slice(first, last)
    out = np.zeros((len(rows.residual), 4))
    # Axes that err put out what they see of it.
    for c, matrix, true in zip((0, 3), rows.matrices, (state.force, state.rate), strict=True):
        seen = true[within] @ mat_from_rotvec(turn).T
        left = seen - true[within] - np.cross(turn, seen)
        columns = [*(np.cross(axis, seen) for axis in _unit(rows) * np.eye(3)), left]
        for k, values in enumerate(columns):
            for functional, own in zip(
                rows.functional[c : c + 3], (values @ matrix.T).T, strict=True
            ):
                out[:, k] += functional[:, within] @ own
    if JOLT in candidate.shape:
        for end, sign in ((first, -1.0), (last, 1.0)):
            if end < len(time):
                out[:, :3] += sign * _unit(rows) * _pulses(rows, max(end, 1))
    return out


def _pulses(rows: Rows, k: int) -> FloatArray:
    """Return what the gyroscope sees of one radian about each axis until sample `k`, (m, 3)."""
    length = rows.state.time[k] - rows.state.time[k - 1]
    seen = np.hstack([f[:, [k]].toarray() for f in rows.functional[3:]])
    return np.asarray(seen @ rows.matrices[1] / length)


def _window(candidate: Candidate) -> tuple[float, float]:
    assert candidate.interval is not None
    return candidate.interval


def _unit(rows: Rows) -> float:
    """Return the rotation that coefficients count, rad: gravity moves by a typical disturbance."""
    return typical_size("accel") / rows.state.gravity


def place_slip(
    rows: Rows, candidate: Candidate, whitener: Whitener, y: FloatArray
) -> tuple[Candidate, float]:
    """Return a slip, and its log B, with its rotation at those moments that explain most."""
    tried = []
    for names in (TURN, (*TURN, JOLT)):
        own = replace(candidate, shape=dict.fromkeys(names, 0.0))
        own, _ = _turned(rows, own, whitener, y)
        for end in (0, 1):
            if end == 0 or _window(own)[1] < rows.interval[-1, 1]:
                own = _moved(rows, own, end, whitener, y)
        tried.append(_turned(rows, own, whitener, y))
    return max(tried, key=lambda item: item[1])


def _turned(
    rows: Rows, candidate: Candidate, whitener: Whitener, y: FloatArray
) -> tuple[Candidate, float]:
    """Return a slip with the rotation that fits, and its log B."""
    for _ in range(PASSES):
        white = whitener.project(slip_columns(rows, candidate))
        # What is left beside the rotation is there in full.
        found = np.asarray(np.linalg.lstsq(white[:, :3], y - white[:, 3], rcond=1e-9)[0])
        candidate = turned_on(rows, candidate, found)
    return candidate, log_bayes_factor(whitener.project(slip_columns(rows, candidate)), y)


def turned_on(rows: Rows, candidate: Candidate, found: FloatArray) -> Candidate:
    """Return a slip about the rotation that coefficients (3,) of its columns lead to."""
    turn = np.array([candidate.shape[k] for k in TURN])
    more = _unit(rows) * found - turn
    turn = rotvec_from_mat(mat_from_rotvec(more) @ mat_from_rotvec(turn))
    if not np.linalg.norm(turn) < MOST:
        return candidate
    shape = {**candidate.shape, **dict(zip(TURN, turn.tolist(), strict=True))}
    return replace(candidate, shape=shape)


def _moved(
    rows: Rows, candidate: Candidate, end: int, whitener: Whitener, y: FloatArray
) -> Candidate:
    """Return a slip with one end of its window where it explains most, within a segment of it."""
    near = _window(candidate)[end]
    best = (-np.inf, candidate)

    def gain(moment: float) -> float:
        nonlocal best
        start, stop = (moment if k == end else at for k, at in enumerate(_window(candidate)))
        if not start < stop:
            return -np.inf
        there = moved_window(candidate, start, stop)
        value = log_bayes_factor(whitener.project(slip_columns(rows, there)), y)
        best = max(best, (value, there), key=lambda item: item[0])
        return value

    k = rows.segment_at(near)
    around = rows.interval[max(k - 1, 0) : k + 2]
    moments = np.linspace(around[0, 0], around[-1, 1], MOMENTS)
    values = [gain(t) for t in moments.tolist()]
    top = int(np.argmax(values))
    close_in(gain, float(moments[top]), values[top], 0.5 * float(moments[1] - moments[0]))
    return best[1]
