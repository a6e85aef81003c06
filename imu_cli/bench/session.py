"""A session: samples in, and out of it the state, the accuracy reached, and the next thing to do.

No terminal and no device here: the screen and the command bring them, a test needs neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.calibrate import calibrate
from calib.calibration import Calibration, Gravity
from calib.errors import CalibrationError, UnitError
from calib.live_statics import LiveStatics
from calib.planning import (
    NAMES,
    Accuracy,
    Choice,
    candidate_actions,
    next_action,
    pose_information,
    prior_information,
    six_face_information,
    standard_errors,
    turn_information,
)
from calib.poses import Poses
from calib.recording import Recording, join
from calib.rotation import integrate_rate, mat_from_quat
from calib.statics import find_poses
from calib.turns import Turns, find_turns
from calib.types import FloatArray
from calib.units import check_units
from imu_cli.bench.warnings import clipping_warning, turn_warnings, warm_up_warning

ANGLES = (np.pi / 2, np.pi)
TURN_TIME = 2.0
REST_TIME = 3.0
LONG_ENOUGH = 1.5
"""s; a rest counts as a pose from here on, and longer makes it better."""
NOMINAL = Accuracy(pose=5e-3, static=2e-4, turn=3e-3)
"""What one equation is worth before the recording itself tells: a pose repeats to half a mg."""
LIMIT_ROUNDS = 200


@dataclass(frozen=True, eq=False)
class Status:
    """All that a screen shows.

    ``errors`` are the present standard errors, None where not determined yet. ``turned`` (3, 2) is
    the angle turned about each axis, rad, forward and back. ``choice`` is the next action, None
    while there is none to give.
    """

    recording: Recording | None
    moving: bool
    poses: Poses | None
    turns: int
    turned: FloatArray
    errors: Mapping[str, float | None]
    targets: Mapping[str, float]
    choice: Choice | None
    warnings: tuple[str, ...]
    repeat: str
    done: bool
    calibration: Calibration | None = field(default=None)

    @property
    def ups(self) -> FloatArray:
        """Up direction of each pose, (k, 3), as measured."""
        if self.poses is None or not len(self.poses):
            return np.zeros((0, 3))
        ups: FloatArray = self.poses.accel / np.linalg.norm(self.poses.accel, axis=1, keepdims=True)
        return ups


class Session:
    """Collects samples and decides what is still missing."""

    def __init__(self, *, targets: Mapping[str, float], gravity: Gravity) -> None:
        self.targets = dict(targets)
        self.gravity = gravity
        self._live = LiveStatics()
        self._rested_since: float | None = None
        self._seen = False  # whether the present rest was taken in already
        self._parts: list[Recording] = []
        self._whole: Recording | None = None
        self._poses: Poses | None = None
        self._turns = 0
        self._turned = np.zeros((3, 2))
        self._choice: Choice | None = None
        self._calibration: Calibration | None = None
        self._refusal = ""
        self._clipping: str = ""
        self._warnings: list[str] = []
        self._excluded: set[tuple[float, float]] = set()
        self._repeat = ""

    def add(self, batch: Recording) -> None:
        """Take the next samples; time runs on."""
        self._parts.append(batch)
        self._clipping = clipping_warning(batch) or self._clipping
        for event in self._live.update(batch):
            self._rested_since = event.time if event.resting else None
            self._seen = False
        self._whole = None

    @property
    def recording(self) -> Recording | None:
        """Everything so far."""
        if self._whole is None and self._parts:
            self._whole = join(self._parts)
            self._parts = [self._whole]
        return self._whole

    def status(self) -> Status:
        """Return the state after the samples so far; works out anew only what changed."""
        recording = self.recording
        if recording is None:
            return self._status(None, moving=False)
        since = self._rested_since
        rested = since is not None and float(recording.time[-1]) - since >= LONG_ENOUGH
        if rested and not self._seen:
            self._seen = True
            self._poses = find_poses(recording)
            self._fit(recording, self._poses)
        return self._status(recording, moving=since is None)

    def fixed_routine_time(self) -> float | None:
        """Return how long the usual six faces would take to meet the targets, s; None if never.

        One round is six faces with 90° turns between them, repeated until every standard error is
        met, at the accuracy that this recording shows.
        """
        accuracy = self._accuracy()
        one = six_face_information(
            gravity=self.gravity.value, accuracy=accuracy, turn_time=TURN_TIME
        )
        prior = prior_information(self.targets)
        for rounds in range(1, LIMIT_ROUNDS + 1):
            errors = standard_errors(rounds * one + prior)
            if all(errors[name] <= self.targets[name] for name in NAMES):
                return rounds * 6 * (TURN_TIME + REST_TIME)
        return None

    def _fit(self, recording: Recording, poses: Poses) -> None:
        self._choice, self._calibration, self._refusal = None, None, ""
        self._clipping = ""
        if not len(poses):
            return
        turns = find_turns(recording, poses)
        self._turns = len(turns)
        self._turned = _turned(recording, poses, turns)
        try:
            check_units(recording, poses)
            self._calibration = calibrate(recording, gravity=self.gravity)
        except UnitError as error:
            self._refusal = str(error)
        except CalibrationError:
            pass  # too few poses yet: the plan below says what to do about it
        self._note_exclusions()
        self._warnings = turn_warnings(recording, poses, turns)
        self._warnings += filter(None, [warm_up_warning(poses)])
        information = self._information(recording, poses, turns)
        up = poses.accel[-1] / np.linalg.norm(poses.accel[-1])
        self._choice = next_action(
            information,
            up,
            targets=self.targets,
            actions=candidate_actions(up, angles=ANGLES),
            turn_time=TURN_TIME,
            gravity=self.gravity.value,
            accuracy=self._accuracy(),
        )

    def _note_exclusions(self) -> None:
        """Ask again for a pose that the fit left out, once for each."""
        self._repeat = ""
        if self._calibration is None:
            return
        for summary in (self._calibration.accel, self._calibration.gyro):
            for item in summary.excluded if summary is not None else ():
                if item.interval not in self._excluded:
                    self._excluded.add(item.interval)
                    self._repeat = (
                        f"The rest at {item.interval[0]:.0f} s does not count ({item.reason}): "
                        "let go of it, and do not touch the table."
                    )

    def _accuracy(self) -> Accuracy:
        """Return what one equation is worth, as this recording's own residuals show it."""
        calibration = self._calibration
        if calibration is None:
            return NOMINAL
        accuracy = NOMINAL
        if calibration.accel is not None and calibration.accel.degrees_of_freedom > 2:
            accuracy = replace(accuracy, pose=max(calibration.accel.residual_rms, 1e-3))
        if calibration.gyro is not None and calibration.gyro.degrees_of_freedom > 4:
            accuracy = replace(accuracy, turn=max(calibration.gyro.residual_rms, 2e-4))
        return accuracy

    def _information(self, recording: Recording, poses: Poses, turns: Turns) -> FloatArray:
        """Return the information that the poses and turns so far hold."""
        accuracy = self._accuracy()
        total = np.zeros((len(NAMES), len(NAMES)))
        ups = poses.accel / np.linalg.norm(poses.accel, axis=1, keepdims=True)
        for up in ups:
            total += pose_information(up, gravity=self.gravity.value, accuracy=accuracy)
        bias = poses.gyro.mean(axis=0)
        for k in range(len(turns)):
            part = slice(int(turns.start[k]), int(turns.stop[k]))
            time, rate = recording.time[part], recording.gyro[part] - bias
            total += turn_information(
                ups[turns.before[k]],
                time,
                mat_from_quat(integrate_rate(time, rate)),
                rate,
                accuracy=accuracy,
            )
        return total

    def _errors(self) -> dict[str, float | None]:
        if self._calibration is None:
            return dict.fromkeys(NAMES)
        sigmas = self._calibration.sigmas
        return {name: sigmas.get(name) for name in NAMES}

    def _status(self, recording: Recording | None, *, moving: bool) -> Status:
        errors = self._errors()
        done = all(
            error is not None and error <= self.targets[name] for name, error in errors.items()
        )
        warnings = [self._refusal] if self._refusal else []
        warnings += [text for text in (self._clipping, *self._warnings) if text]
        return Status(
            recording,
            moving,
            self._poses,
            self._turns,
            self._turned,
            errors,
            self.targets,
            None if done else self._choice,
            tuple(warnings),
            self._repeat,
            done and not self._refusal,
            self._calibration,
        )


def _turned(recording: Recording, poses: Poses, turns: Turns) -> FloatArray:
    """Return the angle turned about each axis over all turns, (3, 2) rad, forward and back."""
    bias = poses.gyro.mean(axis=0)
    out = np.zeros((3, 2))
    for start, stop in zip(turns.start, turns.stop, strict=True):
        angle = np.trapezoid(recording.gyro[start:stop] - bias, recording.time[start:stop], axis=0)
        out += np.column_stack([np.maximum(angle, 0), np.maximum(-angle, 0)])
    return out
