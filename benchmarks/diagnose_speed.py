"""CPU time and peak memory of `imu-cal diagnose` as a whole process, from 10 minutes to 24 hours.

Goals: a 10-minute recording at 100 Hz within 5 s of CPU and 500 MB, start-up included, with one
effect or two, by itself or against a simulation of its motion; a longer one at no more CPU per
sample, and a day's in less memory than its samples fill. Recordings are made here: bench sessions
of a consumer part, with long rests between them where it is long (a night), a temperature that
rises and falls with the day, and white noise, bias instability and random walk. Long ones are
written in chunks, so that making them does not take the memory that is measured.

Modules are compiled before, as an installation does. The exit code is 1 if a goal is missed. Times
depend on the machine, and on what else it does.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.effects.base import Term
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel
from drivers.formats import open_writer

RATE = 100.0
CHUNK = 250_000
CPU, MEMORY = 5.0, 500.0
"""Goals for 10 minutes: s, MB."""
DRIFT_STEP = 2.0
"""s; bias instability and random walk are drawn this far apart."""
EFFECT = Term("gyro_g_sensitivity", {"gxx": 3e-4, "gyy": -2e-4, "gzx": 1e-4})
SECOND = Term("accel_quadratic", {"kx": 1e-4, "ky": -1e-4, "kz": 1e-4})


ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
ENVIRONMENT.pop("PYTHONDONTWRITEBYTECODE", None)
LOADED = """
import calib.effects, calib.mismatch, drivers.formats, imu_cli.app, imu_cli.commands.diagnose
calib.effects.effects()
"""


class Case(NamedTuple):
    """A recording, and whether its motion is known (`--against`)."""

    duration: float
    poses: int
    sessions: int
    effects: tuple[Term, ...]
    against: bool = False


QUICK = [Case(600.0, poses, 1, own) for poses in (40, 60) for own in ((), (EFFECT,))] + [
    Case(600.0, 60, 1, (EFFECT, SECOND)),
    Case(600.0, 60, 1, (EFFECT,), against=True),
]
LONG = [
    Case(3600.0, 60, 3, (EFFECT,)),
    Case(86400.0, 120, 6, ()),
    Case(86400.0, 120, 6, (EFFECT,)),
]


def bench(duration: float, poses: int, sessions: int, *, rng: np.random.Generator) -> Motion:
    """Return `poses` poses of about 8 s in `sessions` groups, the last of each for a long time."""
    each = 8.0
    if sessions == 1:
        each = (duration - 1.65 * (poses - 1)) / poses
    base = bench_protocol(
        rng, poses=poses, pose_duration=(0.8 * each, 1.2 * each), first_pose=0.0, temperature=None
    )
    # Time stands still in the middle of some rests, which changes nothing in them.
    spare = max(duration - base.duration, 0.0)
    middle = base.statics.mean(axis=1)[np.arange(1, sessions) * poses // sessions]
    pause = spare / max(len(middle), 1)
    frozen = middle + pause * np.arange(len(middle))

    def moved(time: np.ndarray) -> np.ndarray:
        return time - np.clip(time[:, None] - frozen, 0.0, pause).sum(axis=1)

    length = base.duration + pause * len(middle)
    return replace(
        base,
        duration=length,
        segments=(),
        kinematics=lambda time: base.kinematics(moved(time)),
        temperature=lambda time: (
            25.0 + 4.0 * np.sin(2 * np.pi * time / 86400.0) + 5.0 * (1 - np.exp(-time / 200.0))
        ),
    )


def record(folder: Path, case: Case, seed: int) -> tuple[Path, Path | None, int, int]:
    """Write a recording, and a simulation of its motion; return samples and their bytes, too."""
    rng = np.random.default_rng(seed)
    motion = bench(case.duration, case.poses, case.sessions, rng=rng)
    model = SensorModel(
        Triad(
            rng.normal(0, 0.3, 3), rng.normal(0, 0.02, 3), np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        ),
        Triad(rng.normal(0, 0.03, 3), rng.normal(0, 0.02, 3)),
        case.effects,
    )
    white = NoiseModel(
        accel_noise_density=CONSUMER.accel_noise_density,
        gyro_noise_density=CONSUMER.gyro_noise_density,
        temperature=CONSUMER.temperature,
    )
    slow = replace(CONSUMER, accel_noise_density=0.0, gyro_noise_density=0.0, temperature=0.0)
    at = np.arange(0.0, motion.duration + DRIFT_STEP, DRIFT_STEP)
    drift = np.hstack(slow.draw(at, rng=rng))
    samples, size = int(motion.duration * RATE), 0
    path, other = folder / "recording.arrow", None
    with open_writer(path) as writer:
        for first in range(0, samples, CHUNK):
            time = np.arange(first, min(first + CHUNK, samples)) / RATE
            part = simulate(motion, model, white, rng=rng, time=time)
            bias = np.stack([np.interp(time, at, column) for column in drift.T], axis=1)
            part = replace(part, accel=part.accel + bias[:, :3], gyro=part.gyro + bias[:, 3:])
            writer.append(part)
            size += _size(part)
    if case.against:
        other = folder / "simulation.arrow"
        with open_writer(other) as writer:
            time = np.arange(samples) / RATE
            writer.append(simulate(motion, SensorModel(), NoiseModel(), rng=rng, time=time))
    return path, other, samples, size


def _size(part: Recording) -> int:
    arrays = (part.time, part.accel, part.gyro, part.temperature, part.lost)
    return sum(a.nbytes for a in arrays if a is not None)


def diagnose(path: Path, other: Path | None) -> tuple[dict, float, float]:
    """Return what a process says, its CPU seconds, and its peak resident memory in MB."""
    command = [sys.executable, "-m", "imu_cli", "diagnose", str(path), "--json"]
    if other is not None:
        command += ["--against", str(other)]
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(command, stdout=out, env=ENVIRONMENT)
        _, status, used = os.wait4(process.pid, 0)
        if status:
            raise SystemExit(f"{' '.join(command)} ended with status {status}")
        out.seek(0)
        found = json.load(out)
    return found, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="10 minutes only")
    parser.add_argument("--data", help="not needed: recordings are simulated")
    args = parser.parse_args()
    missed = False
    subprocess.run([sys.executable, "-c", LOADED], env=ENVIRONMENT, check=True)
    print(
        "| recording | poses | effects | beside | samples | CPU, s | µs/sample | peak, MB | of, MB "
        "| found | |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    worst = 0.0
    for case in QUICK if args.quick else QUICK + LONG:
        with tempfile.TemporaryDirectory() as folder:
            path, other, samples, size = record(Path(folder), case, args.seed)
            found, cpu, memory = diagnose(path, other)
        names = [item["effect"] for item in found["findings"]]
        asked = [term.effect for term in case.effects]
        good = sorted(names) == sorted(asked)
        each = 1e6 * cpu / samples
        if case.sessions == 1:
            worst = max(worst, each)
            good &= cpu <= CPU and memory <= MEMORY
        else:
            good &= each <= worst and memory <= max(MEMORY, size / 2**20)
        missed |= not good
        print(
            f"| {case.duration / 60:.0f} min | {case.poses} | {', '.join(asked) or '-'} | "
            f"{'simulation' if case.against else '-'} | {samples} | {cpu:.1f} | {each:.1f} | "
            f"{memory:.0f} | {size / 2**20:.0f} | {found['verdict']} {', '.join(names)} | "
            f"{'' if good else 'MISSED'} |",
            flush=True,
        )
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
