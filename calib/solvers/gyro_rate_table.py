"""Gyroscope on a rate table: the length of the measured rate is that of the table.

Model, per axis: ``w_m = s w + b + n`` with ``|w|`` known; the sensor may be mounted at any angle,
as long as it stays so while the table turns. At rest ``|w| = 0``.

Each spin gives one mean and one equation ``|inv(S) (mean - b)| = |rate|``, each pose three,
``mean = b``. Gauss-Newton on the noise-weighted residuals is the maximum-likelihood estimate, the
unknown direction of each spin being solved for implicitly: the residual is along that
direction, and the noise across it makes the length too long by ``tr(C across) / 2 |rate|``, which
is taken off. (The paper minimises ``|w|² - rate²`` over samples, eq. 6, which noise biases.)

The rate's sign tells nothing here, as the direction of the table's axis in the sensor is unknown.

References
----------
.. [1] Ranjbaran, Roudbari, Ebadollahi, JECEI 6(1), 2018, eq. (6).
.. [2] W. A. Fuller, Measurement Error Models, 1987, section 3.2 (nonlinear functional model).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.errors import InsufficientMotionError, NotConvergedError
from calib.fit import Exclusion, Fit
from calib.model import Triad
from calib.poses import Poses
from calib.recording import AXES, Recording
from calib.solvers._gyro_determined import GYRO_NAMES, GYRO_UNITS, TOLERANCE, determined
from calib.solvers._static_bias import noise_growth, static_bias
from calib.solvers.base import GyroSolver
from calib.solvers.outliers import between_variance, find_outliers
from calib.turns import Turns
from calib.types import FloatArray, IntArray

STEADY = 0.1
"""A spin is steady where its speed, smoothed over this time (s), stays near its plateau."""
NEAR = 0.05
"""How near, in parts of the plateau, before noise."""


def solve(
    recording: Recording,
    poses: Poses,
    turns: Turns,
    accel: Triad,
    *,
    gravity: float,
    options: Mapping[str, object],
) -> Fit:
    """Solve bias and scale factor error of each axis from spins at known rates.

    Parameters
    ----------
    recording : Recording
    poses, turns : Poses, Turns
        Each turn between two poses is one spin, of which the steady part is used.
    accel : Triad
        Not needed.
    gravity : float, m/s²
        Not needed.
    options : mapping
        ``table_rate``, rad/s: one number for all turns, one for each turn, or rows
        ``(start, stop, rate)`` with recording seconds between which the rate was steady.

    Returns
    -------
    Fit
        Residuals (m, 1) in rad: the angle of each spin less that of the table.

    Raises
    ------
    ValueError
        If ``table_rate`` is missing, of another shape, zero, or outside of the recording.
    InsufficientMotionError
        If there is neither a pose nor a spin.
    NotConvergedError
    """
    start, stop, rate = _spins(recording, turns, options)
    rest = static_bias(recording, poses)
    means = np.array([recording.gyro[a:b].mean(axis=0) for a, b in zip(start, stop, strict=True)])
    means = means.reshape(-1, 3)
    duration = recording.time[stop - 1] - recording.time[start] + recording.interval
    noise = noise_growth(recording, poses) / duration[:, None, None]

    keep = np.ones(len(rate), bool)
    values = np.concatenate([rest.bias, np.zeros(3)])
    extra = 0.0
    prior = np.zeros((6, 6))
    prior[:3, :3] = np.linalg.inv(rest.covariance)
    for _ in range(50):
        residual, jacobian, variance = _equations(values, means, noise, rate)
        weight = keep / (variance + extra)
        information = jacobian.T @ (weight[:, None] * jacobian) + prior
        judged = determined(information, TOLERANCE[:6])
        free = judged.free
        target = np.where(free, 0.0, -values)
        gradient = jacobian.T @ (weight * (residual + jacobian @ target))
        gradient += prior @ (values + target - np.concatenate([rest.bias, np.zeros(3)]))
        step = target
        step[free] = -np.linalg.solve(information[np.ix_(free, free)], gradient[free])
        values = values + step
        if np.max(step**2 * np.diag(information)) < 1e-6:
            spins = free[3:].sum()
            old, old_extra = keep, extra
            keep = ~find_outliers(residual, jacobian[:, 3:][:, free[3:]], variance)
            extra = between_variance(residual[keep], variance[keep], int(keep.sum() - spins))
            if np.array_equal(old, keep) and abs(extra - old_extra) <= 0.02 * variance.mean():
                break
    else:
        raise NotConvergedError(
            "the rate table's equations did not settle in 50 steps; check the unit and the values "
            "of the table's rate"
        )
    covariance = np.full((6, 6), np.nan)
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    covariance[:3, :3] += np.diag(rest.wander**2)
    covariance[~judged.known] = covariance[:, ~judged.known] = np.nan
    undetermined = tuple(n for n, k in zip(GYRO_NAMES[:6], judged.known, strict=True) if not k)
    interval = np.stack([recording.time[start], recording.time[stop - 1]], axis=1)
    return Fit(
        method=GYRO_SOLVER.name,
        triad=Triad(values[:3], values[3:]),
        names=GYRO_NAMES[:6],
        values=values,
        units=GYRO_UNITS[:6],
        covariance=covariance,
        residuals=(residual * duration)[keep, None],
        residual_unit="rad",
        intervals=interval[keep],
        degrees_of_freedom=int(keep.sum()) + 3 * len(poses) - int(free.sum()),
        condition_number=judged.condition_number,
        undetermined=undetermined,
        advice=tuple(
            f"mount the sensor so that the table turns it about axis {axis}, and spin it both ways"
            for axis, known in zip(AXES, judged.known[3:], strict=True)
            if not known
        ),
        excluded=(
            *rest.excluded,
            *(
                Exclusion((float(a), float(b)), 0.0, "the spin disagrees with the table's rate")
                for a, b in interval[~keep]
            ),
        ),
    )


def _equations(
    values: FloatArray, means: FloatArray, noise: FloatArray, rate: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residual ``|rate| - |w|`` (m,), its Jacobian (m, 6) and its variance (m,)."""
    inverse = 1 / (1 + values[3:])
    w = (means - values[:3]) * inverse
    length = np.linalg.norm(w, axis=1)
    direction = w / np.maximum(length, 1e-12)[:, None]
    covariance = noise * inverse[:, None] * inverse
    variance = np.einsum("mi,mij,mj->m", direction, covariance, direction)
    across = np.trace(covariance, axis1=1, axis2=2) - variance
    residual = rate - length + across / (2 * rate)
    jacobian = np.concatenate([direction * inverse, direction * w * inverse], axis=1)
    return residual, jacobian, variance


def _spins(
    recording: Recording, turns: Turns, options: Mapping[str, object]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return first and last-but-one sample of each steady spin, and its speed (rad/s, positive)."""
    if options.get("table_rate") is None:
        raise ValueError(
            "`table_rate` is needed by the method rate_table: the table's rate, one number, one "
            f"for each of the {len(turns)} turns, or rows (start, stop, rate)"
        )
    table = np.asarray(options["table_rate"], np.float64)
    if not np.isfinite(table).all():
        raise ValueError(f"`table_rate` must be finite, got {table.tolist()}")
    if table.ndim == 2 and table.shape[1] == 3:
        start = np.searchsorted(recording.time, table[:, 0], side="left")
        stop = np.searchsorted(recording.time, table[:, 1], side="right")
        speed = np.abs(table[:, 2])
        short = stop - start < 2
        if short.any():
            raise ValueError(
                f"`table_rate` row {int(np.argmax(short))} covers fewer than two samples of the "
                f"recording, which runs from {recording.time[0]:.6g} to {recording.time[-1]:.6g} s"
            )
        spinning = speed > 0
    elif table.ndim == 0 or table.shape == (len(turns),):
        speed = np.abs(np.broadcast_to(table, len(turns)))
        pairs = [
            _steady(recording, int(a), int(b)) for a, b in zip(turns.start, turns.stop, strict=True)
        ]
        start, stop = np.array(pairs, np.int64).reshape(-1, 2).T
        spinning = (speed > 0) & (stop - start > 1)
    else:
        raise ValueError(
            f"`table_rate` must be one number, one for each of the {len(turns)} turns, or rows "
            f"(start, stop, rate), got an array of shape {table.shape}"
        )
    if not spinning.any():
        raise InsufficientMotionError(
            "no spin was found between the poses, or all table rates are zero; record the table "
            "turning at a steady rate between two rests, about each axis of the sensor, both ways"
        )
    return start[spinning], stop[spinning], speed[spinning]


def _steady(recording: Recording, start: int, stop: int) -> tuple[int, int]:
    """Return the longest stretch of a turn in which its speed is on the plateau."""
    gyro, step = recording.gyro[start:stop], recording.interval
    width = max(1, round(STEADY / step))
    if len(gyro) < 4 * width:
        return start, start
    rest = 0.5 * (gyro[0] + gyro[-1])
    kernel = np.ones(width) / width
    smooth = np.stack([np.convolve(c, kernel, mode="valid") for c in gyro.T], axis=1)
    speed = np.linalg.norm(smooth - rest, axis=1)
    plateau = float(np.median(speed[speed > 0.5 * speed.max()]))
    noise = 1.4826 * float(np.median(np.abs(np.diff(gyro, axis=0)))) / np.sqrt(2 * width)
    on = np.abs(speed - plateau) < NEAR * plateau + 5 * noise
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    if not len(edges):
        return start, start
    begin, end = edges.reshape(-1, 2)[np.argmax(np.diff(edges.reshape(-1, 2), axis=1))]
    # A window is on the plateau as a whole: trim by its width at both ends.
    first, last = start + int(begin) + width, start + int(end) - 1
    return (first, last) if last > first else (start, start)


GYRO_SOLVER = GyroSolver(
    "rate_table", "bias and scale from spins on a table whose rate is known (table_rate)", solve
)
