"""What a finding changes: what had absorbed it, and how much better what was left out is said."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.calibration import parameter_unit
from calib.mismatch.findings.diagnosis import Absorbed, Change
from calib.mismatch.findings.heldout import (
    HeldOut,
    LeftOut,
    at_most_left,
    held_out,
    pose_levels,
    with_drift_as_jitter,
)
from calib.mismatch.noise.noise import make_whitener
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.accepted import Accepted, fitted
from calib.mismatch.search.estimate import Estimate, solved
from calib.mismatch.search.search import Outcome
from calib.types import BoolArray, FloatArray

FEW_POSES = float(np.log(100.0))
"""Held-out log-likelihood that a name must gain where poses are too few for one to be left out."""


def prove(
    outcome: Outcome,
    fit: Estimate,
    which: int,
    names: tuple[str, ...],
    after: Callable[[], LeftOut],
) -> tuple[tuple[Absorbed, ...], HeldOut, FloatArray]:
    """Return what had absorbed a finding, its held-out worth, and the residuals without it.

    ``after`` is what the fit of all findings says of blocks that are left out of it.
    """
    own, rows = outcome.accepted[which], judging(outcome, which)
    mean = fitted(rows, _others(outcome, which))
    left, without, determined = fit_without(outcome, which)
    sigma = np.sqrt(np.diag(fit.covariance))
    absorbed = []
    for j, name in enumerate(names):
        shift = float(without[j] - fit.step[j])
        if determined[j] and sigma[j] > 0 and abs(shift) > sigma[j]:
            absorbed.append(Absorbed(name, shift, parameter_unit(name), abs(shift) / sigma[j]))
    absorbed.sort(key=lambda item: -item.standard_errors)
    proof = held_out(
        rows,
        mean,
        own.columns,
        rows.residual,
        levels=outcome.levels,
        contrast=outcome.contrast,
        channels=own.candidate.channels,
        after=after() if rows is outcome.rows else None,
    )
    return tuple(absorbed[:8]), proof, left


def only_levels(outcome: Outcome, which: int, proof: HeldOut) -> bool:
    """Whether a finding's worth is gone beside free levels of the few poses there are."""
    own = outcome.accepted[which]
    levels = pose_levels(outcome.rows, own.candidate.channels)
    if not levels.shape[1]:
        return False
    others = fitted(outcome.rows, _others(outcome, which))
    beside = held_out(
        outcome.rows,
        np.hstack((others, levels)),
        own.columns,
        outcome.rows.residual,
        levels=outcome.levels,
        contrast=outcome.contrast,
        channels=own.candidate.channels,
    )
    return beside.gain < FEW_POSES <= proof.gain


def judging(outcome: Outcome, which: int) -> Rows:
    """Return the rows that judge one finding."""
    own = outcome.accepted[which].candidate
    return outcome.rows.judging(own.name) if own.physical else outcome.rows


def _others(outcome: Outcome, which: int) -> list[Accepted]:
    return [a for i, a in enumerate(outcome.accepted) if i != which]


def fit_without(outcome: Outcome, which: int) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return what is left without one finding, the coefficients, and which are determined."""
    rows = judging(outcome, which)
    others = tuple(_others(outcome, which))
    without, _, determined = solved(rows, others, outcome.levels, outcome.contrast)
    return rows.residual - fitted(rows, others) @ without, without, determined


def changes(outcome: Outcome) -> tuple[tuple[Change, ...], tuple[float, float]]:
    """Return residual RMS and log-likelihood before and after, on the rows that were fitted.

    Residuals are those that parameters alone leave, as held-out blocks have it: where drift is part
    of the noise a fit leaves it to that, and what is left of rows is mostly drift.

    Baseline and nuisances are held by what is known of them: beside an arm the errors of another
    IMU are among these, and would take it up if they could be of any size. So would a scale factor
    of what the arm makes the sensor feel: before it is found nothing of that is felt.
    """
    rows, levels, contrast = outcome.rows, outcome.levels, outcome.contrast
    whitener = make_whitener(rows, levels, contrast, rows.baseline[:, :0])
    before = (judging(outcome, i) for i in range(len(outcome.accepted)))
    plain = next((judged for judged in before if judged is not rows), rows)
    left, likelihood = list[FloatArray](), list[float]()
    still = with_drift_as_jitter(rows, levels)
    for fit, accepted in ((plain, ()), (rows, outcome.accepted)):
        mean = fitted(fit, accepted)
        step, *_ = solved(fit, accepted, levels, contrast)
        white = whitener.whiten(rows.residual - mean @ step)
        likelihood.append(-0.5 * float(np.square(white).sum()))
        step, covariance, _ = solved(fit, accepted, still, contrast)
        left.append(rows.residual - mean @ step)
    # What was fitted takes its part of the noise.
    taken = np.einsum("mp,mp->m", mean @ covariance, mean)
    floor = np.maximum(np.append(rows.variance(still), contrast) - taken, 0.0)
    floor = at_most_left(rows, np.square(left[1]), floor)
    found = []
    for label, unit, own in _row_kinds(rows):
        squares = (np.square(left[0]), np.square(left[1]), floor)
        found.append(Change(label, unit, *(float(np.sqrt(x[own].mean())) for x in squares)))
    return tuple(found), (likelihood[0], likelihood[1])


def _row_kinds(rows: Rows) -> list[tuple[str, str, BoolArray]]:
    """Return what residuals are told apart by: label, unit and rows, (m,) bool.

    At rest it is means: changes within rests are many, and what shows from pose to pose would be
    lost among them.
    """
    resting = bool(rows.is_rest.any())
    where, last = ("at rest", Kind.MEAN) if resting else ("over windows", Kind.CONTRAST)
    out = []
    for label, unit, own in (
        (f"accel {where}", "m/s²", (rows.kind <= last) & (rows.channel // 3 == 0)),
        (f"gyro {where}", "rad/s", (rows.kind <= last) & (rows.channel // 3 == 1)),
        ("attitude after turns", "rad", rows.kind == Kind.ATTITUDE),
        ("velocity after turns", "m/s", rows.kind == Kind.VELOCITY),
    ):
        if own.any():
            out.append((label, unit, own))
    return out
