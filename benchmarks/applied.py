"""What the model that `diagnose -o` writes does to another recording of the same sensor.

A sensor has one effect that the paper's model leaves out. One session in 30 poses is calibrated,
and diagnosed; both calibrations are applied, by the command line, to a second session: other poses,
other turns, another temperature. Said is what is left of the true signals in means over half a
second, in turns and at rest, and what is left of a sensor without the effect (noise and drift).

The exit code is 1 if an effect that was named alone leaves more than `ENOUGH` times that in any of
the four. One that another explains as well, in the first session, may not hold in the second.
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

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from concealed import random_sensor

from calib.effects.base import Term
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER
from drivers.formats import open_writer, read_recording

RATE = 100.0
MEAN = 50
"""Samples that are averaged: an effect is small beside the noise of one."""

FAST = 0.3
"""rad/s from which on it turns."""

ENOUGH = 2.5

TERMS = (
    None,
    Term("gyro_g_sensitivity", {"gxx": 5e-4, "gyy": -4e-4, "gzx": 3e-4}),
    Term("gyro_misalignment", {"mxy": 0.01, "mxz": -0.008, "myz": 0.01, "mzx": -0.01}),
    Term("gyro_scale_temperature", {"kx": 4e-4, "ky": -3e-4, "kz": 5e-4}),
    Term("gyro_warm_up", {"kx": 0.006, "ky": -0.004, "kz": 0.003, "tau": 60.0}),
    Term("accel_bias_temperature", {"kx": 0.01, "ky": -0.006, "kz": 0.004}),
    Term("accel_quadratic", {"kx": 3e-4, "ky": -2e-4, "kz": 2e-4}),
    Term("accel_size_effect", {"ryx": 0.004, "ryz": 0.002, "rzy": -0.003}),
    Term("bandwidth", {"gyro": 1.0, "gyro_cutoff": 12.0, "order": 1.0}),
    Term("time_offset", {"gyro_delay": 0.008}),
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--data", help="not needed: recordings are simulated")
    args = parser.parse_args()
    names = "in turns, accel | gyro | at rest, accel | gyro"
    print(f"| effect | {names} | named, or as well |\n|---|---|---|---|---|---|")
    floor, missed = np.zeros(4), False
    for term in TERMS:
        plain, found, said = left_of(term, np.random.default_rng(args.seed))
        if term is None:
            floor = plain
            cells = [f"{v:.2g}" for v in plain]
        else:
            bad = len(said) < 2 and bool((found > ENOUGH * floor).any())
            missed |= bad
            cells = [f"{a:.2g} -> {b:.2g}" for a, b in zip(plain, found, strict=True)]
            cells[-1] += " MISSED" if bad else ""
        cells.append(", ".join(said))
        print(f"| {term.effect if term else 'none'} | {' | '.join(cells)} |", flush=True)
    return int(missed)


def left_of(
    term: Term | None, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return what `calibrate`, and `diagnose -o`, leave of a second session (4,), and the names.

    Behind what is named those that explain it as well.
    """
    sensor = replace(random_sensor(rng), terms=() if term is None else (term,))
    first = bench_protocol(rng, poses=30)
    second = bench_protocol(rng, poses=15, temperature=26.0, warm_up=9.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for motion, file in ((first, "first.arrow"), (second, "second.arrow")):
            with open_writer(folder / file) as writer:
                writer.append(simulate(motion, sensor, CONSUMER, rng=rng, rate=RATE))
        out, told = [], ""
        for command in ("calibrate", "diagnose"):
            more = ["--json"] if command == "diagnose" else []
            told = say(command, "first.arrow", "-o", f"{command}.json", *more, folder=folder)
            applied = f"{command}.arrow"
            say("apply", f"{command}.json", "second.arrow", "-o", applied, folder=folder)
            out.append(left(read_recording(folder / applied), second))
        findings = json.loads(told)["findings"]
    said = [f["effect"] for f in findings]
    said += [r["effect"] for f in findings for r in f["rivals"]]
    return out[0], out[1], said


def say(*words: str, folder: Path) -> str:
    """Run one command of the tool in a folder; return what it says."""
    command = [sys.executable, "-m", "imu_cli", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)} ended with {done.returncode}: {done.stderr}")
    return done.stdout


def left(corrected: Recording, motion: Motion) -> np.ndarray:
    """Return the RMS of means off the true force and rate: in turns, and at rest."""
    true = motion.state(corrected.time)
    off = np.hstack((corrected.accel - true.force, corrected.gyro - true.rate))
    turning = np.linalg.norm(true.rate, axis=1) > FAST
    out = []
    for some in (turning, ~turning):
        part = off[some]
        means = part[: len(part) // MEAN * MEAN].reshape(-1, MEAN, 6).mean(axis=1)
        out += [np.sqrt(np.mean(np.square(means[:, k : k + 3]))) for k in (0, 3)]
    return np.array(out)


if __name__ == "__main__":
    sys.exit(main())
