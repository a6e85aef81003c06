"""What every solver by attitude closure does around the fit: set up, judge, report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.closure import Kinematics, TurnSteps, by_quaternions
from calib.directions import Sway, closure_errors, find_sway, follow, pose_directions
from calib.fit import Exclusion, Fit
from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.solvers._closure_fit import ClosureFit, fit_closures
from calib.solvers._closure_noise import Information, Judgement
from calib.solvers._closure_system import ClosureSystem, direction_sensitivity, unpack
from calib.solvers._gyro_determined import (
    GYRO_NAMES,
    GYRO_UNITS,
    TOLERANCE,
    determined,
    gyro_advice,
    visible_turning,
)
from calib.solvers._static_bias import StaticBias, noise_growth, static_bias
from calib.turns import Turns
from calib.types import BoolArray, FloatArray

REASONS = {
    "turn": "the turn does not close with the others: clipped, shaken, or moved at its ends",
    "pose": "gravity's direction here disagrees with the turns before and after: bumped",
}

AMBIGUOUS = "the turn is so long that its angle is uncertain by more than gravity can tell apart"

SWAY = 1e-3
"""A hand sways by more than this, rad."""
WORTH = 0.5
"""Turns are tried from the middles of all poses if what that changes in their closure is at least
this part of their scatter, and the noise that it adds is less (squares),"""
BETTER = 0.5
"""and run that way if it divides their squared scatter by two."""


def solve_closures(
    recording: Recording,
    poses: Poses,
    turns: Turns,
    accel: Triad,
    *,
    method: str,
    model: BoolArray,
    static_bias_only: bool,
    kinematics: Kinematics = by_quaternions,
) -> Fit:
    """Solve the parameters of a model (a mask (12,)) from closures and the bias at rest.

    Turns run from the end of a pose to the beginning of the next. Where both sensors see a pose
    sway they begin at its middle (`calib.directions`); and at that of all poses where that closes
    clearly better, as it does when a hand trembles faster than the accelerometer can tell.

    With `static_bias_only` the bias is that of the poses, and its error is part of the closures'
    covariance; without, both kinds of equations are solved together.

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
    if not len(turns):
        empty = np.zeros(0)
        fit = ClosureFit(
            static.mean,
            precision,
            np.zeros((12, 3)),
            np.zeros((12, len(poses), 2)),
            Judgement(np.zeros(2)),
            empty > 0,
            empty,
        )
        turned, moved = (np.zeros(3), np.zeros(3)), np.zeros((12, 12))
    else:
        system = ClosureSystem(
            TurnSteps.of(recording, turns),
            turns,
            pose_directions(poses, accel),
            noise_growth(recording, poses),
            0.5 * (bias.deviation[turns.before] + bias.deviation[turns.after]),
            model & ~(static_bias_only & (np.arange(12) < 3)),
            bias.covariance if static_bias_only else np.zeros((3, 3)),
            kinematics,
        )
        fit = fit_closures(system, static)
        system, fit = _follow_hand(system, fit, static, recording, poses, accel)
        gravity = float(np.linalg.norm(accel.correct(poses.accel), axis=1).mean())
        moved = np.tensordot(
            fit.direction_gain, direction_sensitivity(system.directions, accel, gravity), 2
        )
        turned = visible_turning(system.steps, system.directions, turns, unpack(fit.values))
    return _report(poses, turns, bias, fit, model, moved, turned, method=method)


def _follow_hand(
    system: ClosureSystem,
    fit: ClosureFit,
    static: Information,
    recording: Recording,
    poses: Poses,
    accel: Triad,
) -> tuple[ClosureSystem, ClosureFit]:
    """Return the system that follows the sway within poses, and its fit; as it was if none does."""
    turns, gyro = system.turns, unpack(fit.values)

    def closures(sway: Sway, gyro: Triad) -> FloatArray:
        return closure_errors(recording, poses, turns, accel, gyro, gain=sway.gain)

    def run(sway: Sway, gyro: Triad) -> tuple[ClosureSystem, ClosureFit]:
        steps, directions = follow(recording, poses, turns, accel, gyro, sway.gain)
        still = sway.gain == 0
        new = replace(
            system,
            steps=steps,
            directions=directions,
            # At rest in a hand the rate is the hand's too, neither noise nor drift.
            noise=np.minimum(system.noise, sway.noise * np.eye(3)),
            deviation=system.deviation * (still[turns.before] & still[turns.after])[:, None],
        )
        return new, fit_closures(new, static)

    found = []
    sway, everywhere = find_sway(recording, poses, accel, gyro), Sway(np.ones(len(poses)))
    if sway.gain.any():
        found.append((sway, *run(sway, gyro)))
    plain, held = closures(Sway(np.zeros(len(poses))), gyro), closures(everywhere, gyro)
    rest = float(np.median(poses.interval[:, 1] - poses.interval[:, 0]))
    # Two components at two poses, each moved by the noise of a walk that is known at its middle.
    cost, scatter = 4 * sway.noise * rest / 3, _scatter(plain)
    change = _scatter(held - plain)
    if change >= max(SWAY**2, WORTH * scatter) and cost < WORTH * scatter:
        tried = run(everywhere, gyro)
        tried = run(everywhere, unpack(tried[1].values))  # now with the first's calibration
        if _scatter(closures(everywhere, unpack(tried[1].values))) < BETTER * scatter:
            found.append((everywhere, *tried))
    if not found:
        return system, fit
    best = min(found, key=lambda each: _scatter(closures(each[0], unpack(each[2].values))))
    return best[1:]


def _scatter(errors: FloatArray) -> float:
    """Return the median square of (m, 3) closure errors, rad²."""
    return float(np.median((errors**2).sum(axis=1)))


def _report(
    poses: Poses,
    turns: Turns,
    bias: StaticBias,
    fit: ClosureFit,
    model: BoolArray,
    moved: FloatArray,
    turned: tuple[FloatArray, FloatArray],
    *,
    method: str,
) -> Fit:
    judged = determined(fit.information[np.ix_(model, model)], TOLERANCE[model])
    free = judged.free
    names = tuple(np.array(GYRO_NAMES)[model].tolist())
    information = fit.information[np.ix_(model, model)][np.ix_(free, free)]
    inverse = np.asarray(np.linalg.inv(information), np.float64)
    covariance = np.full((len(names), len(names)), np.nan)
    covariance[np.ix_(free, free)] = inverse + _drag(fit, model, free, inverse, bias)
    of_bias = np.flatnonzero(np.arange(12)[model] < 3)
    covariance[of_bias, of_bias] += bias.wander**2
    sensitivity = np.zeros((len(names), 12))
    sensitivity[free] = -inverse @ moved[model][free]
    covariance[~judged.known] = covariance[:, ~judged.known] = np.nan
    undetermined = tuple(n for n, ok in zip(names, judged.known, strict=True) if not ok)
    left_out = fit.judgement.left_out
    used = turns.select(fit.used)
    kept = np.array([("turn", i) not in left_out for i in range(len(used))], bool)
    residuals = fit.residuals.reshape(-1, 2)[kept]
    return Fit(
        method=method,
        triad=unpack(fit.values),
        names=names,
        values=fit.values[model],
        units=tuple(np.array(GYRO_UNITS)[model].tolist()),
        covariance=covariance,
        residuals=residuals,
        residual_unit="rad",
        intervals=used.interval[kept],
        degrees_of_freedom=2 * (len(used) - len(left_out)) + 3 * len(poses) - int(free.sum()),
        condition_number=judged.condition_number,
        undetermined=undetermined,
        advice=gyro_advice(undetermined, *turned),
        excluded=(
            *bias.excluded,
            *(_exclusion(interval, AMBIGUOUS) for interval in turns.interval[~fit.used]),
            *(
                _exclusion((used if kind == "turn" else poses).interval[i], REASONS[kind])
                for kind, i in left_out
            ),
        ),
        accel_sensitivity=sensitivity,
    )


def _drag(
    fit: ClosureFit, model: BoolArray, free: BoolArray, inverse: FloatArray, bias: StaticBias
) -> FloatArray:
    """Return the covariance between a bias that closures do not estimate and what they do.

    An error d of that bias moves the others by ``-inverse gain d``; their own variance has it.
    """
    drag = np.zeros((12, 3))
    drag[np.flatnonzero(model)[free]] = -inverse @ fit.bias_gain[model][free]
    cross = np.zeros((12, 12))
    cross[:, :3] = drag @ bias.covariance
    cross[:3] = 0.0
    cross += cross.T
    return cross[np.ix_(model, model)][np.ix_(free, free)]


def _exclusion(interval: FloatArray, reason: str) -> Exclusion:
    return Exclusion((float(interval[0]), float(interval[1])), 0.0, reason)
