"""What a comparison of two simulations without noise errs by, where the computation is what errs.

All that a diagnosis says is relative to noise. Without any, what is left of a difference is what a
spline makes between samples of unlike rates and what rounding took from the digits of a file; it
goes with the motion, and would be taken for effects of it. So the recording gets the noise of the
quietest sensor (`calib.mismatch.noise.hush`), or of its own digits if that is more; and where the
truth is not known well beside that, as where a turn begins within one interval, it says nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from calib import faults
from calib.effects.base import State
from calib.mismatch.noise.hush import HUSHED, count_of, least_noise
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.truths import DEGREE, RecordingTruth
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS, Recording
from calib.stillness import runs
from calib.types import BoolArray, FloatArray

EXACT = 0.1
"""Error of a truth, relative to the noise, up to which it counts as exact."""

KNOWN = 0.7
"""Share of the samples at which it must be. Where fewer are, noise is what makes them: samples too
few for the motion tell less of it."""

HIGHER = 6
"""Degrees by which a second spline is above that of the truth. What is smooth both give alike; of a
kink each makes an echo of its own, the second over more samples."""

NEAR = 4
"""Intervals about a moment within which splines are compared: by chance they agree somewhere."""

PART = 64
"""Samples of which differences are told from noise."""

STUCK = 8
"""Samples on one value from which on it rests there, and is no sample of motion by chance."""

QUIET = 0.2
"""Share of such parts that are taken to hold noise only."""


class Heard(NamedTuple):
    """A recording with noise, which of its samples say nothing, and how it sticks to its counts.

    ``stuck`` are six sparse (n, k) matrices: by how much each channel is off in its n samples for
    each of k errors, independent and normal, that rounding made.
    """

    real: Recording
    spoilt: BoolArray
    stuck: tuple[sparse.csr_matrix, ...]


def audible_beside(
    real: Recording,
    truth: RecordingTruth,
    alignment: Alignment,
    mat: FloatArray,
    spoilt: BoolArray,
) -> Heard | None:
    """Return the recording with noise where the differences from a truth have none, else None.

    Parameters
    ----------
    real : Recording
    truth : RecordingTruth
    alignment : Alignment
    mat : (3, 3) array
        From the truth's frame to the recording's.
    spoilt : (n,) array of bool
        Samples that say nothing. Where the truth is not exact are more of them.
    """
    at = alignment.times(real.time)
    known = truth.covers(at) & ~spoilt
    values = faults.values_of(real)
    noise = least_noise(real.interval)
    if known.sum() < PART:
        return None
    hushed = noise_of_differences(values[known], truth.state(at[known]), mat) < noise
    if not hushed.any():
        return None
    other = count_of(faults.values_of(truth.recording))
    step = np.hypot(count_of(values), np.hstack((other[:3] @ mat.T**2, other[3:] @ mat.T**2)))
    error = interpolation_error(truth, at, mat)
    noise = np.maximum(noise, step)
    noise = np.maximum(noise, np.quantile(error[known], KNOWN, axis=0) / EXACT) * hushed
    loose: BoolArray = np.any(error[:, hushed] > EXACT * noise[hushed], axis=1)
    stuck = tuple(
        _stuck(channel) * (size / np.sqrt(12.0))
        for channel, size in zip(values.T, step * hushed, strict=True)
    )
    values = values + noise * np.random.default_rng(len(values)).standard_normal(values.shape)
    names = ", ".join(name for name, own in zip(CHANNELS, hushed, strict=True) if own)
    notes = {**real.notes, HUSHED: names}
    heard = replace(real, accel=values[:, :3], gyro=values[:, 3:], notes=notes)
    return Heard(heard, spoilt | loose, stuck)


def _stuck(channel: FloatArray) -> sparse.csr_matrix:
    """Return where (n,) values rest on each of the k values that they do, (n, k) of 0 and 1.

    What rounding makes of a value is the same whenever it is the same.
    """
    start, stop = runs(np.diff(channel) == 0)
    long = stop - start >= STUCK
    start, stop = start[long], stop[long] + 1
    value, which = np.unique(channel[start], return_inverse=True)
    row = np.concatenate([np.arange(a, b) for a, b in zip(start, stop, strict=True)] or [start])
    column = np.repeat(which, stop - start)
    shape = len(channel), len(value)
    return sparse.csr_matrix((np.ones(len(row)), (row, column)), shape=shape)


def with_rounding(rows: Rows, stuck: tuple[sparse.csr_matrix, ...]) -> Rows:
    """Return rows that err by what rounding does to values that rest, too."""
    felt = sparse.hstack([f @ own for f, own in zip(rows.functional, stuck, strict=True)]).tocsr()
    dense = felt[: rows.n_dense]
    alone = np.asarray(felt[rows.n_dense :].power(2).sum(axis=1)).ravel()
    return replace(
        rows,
        white=rows.white + (dense @ dense.T).toarray(),
        white_diagonal=rows.white_diagonal + alone,
    )


def interpolation_error(truth: RecordingTruth, at: FloatArray, mat: FloatArray) -> FloatArray:
    """Return by how much a truth's signals may err at (n,) times of its clock, frame s, (n, 6).

    Half-way between samples it is what two splines differ by, there or nearby; towards a sample,
    through which both pass, it goes to zero as a sine does.
    """
    from scipy import ndimage  # as the next, needed here only
    from scipy.interpolate import make_interp_spline

    recording = truth.recording
    time = recording.time
    spline = make_interp_spline(time, faults.values_of(recording), k=DEGREE + HIGHER)
    middle = (time[1:] + time[:-1]) / 2
    state = truth.state(middle)
    differ = np.abs(np.hstack((state.force, state.rate)) - spline(middle))
    most = ndimage.maximum_filter1d(differ, 2 * NEAR + 1, axis=0)
    size = np.abs(mat).T
    most = np.hstack((most[:, :3] @ size, most[:, 3:] @ size))
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    phase = (at - time[before]) / (time[before + 1] - time[before])
    return np.asarray(most[before] * np.abs(np.sin(np.pi * phase))[:, None])


def noise_of_differences(values: FloatArray, state: State, mat: FloatArray) -> FloatArray:
    """Return the noise of each channel of (n, 6) values beside a true state, (6,).

    In each part of the recording it is what the truth's signals, their slopes and the products of
    an arm leave: few effects look otherwise within a second.
    """
    force, rate = state.force @ mat.T, state.rate @ mat.T
    slopes = np.gradient(np.hstack((force, rate)), axis=0)
    products = rate[:, [0, 0, 0, 1, 1, 2]] * rate[:, [0, 1, 2, 1, 2, 2]]
    columns = np.hstack((np.ones((len(rate), 1)), force, rate, slopes, products))
    count = len(values) // PART
    design, y = (part[: count * PART].reshape(count, PART, -1) for part in (columns, values))
    u, size, _ = np.linalg.svd(design, full_matrices=False)
    u = u * (size > 1e-12 * size[:, :1])[:, None]
    left = y - u @ (u.transpose(0, 2, 1) @ y)
    spread = np.sqrt(np.square(left).sum(axis=1) / (PART - design.shape[2]))
    return np.asarray(np.quantile(spread, QUIET, axis=0))
