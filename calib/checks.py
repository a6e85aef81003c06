"""What a corrected recording must satisfy if the calibration is right, each judged by a chi-square.

See `calib.verify` for what stands in them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from calib.allowance import beyond, thermal, wander
from calib.apply import correct_recording
from calib.calibration import Calibration
from calib.closure import TurnSteps, closure_residual, horizontal_basis, propagate
from calib.directions import pose_directions
from calib.effects import get_effect
from calib.model import Triad
from calib.poses import Poses, average_poses
from calib.recording import AXES, Recording
from calib.solvers.quadric import COLUMNS, NAMES, ROWS
from calib.turns import Turns
from calib.types import FloatArray

UNCALIBRATED = {
    "accel.bias": 0.5,
    "accel.scale_factor_error": 0.03,
    "accel.misalignment": 0.02,
    "gyro.bias": np.radians(20.0),
    "gyro.scale_factor_error": 0.03,
    "gyro.misalignment": 0.02,
}
"""Standard deviation of a parameter that nothing is known of: what a consumer part promises
(MPU-6050 product specification rev. 3.4, sections 6.1 and 6.2: 50 mg, 3 %, 2 %, 20 °/s)."""

CERTAIN = 0.1
"""rad; turns whose angle the calibration predicts less certainly than this say nothing."""


@dataclass(frozen=True)
class Check:
    """One kind of equation: residuals, what is expected of them, and how likely they are.

    ``rms`` and ``expected`` are in ``unit``; ``worst`` is the interval (s) of the largest residual.
    """

    name: str
    what: str
    count: int
    rms: float
    expected: float
    unit: str
    chi_square: float
    degrees_of_freedom: int
    worst: tuple[float, float]

    @property
    def p_value(self) -> float:
        """How often an unchanged device would leave as much."""
        return float(chdtrc(self.degrees_of_freedom, self.chi_square))


@dataclass(frozen=True)
class NotTested:
    """A kind of equation that could not be judged, and why: nothing is known of it."""

    name: str
    reason: str


def gravity_check(calibration: Calibration, still: Poses) -> Check | NotTested:
    """Judge ``|a| = g`` over the poses."""
    if not len(still):
        return NotTested("gravity", "no static pose agrees with the others")
    outside = beyond(calibration, still)
    size = np.linalg.norm(still.accel, axis=1)
    residual = size - calibration.gravity.value
    up = still.accel / size[:, None]
    noise = np.einsum("ki,kij,kj->k", up, still.accel_covariance, up)
    left = 0.0
    if calibration.accel is not None and calibration.accel.degrees_of_freedom > 0:
        used = int(calibration.accel.used.sum())
        left = calibration.accel.residual_rms**2 * used / calibration.accel.degrees_of_freedom
    inverse = np.asarray(np.linalg.inv(calibration.model.accel.matrix))
    # d|f| = -u.T K (db + dT f) for f = K (a - b), u its direction.
    normal = up @ inverse
    design = -np.hstack([normal, normal[:, ROWS] * still.accel[:, COLUMNS]])
    total = np.diag(noise + left) + _spread(calibration, NAMES, design, outside)
    return _check(
        "gravity", "|a| - g in each pose", residual[:, None], total, "m/s²", still.interval
    )


def rest_check(calibration: Calibration, still: Poses) -> Check | NotTested:
    """Judge that the mean rate at rest is zero."""
    if not len(still):
        return NotTested("rest", "no static pose agrees with the others")
    outside = beyond(calibration, still)
    names = tuple(f"gyro.bias.{axis}" for axis in AXES)
    design = np.tile(np.linalg.inv(calibration.model.gyro.matrix), (len(still), 1))
    total = _spread(calibration, names, design, np.repeat(outside, 3))
    each = np.diag([wander(calibration)[name] ** 2 for name in names])
    for i, noise in enumerate(still.gyro_covariance):
        part = slice(3 * i, 3 * i + 3)
        total[part, part] += noise + each
    return _check("rest", "rate in each pose", still.gyro, total, "rad/s", still.interval)


def turn_check(
    calibration: Calibration,
    recording: Recording,
    corrected: Recording,
    still: Poses,
    turns: Turns,
    *,
    left: float,
) -> Check | NotTested:
    """Judge that turns carry gravity from pose to pose, with today's bias taken off."""
    if not len(turns):
        return NotTested("turns", "the recording has no turn between two rests that can be used")
    steps = TurnSteps.of(corrected, turns)
    directions = pose_directions(still, Triad())
    basis = horizontal_basis(directions.up[turns.before])
    bias = 0.5 * (still.gyro[turns.before] + still.gyro[turns.after])
    as_told = propagate(steps, np.eye(3), bias).mat

    def closure(mat: FloatArray, up: FloatArray) -> FloatArray:
        predicted = np.einsum("mij,mj->mi", mat, up[turns.after])
        error = closure_residual(up[turns.before], predicted)
        return np.asarray(np.einsum("mea,ma->me", basis, error).ravel())

    residual = closure(as_told, directions.up)
    turned = tuple(n for n in Triad().parameters("gyro") if ".bias." not in n)
    further = tuple(_term_sizes(calibration))
    step = 1e-5
    design = np.empty((len(residual), len(NAMES) + len(turned) + len(further)))
    for k, name in enumerate((*NAMES, *turned)):
        moved = Triad().with_parameters({name: step})
        if name in turned:
            changed = closure(propagate(steps, moved.matrix, bias).mat, directions.up)
        else:
            changed = closure(as_told, pose_directions(still, moved).up)
        design[:, k] = (changed - residual) / step
    for k, (name, size) in enumerate(_term_sizes(calibration).items(), len(NAMES) + len(turned)):
        model = calibration.model.with_terms_moved({name: size})
        other = correct_recording(replace(calibration, model=model, housing=None), recording)
        rests = average_poses(other, still.start, still.stop)
        rate = 0.5 * (rests.gyro[turns.before] + rests.gyro[turns.after])
        mat = propagate(TurnSteps.of(other, turns), np.eye(3), rate).mat
        design[:, k] = (closure(mat, pose_directions(rests, Triad()).up) - residual) / size
    covariance = _covariance(calibration, (*NAMES, *turned, *further))
    common = design @ covariance @ design.T
    noise = 0.5 * (still.gyro_covariance[turns.before] + still.gyro_covariance[turns.after])
    drift = np.trace(noise, axis1=1, axis2=2) / 3 * steps.duration**2
    pose = np.trace(directions.covariance, axis1=1, axis2=2) / 2
    own = drift + left + pose[turns.before] + pose[turns.after]
    total = common + np.diag(np.repeat(own, 2))
    certain = np.diag(total).reshape(-1, 2).max(axis=1) < CERTAIN**2
    if not certain.any():
        return NotTested(
            "turns",
            f"the calibration does not tell the angle of any turn to {np.degrees(CERTAIN):.0f}°",
        )
    rows = np.repeat(certain, 2)
    return _check(
        "turns",
        "gravity after each turn",
        residual[rows].reshape(-1, 2),
        total[np.ix_(rows, rows)],
        "rad",
        turns.interval[certain],
    )


def _check(
    name: str,
    what: str,
    residual: FloatArray,
    covariance: FloatArray,
    unit: str,
    interval: FloatArray,
) -> Check:
    flat = residual.ravel()
    square = float(flat @ np.linalg.solve(covariance, flat))
    worst = int(np.argmax(np.linalg.norm(residual, axis=1)))
    return Check(
        name,
        what,
        len(residual),
        float(np.sqrt(np.mean(flat**2))),
        float(np.sqrt(np.mean(np.diag(covariance)))),
        unit,
        square,
        len(flat),
        (float(interval[worst, 0]), float(interval[worst, 1])),
    )


def _spread(
    calibration: Calibration, names: tuple[str, ...], design: FloatArray, outside: FloatArray
) -> FloatArray:
    """Return the covariance of residuals ``design @ parameters`` of an unchanged device.

    ``outside`` (K, one for each row) moves the parameters by their coefficients of temperature.
    """
    moves, coefficients = wander(calibration), thermal(calibration)
    alike = _covariance(calibration, names)
    alike += np.diag([moves.get(name, 0.0) ** 2 for name in names])
    warmed = design * outside[:, None]
    apart = np.diag([coefficients.get(name, 0.0) ** 2 for name in names])
    return np.asarray(design @ alike @ design.T + warmed @ apart @ warmed.T, np.float64)


def _covariance(calibration: Calibration, names: tuple[str, ...]) -> FloatArray:
    """Return the covariance of some parameters.

    What is not determined is uncertain by what a consumer part promises.
    """
    open_ = set(calibration.undetermined)
    terms = _term_sizes(calibration)
    prior = [
        (terms.get(name) or UNCALIBRATED[name.rpartition(".")[0]]) if name in open_ else 0.0
        for name in names
    ]
    out: FloatArray = np.diag(np.square(prior))
    known = [k for k, name in enumerate(names) if name in calibration.names]
    index = [calibration.names.index(names[k]) for k in known]
    out[np.ix_(known, known)] += calibration.covariance[np.ix_(index, index)]
    return out


def _term_sizes(calibration: Calibration) -> dict[str, float]:
    """Return how uncertain each parameter of a further term is, by name, where it is at all.

    What is not determined is uncertain by what a consumer part has.
    """
    sizes = {name: sigma for name, sigma in calibration.sigmas.items() if sigma > 0}
    for term in calibration.model.terms:
        for item in get_effect(term.effect).parameters:
            if (name := f"{term.effect}.{item.name}") in calibration.undetermined:
                sizes[name] = item.typical
    slugs = {term.effect for term in calibration.model.terms}
    return {name: size for name, size in sizes.items() if name.partition(".")[0] in slugs}
