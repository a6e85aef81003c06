"""Lever arms of real recordings: between two IMUs of a board, and against motion capture.

The arm is that of the whole recording. What it is worth is shown on samples that no fit has seen:
the diagnosis has the recording up to the middle of its fast motion, and says what the
accelerometer reads in the second half. The numbers beside are those of independent small scripts
on the same recordings: held-out residual RMS of the accelerometer, each component, in the shaken
part and without clipped samples.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from calib.effects import get_effect
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.carried import ARM, arm_term
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.filters import smoothed
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.reference.setup import Setup
from calib.mismatch.samples.samples import look_at_samples
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from calib.statics import find_poses
from drivers.formats import read_recording
from drivers.reference_file import read_reference

GRAVITY = 9.80665
FAST = 0.3
"""Share of the highest rate from which on the motion is fast."""

CLOSE = 3e-4
"""m: how near to the drawing an arm must be for this script to succeed."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    default = os.environ.get("IMU_CAL_DATA") or Path(__file__).parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--runs", type=int, nargs="*", default=[1, 2, 6], help="of mimu4444")
    args = parser.parse_args()
    data = Path(args.data)
    if not data.is_dir():
        print(f"{data} is not there: give --data DIR", file=sys.stderr)
        return 1
    head = "| recording | arm, mm | drawn, mm | second half, before | after | with the drawn arm |"
    print(head + " others | CPU, s |")
    print("|---|---|---|---|---|---|---|---|")
    good = True
    drawn = drawing(data / "mimu4444" / "IMU_positions.csv", 1, 7)
    for run in args.runs:
        board = data / "mimu4444" / f"exp_{run}" / "data.bin"
        pair = read_recording(board, imu=1), read_recording(board, imu=7)
        arm = say(f"mimu4444 run {run}, IMU 1 against 7", *pair, drawn, "15.9 -> 8.7, 0.3 mm")
        good &= arm is not None and float(np.abs(arm - drawn).max()) < CLOSE
    trial = data / "broad" / "07_undisturbed_fast_rotation_B.hdf5"
    captured = read_reference(trial)
    arm = say("BROAD 07, fast rotation", read_recording(trial), captured, None, "0.728 -> 0.498")
    return 0 if good and arm is not None else 1


def drawing(path: Path, first: int, second: int) -> np.ndarray:
    table = np.genfromtxt(path, delimiter=",", skip_header=1)[:, 1:]
    return table[:, first - 1] - table[:, second - 1]


def say(
    name: str,
    real: Recording,
    reference: Recording | ReferenceMotion,
    drawn: np.ndarray | None,
    others: str,
) -> np.ndarray | None:
    start = time.process_time()
    found = diagnose_reference(real, reference, gravity=GRAVITY)
    seconds = time.process_time() - start
    item = next((f for f in found.findings if f.effect == "accel_lever_arm"), None)
    if item is None:
        print(f"| {name} | not found | | | | | {others} | {seconds:.0f} |")
        return None
    values = [item.parameters[f"r{a}"] for a in "xyz"]
    text = ", ".join(f"{1e3 * q.value:.2f} ± {1e3 * (q.sigma or 0):.2f}" for q in values)
    known = "" if drawn is None else ", ".join(f"{1e3 * v:.2f}" for v in drawn)
    left = " | ".join(f"{v:.3g} m/s²" for v in second_half(real, reference, drawn))
    left += "" if drawn is not None else " | "
    print(f"| {name} | {text} | {known} | {left} | {others} | {seconds:.0f} |", flush=True)
    return np.array([q.value for q in values])


def second_half(
    real: Recording, reference: Recording | ReferenceMotion, drawn: np.ndarray | None
) -> list[float]:
    """Return the RMS of accelerometer samples about what the first half says of the second.

    In the band in which forces agree. With the baseline and the alignment of the first half, with
    all that was found there, and, where there is a drawing, with the arm of that in place of the
    one that was found.
    """
    speed = np.linalg.norm(real.gyro, axis=1)
    fast = np.flatnonzero(speed > FAST * np.quantile(speed, 0.999))
    middle = int(fast[len(fast) // 2])
    first = real.slice(0, middle)
    plain = compared(first, reference).setup
    found = diagnose_reference(first, reference, gravity=GRAVITY)
    # What happened once in the first half says nothing of the second.
    lasting = tuple(t for t in found.model.terms if get_effect(t.effect).kind != "event")
    model = replace(found.model, terms=lasting)
    at = found.summary["alignment"]
    alignment = Alignment(at["offset"], at["stretch"], at["middle"])
    whole = compared(real, reference)
    unseen = (whole.time > real.time[middle]) & (whole.time < real.time[fast[-1]])
    turned = mat_from_rotvec(np.array(at["rotation"]))
    errors = np.array([*at["reference_gyro"], *at["reference_accel"]])
    setups = [plain, Setup(model, alignment, turned, errors)]
    if drawn is not None:
        others = tuple(t for t in lasting if t.effect != ARM)
        exact = replace(model, terms=(*others, arm_term(drawn)))
        setups.append(Setup(exact, alignment, turned, errors))
    out = []
    for setup in setups:
        whole.setup = setup
        left = whole.residual(whole.state())[:, :3]
        if whole.bands[0] < whole.band:
            # Above, markers show noise of forces.
            left = smoothed(whole.time, left, whole.bands[0])
        left = left[unseen]
        out.append(float(np.sqrt(np.mean(np.square(left)))))
    return out


def compared(real: Recording, reference: Recording | ReferenceMotion) -> ComparisonProblem:
    seen = look_at_samples(real, find_poses(real))
    return compare_reference(real, reference, seen, gravity=GRAVITY)[0]


if __name__ == "__main__":
    sys.exit(main())
