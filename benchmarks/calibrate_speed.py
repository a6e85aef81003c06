"""CPU time of whole processes: ``--help``, and a 10-minute log at 100 Hz to its calibration.

Goals: ``imu-cal --help`` within 0.3 s of CPU, calibration within 1.5 s, start-up included. Speed
figures depend on the machine, so a missed goal is marked but does not fail. The last rows put them
in proportion: the imports alone, and ``numpy.loadtxt`` of the same text.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from calib.model import SensorModel, Triad
from calib.simulate import NoiseModel, simulate
from calib.simulation.bench import bench_protocol
from drivers.formats import write_recording

GOALS = {"--help": 0.3, "calibrate": 1.5}


def cpu(command: list[str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def ten_minutes(path: Path, seed: int) -> int:
    rng = np.random.default_rng(seed)
    model = SensorModel(
        Triad(
            rng.normal(0, 0.3, 3), rng.normal(0, 0.02, 3), np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        ),
        Triad(
            rng.normal(0, 0.03, 3),
            rng.normal(0, 0.02, 3),
            rng.normal(0, 0.01, (3, 3)) * (1 - np.eye(3)),
        ),
    )
    noise = NoiseModel(accel_noise_density=4e-3, gyro_noise_density=1e-4)
    motion = bench_protocol(rng, poses=75, pose_duration=(5.0, 8.0), first_pose=20.0)
    recording = simulate(motion, model, noise, rng=rng, rate=100.0)
    write_recording(recording, path)
    return len(recording)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="the fastest of so many counts")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--data", help="not needed: the log is simulated")
    args = parser.parse_args()
    tool = [sys.executable, "-m", "imu_cli"]
    with tempfile.TemporaryDirectory() as folder:
        log, out = Path(folder) / "log.csv", str(Path(folder) / "cal.json")
        samples = ten_minutes(log, args.seed)
        arrow = Path(folder) / "log.arrow"
        subprocess.run([*tool, "convert", str(log), "-o", str(arrow)], check=True)
        read = "import numpy; numpy.loadtxt({!r}, delimiter=',', skiprows={})"
        header = sum(line.startswith(b"#") for line in log.read_bytes().splitlines()[:20]) + 1
        commands = {
            "`imu-cal --help`": ([*tool, "--help"], "--help"),
            f"`imu-cal calibrate log.csv` ({samples} samples)": (
                [*tool, "calibrate", str(log), "-o", out],
                "calibrate",
            ),
            "`imu-cal calibrate log.arrow`": (
                [*tool, "calibrate", str(arrow), "-o", out],
                "calibrate",
            ),
            "`imu-cal show cal.json`": ([*tool, "show", out], None),
            "`python -c 'import numpy, scipy.linalg, pyarrow'`": (
                [sys.executable, "-c", "import numpy, scipy.linalg, scipy.special, pyarrow"],
                None,
            ),
            "`numpy.loadtxt(log.csv)` alone": (
                [sys.executable, "-c", read.format(str(log), header)],
                None,
            ),
        }
        print("| command | CPU, s | goal |")
        print("|---|---|---|")
        for label, (command, goal) in commands.items():
            best = min(cpu(command) for _ in range(args.runs))
            limit = GOALS[goal] if goal else None
            mark = "" if limit is None else f"{limit} {'met' if best <= limit else 'MISSED'}"
            print(f"| {label} | {best:.2f} | {mark} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
