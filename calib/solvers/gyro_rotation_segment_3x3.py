"""Gyroscope by attitude closure: bias, scale and full misalignment from turns about any axes.

Model, per sample: ``w_m = (I + S + M) w + b + n``, M full 3x3 (zero diagonal), so that the
corrected rate is in the accelerometer's frame.

Two kinds of equations are solved together, by Gauss-Newton with analytic sensitivities:

- at each pose ``mean(w_m) = b + noise``;
- for each turn ``u_before = R(b, S, M) u_after``, where ``u`` is gravity's direction from the
  calibrated accelerometer and R the rotation integrated from the corrected rate: two equations a
  turn, as heading is free. See `calib.closure` for R and its derivatives.

The noise of a turn is that of the two directions, of the integrated rate, and an inflation
``tau²`` for what the model lacks, estimated by restricted maximum likelihood. Two turns that meet
at a pose share its direction's error: the weight matrix knows that. A turn or a pose that does not
fit is given a free shift of its own, which leaves it out and keeps the rest: without a bumped pose,
the turns before and after it still close as one.

References
----------
.. [1] Ranjbaran, Roudbari, Ebadollahi, JECEI 6(1), 2018, eqs. (12) to (14): the per-axis method
   that this one generalises.
.. [2] Patterson, Thompson, "Recovery of inter-block information when block sizes are unequal",
   Biometrika 58(3), 1971: restricted maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.closure import TurnSteps, pose_directions
from calib.fit import Exclusion, Fit
from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.solvers._closure_fit import fit_closures
from calib.solvers._closure_noise import Information
from calib.solvers._closure_system import ClosureSystem, unpack
from calib.solvers._determined import (
    GYRO_NAMES,
    GYRO_UNITS,
    TOLERANCE,
    determined,
    gyro_advice,
    visible_turning,
)
from calib.solvers._static_bias import noise_growth, static_bias
from calib.solvers.base import GyroSolver
from calib.turns import Turns
from calib.types import FloatArray

REASONS = {
    "turn": "the turn does not close with the others: clipped, shaken, or moved at its ends",
    "pose": "gravity's direction here disagrees with the turns before and after: bumped",
}

AMBIGUOUS = "the turn is so long that its angle is uncertain by more than gravity can tell apart"


def solve(
    recording: Recording,
    poses: Poses,
    turns: Turns,
    accel: Triad,
    *,
    gravity: float,
    options: Mapping[str, object],
) -> Fit:
    """Solve bias, scale factor error and misalignment of the gyroscope from attitude closure.

    Parameters
    ----------
    recording : Recording
    poses, turns : Poses, Turns
    accel : Triad
        The accelerometer's calibration; its frame is the one that the gyroscope is aligned to.
    gravity : float, m/s²
        Not needed: only its direction is used.
    options : mapping
        None are known.

    Returns
    -------
    Fit
        Residuals (m, 2) in rad: the closure error of each turn that was used, in the horizontal
        plane. ``intervals`` says when these turns were.

    Raises
    ------
    InsufficientMotionError
        If there is no pose.
    NotConvergedError
        If the equations do not settle.
    """
    bias = static_bias(recording, poses)
    precision = np.zeros((12, 12))
    precision[:3, :3] = np.linalg.inv(bias.covariance)
    static = Information(precision, np.concatenate([bias.bias, np.zeros(9)]))
    steps = TurnSteps.of(recording, turns)
    system = ClosureSystem(
        steps,
        turns,
        pose_directions(poses, accel),
        noise_growth(recording, poses),
        0.5 * (bias.deviation[turns.before] + bias.deviation[turns.after]),
    )
    fit = fit_closures(system, static)

    judged = determined(fit.information, TOLERANCE)
    free = judged.free
    covariance = np.full((12, 12), np.nan)
    inverse = np.linalg.inv(fit.information[np.ix_(free, free)])
    covariance[np.ix_(free, free)] = inverse
    covariance[~judged.known] = covariance[:, ~judged.known] = np.nan
    undetermined = tuple(n for n, ok in zip(GYRO_NAMES, judged.known, strict=True) if not ok)
    triad = unpack(fit.values)
    left_out = fit.judgement.left_out
    used = turns.select(fit.used)
    skipped = turns.select(~fit.used).interval
    excluded = [
        *bias.excluded,
        *(_exclusion(interval, AMBIGUOUS) for interval in skipped),
        *(
            _exclusion((used if kind == "turn" else poses).interval[i], REASONS[kind])
            for kind, i in left_out
        ),
    ]
    kept = np.array([("turn", i) not in left_out for i in range(len(used))], bool)
    residuals = fit.residuals.reshape(-1, 2)[kept]
    return Fit(
        method=GYRO_SOLVER.name,
        triad=triad,
        names=GYRO_NAMES,
        values=fit.values,
        units=GYRO_UNITS,
        covariance=covariance,
        residuals=residuals,
        residual_unit="rad",
        intervals=used.interval[kept],
        degrees_of_freedom=_degrees_of_freedom(
            len(used), len(poses), int(free.sum()), len(left_out)
        ),
        condition_number=judged.condition_number,
        undetermined=undetermined,
        advice=gyro_advice(undetermined, *visible_turning(steps, system.directions, turns, triad)),
        excluded=tuple(excluded),
    )


def _exclusion(interval: FloatArray, reason: str) -> Exclusion:
    return Exclusion((float(interval[0]), float(interval[1])), 0.0, reason)


def _degrees_of_freedom(turns: int, poses: int, parameters: int, left_out: int) -> int:
    return 2 * turns + 3 * poses - parameters - 2 * left_out


GYRO_SOLVER = GyroSolver(
    "rotation_segment_3x3",
    "bias, scale and full misalignment to the accelerometer from turns about any axes (default)",
    solve,
)
