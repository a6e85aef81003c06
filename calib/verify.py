"""Is a calibration still right for this device, judged by a new recording, in standard errors.

The new recording is corrected with the calibration. A right calibration then leaves

- in every static pose, ``|a| = g``;
- in every static pose, a mean rate of zero;
- over every turn, gravity's direction where the gyroscope says it went.

Each is judged by a chi-square in which stand the noise of the new recording, the covariance of the
calibration, what its own fit left over (its residuals: physics that the model lacks is no change),
and what a sensor may do by itself (`calib.allowance`).
What has changed is then named by fitting the corrected recording anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from calib.allowance import beyond, thermal, wander
from calib.apply import correct_recording
from calib.calibrate import calibrate, usable_turns
from calib.calibration import Calibration
from calib.closure import TurnSteps, closure_residual, horizontal_basis, propagate
from calib.compare import SIGNIFICANCE, Comparison, compare, device_mismatch
from calib.directions import pose_directions
from calib.errors import InsufficientMotionError, NotConvergedError
from calib.fit import Exclusion
from calib.measured import measured
from calib.model import SensorModel, Triad
from calib.poses import Poses, average_poses
from calib.recording import AXES, Recording
from calib.solvers.quadric import COLUMNS, NAMES, ROWS
from calib.statics import find_poses
from calib.turns import Turns, find_turns
from calib.types import FloatArray, IntArray
from calib.units import check_units

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


@dataclass(frozen=True, eq=False)
class Verification:
    """What a new recording says of a calibration.

    ``comparison`` has the parameters that the new recording determines by itself, against the
    calibration's; None if it determines none. ``remarks`` qualify the answer.
    """

    checks: tuple[Check, ...]
    comparison: Comparison | None
    identity: str
    remarks: tuple[str, ...]
    significance: float

    @property
    def failed(self) -> tuple[Check, ...]:
        """Checks that an unchanged device would hardly fail, corrected for their number."""
        limit = self.significance / len(self.checks)
        return tuple(check for check in self.checks if check.p_value < limit)

    @property
    def right(self) -> bool:
        """True if no check failed."""
        return not self.failed


def verify(
    calibration: Calibration, recording: Recording, *, significance: float = SIGNIFICANCE
) -> Verification:
    """Judge a calibration by a new recording of its device: one static pose is enough to begin.

    Parameters
    ----------
    calibration : Calibration
    recording : Recording
    significance : float
        Chance of calling the calibration of an unchanged device wrong.

    Raises
    ------
    UnitError
        If the recording's values do not have the unit that was declared.
    InsufficientMotionError
        If the recording has no static pose.
    """
    if not 0 < significance < 1:
        raise ValueError(f"`significance` must be between 0 and 1, got {significance}")
    recording = measured(recording).recording
    poses = find_poses(recording)
    check_units(recording, poses)
    if not len(poses):
        raise InsufficientMotionError(
            f"no static pose in {recording.duration:.4g} s; lay the sensor down for 3 s or more, "
            "best in several poses"
        )
    corrected = correct_recording(replace(calibration, housing=None), recording)
    still = average_poses(corrected, poses.start, poses.stop)
    anew = _fit_anew(calibration, corrected, still)
    good, steady = _at_rest(anew, still)
    usable, left_out = usable_turns(recording, find_turns(recording, poses))
    usable = usable.select(_sound(anew, usable, steady))
    checks = [
        _gravity_check(calibration, still.select(good)),
        _rest_check(calibration, still.select(steady)),
        _turn_check(calibration, corrected, still, usable),
    ]
    return Verification(
        tuple(check for check in checks if check is not None),
        _compare_anew(calibration, anew),
        device_mismatch(calibration.provenance.device, recording.device),
        (
            *_remarks(calibration, recording, beyond(calibration, still)),
            *_left_out(anew, left_out),
        ),
        significance,
    )


def _fit_anew(calibration: Calibration, corrected: Recording, still: Poses) -> Calibration | None:
    """Calibrate the corrected recording by itself; None if it is too little, or too odd, for that.

    The checks say what is odd.
    """
    try:
        return calibrate(corrected, gravity=calibration.gravity, poses=still)
    except (InsufficientMotionError, NotConvergedError):
        return None


def _at_rest(anew: Calibration | None, still: Poses) -> tuple[IntArray, IntArray]:
    """Return the poses that are sound for the accelerometer, and for the gyroscope.

    What is left out disagrees with the rest of the new recording, not with the calibration.
    """
    keep = []
    for summary in (None, None) if anew is None else (anew.accel, anew.gyro):
        bad = () if summary is None else tuple(e.interval for e in summary.excluded if not e.weight)
        out = [any(np.allclose(row, interval) for interval in bad) for row in still.interval]
        keep.append(np.flatnonzero(~np.array(out)))
    return keep[0], keep[1]


def _sound(anew: Calibration | None, turns: Turns, steady: IntArray) -> IntArray:
    """Return the turns whose ends were at rest, and that agree with each other."""
    ends = np.isin(turns.before, steady) & np.isin(turns.after, steady)
    if anew is not None and anew.gyro is not None:
        for item in anew.gyro.excluded:
            ends &= ~np.all(np.isclose(turns.interval, item.interval), axis=1)
    return np.flatnonzero(ends)


def _left_out(anew: Calibration | None, turns: tuple[Exclusion, ...]) -> tuple[str, ...]:
    items = list(turns)
    for summary in (None, None) if anew is None else (anew.accel, anew.gyro):
        items += [] if summary is None else [item for item in summary.excluded if not item.weight]
    texts: dict[str, str] = {}
    for item in items:
        where = f"{item.interval[0]:.2f} to {item.interval[1]:.2f} s is left out"
        texts.setdefault(where, item.reason)
    return tuple(f"{where}: {reason}" for where, reason in texts.items())


def _remarks(
    calibration: Calibration, recording: Recording, outside: FloatArray
) -> tuple[str, ...]:
    remarks = []
    if calibration.temperature is None or recording.temperature is None:
        remarks.append("temperature is not known in both, so a bias that followed it is a change")
    elif outside.any():
        most = float(outside[np.argmax(np.abs(outside))])
        where = "above" if most > 0 else "below"
        span = calibration.temperature
        remarks.append(
            f"the poses are up to {abs(most):.1f} K {where} the calibrated {span.low:.1f} to "
            f"{span.high:.1f} °C; typical coefficients of temperature are allowed for that"
        )
    if calibration.undetermined:
        remarks.append(
            f"the calibration leaves {len(calibration.undetermined)} parameters undetermined"
        )
    return tuple(remarks)


def _gravity_check(calibration: Calibration, still: Poses) -> Check | None:
    """Judge ``|a| = g`` over the poses."""
    if not len(still):
        return None
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


def _rest_check(calibration: Calibration, still: Poses) -> Check | None:
    """Judge that the mean rate at rest is zero."""
    if not len(still):
        return None
    outside = beyond(calibration, still)
    names = tuple(f"gyro.bias.{axis}" for axis in AXES)
    design = np.tile(np.linalg.inv(calibration.model.gyro.matrix), (len(still), 1))
    total = _spread(calibration, names, design, np.repeat(outside, 3))
    each = np.diag([wander(calibration)[name] ** 2 for name in names])
    for i, noise in enumerate(still.gyro_covariance):
        part = slice(3 * i, 3 * i + 3)
        total[part, part] += noise + each
    return _check("rest", "rate in each pose", still.gyro, total, "rad/s", still.interval)


def _turn_check(
    calibration: Calibration, corrected: Recording, still: Poses, turns: Turns
) -> Check | None:
    """Judge that turns carry gravity from pose to pose, with today's bias taken off."""
    if not len(turns) or calibration.gyro is None:
        return None
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
    step = 1e-5
    design = np.empty((len(residual), len(NAMES) + len(turned)))
    for k, name in enumerate((*NAMES, *turned)):
        moved = Triad().with_parameters({name: step})
        if name in turned:
            changed = closure(propagate(steps, moved.matrix, bias).mat, directions.up)
        else:
            changed = closure(as_told, pose_directions(still, moved).up)
        design[:, k] = (changed - residual) / step
    covariance = _covariance(calibration, (*NAMES, *turned))
    common = design @ covariance @ design.T
    left = calibration.gyro.residual_rms**2
    rate = 0.5 * (still.gyro_covariance[turns.before] + still.gyro_covariance[turns.after])
    drift = np.trace(rate, axis1=1, axis2=2) / 3 * steps.duration**2
    pose = np.trace(directions.covariance, axis1=1, axis2=2) / 2
    own = drift + left + pose[turns.before] + pose[turns.after]
    total = common + np.diag(np.repeat(own, 2))
    certain = np.diag(total).reshape(-1, 2).max(axis=1) < CERTAIN**2
    if not certain.any():
        return None
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
    prior = [UNCALIBRATED[name.rpartition(".")[0]] if name in open_ else 0.0 for name in names]
    out: FloatArray = np.diag(np.square(prior))
    known = [k for k, name in enumerate(names) if name in calibration.names]
    index = [calibration.names.index(names[k]) for k in known]
    out[np.ix_(known, known)] += calibration.covariance[np.ix_(index, index)]
    return out


def _compare_anew(calibration: Calibration, left: Calibration | None) -> Comparison | None:
    """Compare with what the corrected recording says by itself: no bias, scale or angle left."""
    if left is None:
        return None
    model = SensorModel(
        _compose(calibration.model.accel, left.model.accel),
        _compose(calibration.model.gyro, left.model.gyro),
    )
    baseline = [name for name in calibration.names if name in left.values]
    index = [calibration.names.index(name) for name in baseline]
    known = replace(
        calibration,
        model=replace(calibration.model, terms=()),
        names=tuple(baseline),
        covariance=calibration.covariance[np.ix_(index, index)],
        undetermined=tuple(n for n in calibration.undetermined if n in left.values),
    )
    return compare(known, replace(left, model=model))


def _compose(known: Triad, left: Triad) -> Triad:
    """Return the triad of ``known`` after ``left``: what the sensor does today."""
    return Triad.from_matrix(known.matrix @ left.matrix, known.bias + known.matrix @ left.bias)
