"""Lever arms of real recordings: between two IMUs of a board, and against motion capture.

The numbers beside ours are those of independent small scripts on the same recordings; ours are
residual RMS on held-out windows, as the diagnosis reports them (projections on the mean and the
shapes of a window, not single samples, so that the levels differ and the ratio is what compares).
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from calib.mismatch import Diagnosis, diagnose_reference
from drivers.formats import read_recording
from drivers.reference_file import read_reference

GRAVITY = 9.80665
CLOSE = 1e-3
"""m: how near to the drawing an arm must be for this script to succeed."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    default = os.environ.get("IMU_CAL_DATA") or Path(__file__).parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=default)
    data = Path(parser.parse_args().data)
    if not data.is_dir():
        print(f"{data} is not there: give --data DIR", file=sys.stderr)
        return 1
    print("| recording | arm, mm | drawn, mm | held out before | after | others |")
    print("|---|---|---|---|---|---|")
    good = True
    board = data / "mimu4444" / "exp_2" / "data.bin"
    found = diagnose_reference(
        read_recording(board, imu=1), read_recording(board, imu=7), gravity=GRAVITY
    )
    drawn = drawing(data / "mimu4444" / "IMU_positions.csv", 1, 7)
    arm = say("mimu4444 run 2, IMU 1 against 7", found, drawn, "15.9 -> 8.7 m/s², 0.3 mm")
    good &= arm is not None and float(np.abs(arm - drawn).max()) < CLOSE
    trial = data / "broad" / "07_undisturbed_fast_rotation_B.hdf5"
    found = diagnose_reference(read_recording(trial), read_reference(trial), gravity=GRAVITY)
    good &= say("BROAD 07, fast rotation", found, None, "0.728 -> 0.498 m/s²") is not None
    return 0 if good else 1


def drawing(path: Path, first: int, second: int) -> np.ndarray:
    table = np.genfromtxt(path, delimiter=",", skip_header=1)[:, 1:]
    return table[:, first - 1] - table[:, second - 1]


def say(name: str, found: Diagnosis, drawn: np.ndarray | None, others: str) -> np.ndarray | None:
    item = next((f for f in found.findings if f.effect == "accel_lever_arm"), None)
    if item is None or item.held_out is None:
        print(f"| {name} | not found | | | | {others} |")
        return None
    values = [item.parameters[f"r{a}"] for a in "xyz"]
    text = ", ".join(f"{1e3 * q.value:.2f} ± {1e3 * (q.sigma or 0):.2f}" for q in values)
    known = "" if drawn is None else ", ".join(f"{1e3 * v:.2f}" for v in drawn)
    h = item.held_out
    print(
        f"| {name} | {text} | {known} | {h.before:.3g} {h.unit} ({h.rows}) | {h.after:.3g} | "
        f"{others} |",
        flush=True,
    )
    return np.array([q.value for q in values])


if __name__ == "__main__":
    sys.exit(main())
