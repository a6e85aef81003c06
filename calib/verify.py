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

from calib.allowance import beyond
from calib.apply import correct_recording
from calib.calibrate import calibrate, usable_turns
from calib.calibration import Calibration
from calib.checks import Check, NotTested, gravity_check, rest_check, turn_check
from calib.compare import SIGNIFICANCE, Comparison, aligned, compare, device_mismatch
from calib.errors import InsufficientMotionError, NotConvergedError
from calib.fit import Exclusion
from calib.measured import measured
from calib.model import SensorModel, Triad
from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.statics import find_poses
from calib.turns import Turns, find_turns
from calib.types import FloatArray, IntArray
from calib.units import check_units


@dataclass(frozen=True, eq=False)
class Verification:
    """What a new recording says of a calibration.

    ``comparison`` has the parameters that the new recording determines by itself, against the
    calibration's; None if it determines none. ``remarks`` qualify the answer, and ``not_tested`` is
    what it does not speak of.
    """

    checks: tuple[Check, ...]
    comparison: Comparison | None
    identity: str
    remarks: tuple[str, ...]
    significance: float
    not_tested: tuple[NotTested, ...] = ()

    @property
    def failed(self) -> tuple[Check, ...]:
        """Checks that an unchanged device would hardly fail, corrected for their number."""
        limit = self.significance / len(self.checks)
        return tuple(check for check in self.checks if check.p_value < limit)

    @property
    def right(self) -> bool:
        """True if no check failed; of what is in ``not_tested`` that says nothing."""
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
        If the recording has no static pose, or none that agrees with the others.
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
    answers = (
        gravity_check(calibration, still.select(good)),
        rest_check(calibration, still.select(steady)),
        turn_check(
            calibration,
            recording,
            corrected,
            still,
            usable,
            left=_left_over(calibration, recording, anew),
        ),
    )
    checks = tuple(item for item in answers if isinstance(item, Check))
    if not checks:
        raise InsufficientMotionError(
            f"none of {len(still)} static poses can be used; lay the sensor down for 3 s or more, "
            "best in several poses"
        )
    return Verification(
        checks,
        _compare_anew(calibration, anew),
        device_mismatch(calibration.provenance.device, recording.device),
        (
            *_remarks(calibration, recording, beyond(calibration, still)),
            *_left_out(anew, left_out),
        ),
        significance,
        tuple(item for item in answers if isinstance(item, NotTested)),
    )


def _fit_anew(
    calibration: Calibration, recording: Recording, still: Poses | None
) -> Calibration | None:
    """Calibrate a recording by itself; None if it is too little, or too odd, for that.

    The checks say what is odd.
    """
    try:
        return calibrate(recording, gravity=calibration.gravity, poses=still)
    except (InsufficientMotionError, NotConvergedError):
        return None


def _left_over(calibration: Calibration, recording: Recording, anew: Calibration | None) -> float:
    """Return the variance that turns have beside noise, rad²: what the fit of them left over.

    A model that `diagnose` wrote, or a hand, does not say. Then it is what a fit to the new
    recording leaves, with the model's terms or without them, whichever is less: terms that are
    wrong would else excuse themselves.
    """
    if calibration.gyro is not None:
        return calibration.gyro.residual_rms**2
    fits = [anew]
    if calibration.model.terms:
        fits.append(_fit_anew(calibration, recording, None))
    found = []
    for fit in fits:
        if fit is not None and fit.gyro is not None and fit.gyro.degrees_of_freedom > 0:
            used = fit.gyro.residuals[fit.gyro.used]
            found.append(float(np.sum(used**2)) / fit.gyro.degrees_of_freedom)
    return min(found, default=0.0)


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


def _compare_anew(calibration: Calibration, left: Calibration | None) -> Comparison | None:
    """Compare with what the corrected recording says by itself: no bias, scale or angle left."""
    if left is None:
        return None
    calibration = aligned(calibration)
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
