"""What the default methods reach on public logs, on poses and turns that they did not see.

Accelerometer: each pose is left out in turn, the others are solved, and the error is the length of
its corrected mean less gravity. Gyroscope: every other turn is left out, the others are solved, and
the error of a turn is the angle between gravity as the accelerometer sees it before the turn, and
as predicted from after it by the corrected rate; then the other half. Each pose and each turn is
predicted exactly once and takes no part in its own prediction; the accelerometer's calibration and
the poses are all that the two halves of the turns share. What gravity did is taken at the ends of a
turn: where a pose was held in a hand that swayed, by following it (`calib.directions`).

The MIMU4444 runs end in a minute and a half of violent shaking, and a second or two at rest in the
hand after it: only the static part before it is used. These sensors sample at 62.5 Hz with no
filter to match, and the board was tumbled from face to face: what a knock does between two samples
is lost, and limits their gyroscope figures: a calibration from another run does no better, and a
spline through the rate instead of trapezia changes them by 0.001°.

Exit status 1 if a figure of the small independent scripts that came before (see GOALS) is not met.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.crossvalidation import leave_one_out
from calib.directions import closure_errors
from calib.errors import ImuError
from calib.model import Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.solvers import accel_solvers, gyro_solvers
from calib.statics import find_poses
from calib.turns import Turns, find_turns
from drivers.formats import read_recording

GRAVITY = 9.80665
ACCEL, GYRO, DIAGONAL = "maximum_likelihood", "rotation_segment_3x3", "quaternion"
LONGEST = 60.0
"""s; poses after a longer gap are not of the static part."""
RESAMPLED = 2000
"""Draws of the turns, with replacement, for the sampling error of a figure."""
REST = 2.0
"""s; a shorter rest is a pause in the hand between two motions, not a pose of these protocols."""
NO_DATA = 2


@dataclass(frozen=True)
class Log:
    name: str
    path: str
    profile: str
    imu: int | None = None


LOGS = (
    *(Log(f"mpu9150 imu{i}", f"mpu9150/imu{i}.log", "mpu9150") for i in range(3)),
    Log("mpu6050", "mpu6050/example_data_calibration.csv", "mpu6050"),
    *(
        Log(f"mimu4444 exp_{run} IMU {imu}", f"mimu4444/exp_{run}/data.bin", "mimu4444", imu)
        for run in (1, 2, 6)
        for imu in range(1, 9)
    ),
)


@dataclass(frozen=True)
class Goal:
    """A figure to be as good as: the least of one column over some logs."""

    text: str
    logs: tuple[str, ...]
    column: str
    most: float


GOALS = (
    *(
        Goal(f"accelerometer of {log}: at most 8 mm/s²", (log,), "accel", 8.0)
        for log in (f"mimu4444 exp_2 IMU {imu}" for imu in (1, 4, 8))
    ),
    Goal(
        "gyroscope, mimu4444 exp_2 IMU 4: 0.295°",
        ("mimu4444 exp_2 IMU 4",),
        "full",
        0.295,
    ),
    *(
        Goal(f"gyroscope, mpu9150 imu{i}: 0.19°", (f"mpu9150 imu{i}",), "full", 0.19)
        for i in range(3)
    ),
    Goal(
        "gyroscope, best of mpu9150: 0.10°",
        tuple(f"mpu9150 imu{i}" for i in range(3)),
        "full",
        0.10,
    ),
)


@dataclass(frozen=True)
class Row:
    """Root mean squares; NaN where the log does not have what it takes.

    ``error`` is the standard error of ``full`` from which turns happened to be in the log.
    """

    poses: int
    turns: int
    accel: float
    full: float
    diagonal: float
    median: float
    seconds: float
    error: float = float("nan")
    note: str = ""


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def sampling_error(values: np.ndarray) -> float:
    """Return the standard error of the root mean square, by resampling [1]_.

    References
    ----------
    .. [1] Efron, "Bootstrap methods: another look at the jackknife", Annals of Statistics 7(1),
       1979.
    """
    drawn = np.random.default_rng(0).choice(values, (RESAMPLED, len(values)))
    return float(np.sqrt(np.mean(drawn**2, axis=1)).std())


def alternate_turns(
    recording: Recording, poses: Poses, turns: Turns, accel: Triad, method: str
) -> np.ndarray:
    """Return the closure error of each turn, rad, from a fit of the other half of the turns."""
    errors = np.empty(len(turns))
    parity = np.arange(len(turns)) % 2
    for half in (0, 1):
        fit = gyro_solvers()[method].solve(
            recording,
            poses,
            turns.select(parity != half),
            accel,
            gravity=GRAVITY,
            options={},
        )
        out = turns.select(parity == half)
        error = closure_errors(recording, poses, out, accel, fit.triad)
        errors[parity == half] = np.linalg.norm(error, axis=1)
    return errors


def measure(recording: Recording) -> Row:
    begin = time.process_time()
    poses = find_poses(recording)
    poses = poses.select(poses.interval[:, 1] - poses.interval[:, 0] >= REST)
    gap = poses.interval[1:, 0] - poses.interval[:-1, 1]
    poses = poses.select(np.cumsum(np.concatenate([[0.0], gap]) > LONGEST) == 0)
    turns = find_turns(recording, poses)
    nan = float("nan")
    try:
        solver = accel_solvers()[ACCEL]
        fit = solver.solve(poses, gravity=GRAVITY)
        if fit.undetermined:
            note = f"accelerometer not determined: {', '.join(fit.undetermined)}"
            return Row(len(poses), len(turns), nan, nan, nan, nan, nan, note=note)
        accel = leave_one_out(poses, solver, gravity=GRAVITY)
        full = np.degrees(alternate_turns(recording, poses, turns, fit.triad, GYRO))
        diagonal = np.degrees(alternate_turns(recording, poses, turns, fit.triad, DIAGONAL))
    except ImuError as error:
        return Row(len(poses), len(turns), nan, nan, nan, nan, nan, note=str(error))
    seconds = time.process_time() - begin
    return Row(
        len(poses),
        len(turns),
        1e3 * rms(accel),
        rms(full),
        rms(diagonal),
        float(np.median(full)),
        seconds,
        sampling_error(full),
    )


def main() -> int:
    default = os.environ.get("IMU_CAL_DATA") or Path(__file__).parents[1] / "../shared/data"
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of the logs")
    data = parser.parse_args().data
    if not data.is_dir():
        print(f"no folder {data}: give --data, or set IMU_CAL_DATA", file=sys.stderr)
        return NO_DATA
    print(
        "| log | poses | turns | accel, leave-one-out, mm/s² | gyro held out, full matrix, ° |",
        end="",
    )
    print(" scale only, ° | median, full, ° | CPU, s |")
    print("|---|---|---|---|---|---|---|---|")
    rows: dict[str, Row] = {}
    for log in LOGS:
        if not (data / log.path).is_file():
            print(f"| {log.name} | absent |")
            continue
        recording = read_recording(data / log.path, profile=log.profile, imu=log.imu)
        row = measure(recording)
        rows[log.name] = row
        if row.note:
            print(f"| {log.name} | {row.poses} | {row.turns} | {row.note} |")
            continue
        print(
            f"| {log.name} | {row.poses} | {row.turns} | {row.accel:.2f} | "
            f"{row.full:.3f} ± {row.error:.3f} | "
            f"{row.diagonal:.3f} | {row.median:.3f} | {row.seconds:.2f} |",
            flush=True,
        )
    print()
    print_sources(data)
    ok = True
    for goal in GOALS:
        found = [rows[name] for name in goal.logs if name in rows]
        if len(found) < len(goal.logs):
            print(f"- not judged, as its log is absent: {goal.text}")
            continue
        best = min(found, key=lambda row: getattr(row, goal.column))
        value = getattr(best, goal.column)
        met = value <= goal.most
        ok &= met
        doubt = f" ± {best.error:.3f}" if goal.column == "full" else ""
        print(f"- {'met' if met else 'MISSED'}: {goal.text}; found {value:.3f}{doubt}")
    return 0 if ok else 1


def print_sources(data: Path) -> None:
    print("| file | sha256 |")
    print("|---|---|")
    for path in dict.fromkeys(log.path for log in LOGS):
        if (data / path).is_file():
            print(f"| {path} | {hashlib.sha256((data / path).read_bytes()).hexdigest()} |")
    print()


if __name__ == "__main__":
    raise SystemExit(main())
