"""Speed of ``imu-cal apply``: Arrow to Arrow in samples/s, and the text filter in lines/s.

Goals: 5 million samples/s of CPU from Arrow to Arrow, 150 thousand lines/s through the text filter
when input is waiting. The peers, in the same run: a Python loop over samples with numpy's 3 x 3
product, and a line-by-line ``split`` and ``float`` filter. Speed figures depend on the machine, so
a missed goal is marked but does not fail.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib.calibration import Calibration, Gravity
from calib.effects.base import Term
from calib.model import SensorModel, Triad
from calib.recording import Recording
from drivers.apply_file import apply_file
from drivers.formats import open_writer
from drivers.text_filter import CsvFilter

BATCH = 1 << 16
NAMES = "time,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z,temperature"


def calibration(*terms: Term) -> Calibration:
    rng = np.random.default_rng(0)
    accel = Triad(rng.normal(0, 0.3, 3), rng.normal(0, 0.02, 3), np.tril(np.full((3, 3), 0.01), -1))
    gyro = Triad(rng.normal(0, 0.03, 3), rng.normal(0, 0.02, 3), 0.01 * (1 - np.eye(3)))
    return Calibration(SensorModel(accel, gyro, terms), (), np.zeros((0, 0)), (), Gravity(9.80665))


def timed(run: Callable[[], object], runs: int) -> tuple[float, float]:
    """Return the least CPU and wall-clock seconds of some runs."""
    best = (np.inf, np.inf)
    for _ in range(runs):
        cpu, wall = time.process_time(), time.perf_counter()
        run()
        best = (
            min(best[0], time.process_time() - cpu),
            min(best[1], time.perf_counter() - wall),
        )
    return best


def write_log(path: Path, batches: int) -> None:
    rng = np.random.default_rng(1)
    accel, gyro = rng.normal(0, 5, (BATCH, 3)), rng.normal(0, 1, (BATCH, 3))
    with open_writer(path) as writer:
        for k in range(batches):
            time_ = (np.arange(BATCH) + k * BATCH) * 1e-3
            writer.append(
                Recording(
                    time=time_,
                    accel=accel,
                    gyro=gyro,
                    clock="device",
                    temperature=np.full(BATCH, 30.0),
                )
            )


def sample_loop(cal: Calibration, accel: np.ndarray, gyro: np.ndarray) -> None:
    matrices = [np.linalg.inv(triad.matrix) for triad in (cal.model.accel, cal.model.gyro)]
    for a, w in zip(accel, gyro, strict=True):
        matrices[0] @ (a - cal.model.accel.bias)
        matrices[1] @ (w - cal.model.gyro.bias)


def line_loop(cal: Calibration, lines: list[bytes]) -> bytes:
    matrices = [np.linalg.inv(triad.matrix) for triad in (cal.model.accel, cal.model.gyro)]
    out = []
    for line in lines:
        cells = line.decode().rstrip("\n").split(",")
        values = np.array([float(cell) for cell in cells[1:7]])
        a = matrices[0] @ (values[:3] - cal.model.accel.bias)
        w = matrices[1] @ (values[3:] - cal.model.gyro.bias)
        out.append(",".join([cells[0], *map(repr, (*a.tolist(), *w.tolist())), *cells[7:]]) + "\n")
    return "".join(out).encode()


def run_filter(cal: Calibration, data: bytes, piece: int) -> int:
    stream = CsvFilter(cal, lambda text: sys.exit(text))
    for at in range(0, len(data), piece):
        stream.feed(data[at : at + piece])
    stream.finish()
    return stream.lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batches", type=int, default=64, help=f"of {BATCH} samples")
    parser.add_argument("--lines", type=int, default=200_000)
    parser.add_argument("--runs", type=int, default=5, help="the fastest of so many counts")
    parser.add_argument("--data", help="not needed: the log is made here")
    args = parser.parse_args()
    plain = calibration()
    pointwise = calibration(Term("gyro_g_sensitivity", {"gxx": 1e-4, "gzy": 2e-4}))
    neighbours = calibration(Term("time_offset", {"gyro_delay": 2e-3}))
    rows: list[tuple[str, float, float, float | None]] = []
    with tempfile.TemporaryDirectory() as folder:
        log, out = Path(folder) / "log.arrow", Path(folder) / "out.arrow"
        write_log(log, args.batches)
        n = args.batches * BATCH
        for label, cal, goal in (
            ("Arrow to Arrow", plain, 5e6),
            ("Arrow to Arrow, g-sensitivity in the model", pointwise, None),
            ("Arrow to Arrow, a delay in the model", neighbours, None),
        ):
            cpu, wall = timed(
                lambda cal=cal: apply_file(cal, log, out, name="benchmark"), args.runs
            )
            rows.append((label, n / cpu, n / wall, goal))
    rng = np.random.default_rng(2)
    accel, gyro = rng.normal(0, 5, (20_000, 3)), rng.normal(0, 1, (20_000, 3))
    cpu, wall = timed(lambda: sample_loop(plain, accel, gyro), 1)
    rows.append(("peer: Python loop over samples (no files)", 20_000 / cpu, 20_000 / wall, None))

    values = rng.normal(0, 5, (args.lines, 6)).round(6)
    lines = [
        f"{k * 0.01:.2f},{','.join(map(str, row))},25.3\n".encode()
        for k, row in enumerate(values.tolist())
    ]
    data = NAMES.encode() + b"\n" + b"".join(lines)
    for piece in (1 << 16, 1 << 20):
        cpu, wall = timed(lambda piece=piece: run_filter(plain, data, piece), args.runs)
        label = f"text filter, {piece >> 10} kB waiting"
        rows.append((label, args.lines / cpu, args.lines / wall, 150e3))
    single = NAMES.encode() + b"\n" + b"".join(lines[:2000])
    cpu, wall = timed(lambda: run_filter(plain, single, len(lines[0])), 1)
    rows.append(("text filter, one line at a time", 2000 / cpu, 2000 / wall, None))
    cpu, wall = timed(lambda: line_loop(plain, lines[:20_000]), 1)
    rows.append(("peer: split and float, line by line", 20_000 / cpu, 20_000 / wall, None))

    print("| what | per s of CPU | per s | goal |")
    print("|---|---|---|---|")
    for label, per_cpu, per_wall, goal in rows:
        mark = "" if goal is None else f"{goal:,.0f} {'met' if per_cpu >= goal else 'MISSED'}"
        print(f"| {label} | {per_cpu:,.0f} | {per_wall:,.0f} | {mark} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
