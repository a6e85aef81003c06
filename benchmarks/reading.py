"""Reading text logs beside the readers that a user would pick: pyarrow, polars, numpy.loadtxt.

Each reads the same file of ``--rows`` rows of 8 numbers, and ends with the same arrays in memory.
Ratios are to pyarrow's CSV reader in this run; seconds depend on the machine and its load.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib import Recording
from drivers.formats import open_batches, open_writer, read_recording

GOAL = 1.5
"""Times pyarrow's own time, which counts as its speed."""
CHUNK = 250_000
NAMES = ["time", "accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "temperature"]


def write(path: Path, foreign: Path, rows: int) -> None:
    """Write the same samples as CSV in SI, and as a foreign log without names."""
    rng = np.random.default_rng(0)
    with open_writer(path) as writer, foreign.open("wb") as text:
        from pyarrow import csv, table

        for start in range(0, rows, CHUNK):
            n = min(CHUNK, rows - start)
            batch = Recording(
                time=np.round((start + np.arange(n)) * 1e-3, 3),
                accel=np.round(rng.normal(0, 10, (n, 3)), 5),
                gyro=np.round(rng.normal(0, 1, (n, 3)), 6),
                temperature=np.round(rng.normal(25, 1, n), 2),
                clock="device",
            )
            writer.append(batch)
            columns = [batch.time, *batch.accel.T, *batch.gyro.T, batch.temperature]
            named = dict(zip(NAMES, map(np.ascontiguousarray, columns), strict=True))
            csv.write_csv(table(named), text, csv.WriteOptions(include_header=False))


PROFILE = """
[text]
delimiter = ","
[time]
column = 1
[accel]
columns = [2, 3, 4]
unit = "m/s^2"
[gyro]
columns = [5, 6, 7]
unit = "rad/s"
[temperature]
column = 8
"""


def pyarrow_reader(path: Path) -> object:
    from pyarrow import csv

    table = csv.read_csv(path, read_options=csv.ReadOptions(column_names=NAMES))
    return np.stack([table[name].to_numpy() for name in NAMES], axis=1)


def polars_reader(path: Path) -> object:
    import polars  # type: ignore[import-not-found]

    return polars.read_csv(path, has_header=False).to_numpy()


def loadtxt(path: Path) -> object:
    return np.loadtxt(path, delimiter=",")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--no-loadtxt", action="store_true", help="it takes a while")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ours, foreign = Path(folder) / "si.csv", Path(folder) / "foreign.log"
        profile = Path(folder) / "profile.toml"
        profile.write_text(PROFILE, "utf-8")
        write(ours, foreign, args.rows)
        size = foreign.stat().st_size / 1e6
        readers: dict[str, Callable[[], object] | str] = {
            "pyarrow csv, to an array": lambda: pyarrow_reader(foreign),
            "imu-cal, CSV in SI": lambda: read_recording(ours),
            "imu-cal, import profile": lambda: read_recording(foreign, profile=str(profile)),
            "imu-cal, in batches": lambda: sum(map(len, open_batches(ours))),
            "polars": (lambda: polars_reader(foreign))
            if importlib.util.find_spec("polars")
            else "skipped: polars is not installed",
            "numpy.loadtxt": "skipped: --no-loadtxt"
            if args.no_loadtxt
            else lambda: loadtxt(foreign),
        }
        print(f"{args.rows} rows x 8, {size:.0f} MB of text, best of {args.repeat}\n")
        print("| reader | wall, s | CPU, s | wall over pyarrow |\n|---|---|---|---|")
        base = ratio = 0.0
        for name, reader in readers.items():
            if isinstance(reader, str):
                print(f"| {name} | {reader} | | |")
                continue
            wall, cpu = measure(reader, 1 if name == "numpy.loadtxt" else args.repeat)
            base = base or wall
            if name == "imu-cal, CSV in SI":
                ratio = wall / base
            print(f"| {name} | {wall:.2f} | {cpu:.2f} | {wall / base:.2f} |", flush=True)
    print(f"\ngoal: at most {GOAL} x pyarrow; {'met' if ratio <= GOAL else 'missed'}")
    return 0


def measure(reader: Callable[[], object], repeat: int) -> tuple[float, float]:
    walls, cpus = [], []
    for _ in range(repeat):
        cpu, wall = time.process_time(), time.perf_counter()
        reader()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return min(walls), min(cpus)


if __name__ == "__main__":
    sys.exit(main())
