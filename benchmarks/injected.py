"""What the diagnosis names of effects that are added to real recordings.

Motion and noise of logs that other people made are harder than any generator's: a hand jolts, a
rest sways, noise is not normal, and the sensors have effects of their own. So one effect of the
catalogue is added to their samples, by its equation written out here, at ``--size`` times what is
typical of a consumer part, and the diagnosis is compared with that of the untouched log: is the
effect named, first or as a stated rival; are its parameters those of the untouched log and what was
added, within 3 standard errors of both; which names are new, or gone, that have nothing to do with
it.

Counts that were rounded are rounded again after a dither of one count, which adds a little noise.
Exit status 1 if most new names are wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from calib import Recording
from calib.mismatch import Diagnosis, diagnose_recording
from drivers.formats import read_recording

GRAVITY = 9.80665
DPS = np.pi / 180
NO_DATA = 2
LOGS = (
    *((f"mpu9150 imu{i}", f"mpu9150/imu{i}.log", "mpu9150", None) for i in range(3)),
    *((f"mimu4444 2.{i}", "mimu4444/exp_2/data.bin", "mimu4444", i) for i in (2, 6)),
    ("mimu4444 6.2", "mimu4444/exp_6/data.bin", "mimu4444", 2),
)

Signals = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Time since the start, specific force and rate, which are true but for what is to be found."""

Added = tuple[dict[int, np.ndarray], dict[str, float]]
"""What is added by channel (0 to 5), and the parameters that say it."""


def _matrix(one: int, other: int, source: int, prefix: str) -> Callable[[Signals, float], Added]:
    def make(signals: Signals, k: float) -> Added:
        x = signals[source]
        added = {3 + one: k * x[:, other], 3 + other: -k * x[:, one]}
        name = f"{prefix}{'xyz'[one]}{'xyz'[other]}"
        return added, {name: k, f"{prefix}{'xyz'[other]}{'xyz'[one]}": -k}

    return make


def _own(c: int, of: Callable[[np.ndarray], np.ndarray]) -> Callable[[Signals, float], Added]:
    def make(signals: Signals, k: float) -> Added:
        return {c: k * of(signals[1 + c // 3][:, c % 3])}, {f"k{'xyz'[c % 3]}": k}

    return make


def _product(signals: Signals, k: float) -> Added:
    return {1: k * signals[1][:, 1] * signals[1][:, 2]}, {"ky_yz": k}


def _warm_up(c: int) -> Callable[[Signals, float], Added]:
    def make(signals: Signals, k: float) -> Added:
        tau = 0.3 * signals[0][-1]
        return {c: k * np.exp(-signals[0] / tau)}, {f"k{'xyz'[c % 3]}": k, "tau": tau}

    return make


def _step(c: int) -> Callable[[Signals, float], Added]:
    def make(signals: Signals, k: float) -> Added:
        return {c: k * (signals[0] > 0.45 * signals[0][-1])}, {f"b{'xyz'[c % 3]}": k}

    return make


def _size_effect(signals: Signals, k: float) -> Added:
    time, _, rate = signals
    # The z axis sits k along y: w x (w x r) + dw/dt x r.
    z = rate[:, 1] * rate[:, 2] * k + np.gradient(rate[:, 0], time) * k
    return {2: z}, {"rzy": k}


EFFECTS: dict[str, tuple[float, Callable[[Signals, float], Added]]] = {
    "gyro_g_sensitivity": (0.1 * DPS / GRAVITY, _matrix(0, 1, 1, "g")),
    "gyro_misalignment": (0.01, _matrix(0, 1, 2, "m")),
    "gyro_scale_asymmetry": (1e-3, _own(5, np.abs)),
    "gyro_scale_nonlinearity": (2e-3 / (360 * DPS) ** 2, _own(4, lambda w: w**3)),
    "accel_quadratic": (3e-3 / GRAVITY, _own(0, np.square)),
    "accel_cubic": (2e-3 / GRAVITY**2, _own(2, lambda f: f**3)),
    "accel_cross_product": (2e-3 / GRAVITY, _product),
    "accel_scale_asymmetry": (1e-3, _own(2, np.abs)),
    "accel_warm_up": (5e-3 * GRAVITY, _warm_up(1)),
    "gyro_warm_up": (0.1 * DPS, _warm_up(4)),
    "accel_bias_step": (2e-3 * GRAVITY, _step(1)),
    "gyro_bias_step": (0.05 * DPS, _step(5)),
    "accel_size_effect": (1e-3, _size_effect),
}
"""Typical sizes, and what is added."""


@dataclass
class Line:
    """One effect over all logs."""

    logs: int = 0
    named: int = 0
    tied: int = 0
    right: int = 0
    compared: int = 0
    new: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = os.environ.get("IMU_CAL_DATA") or Path(__file__).parents[1] / "../shared/data"
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of the logs")
    parser.add_argument("--size", type=float, default=2.0, help="times what is typical")
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS))
    parser.add_argument("--logs", type=int, default=len(LOGS), help="only the first so many")
    args = parser.parse_args()
    if not args.data.is_dir():
        print(f"no folder {args.data}: give --data, or set IMU_CAL_DATA", file=sys.stderr)
        return NO_DATA
    table = {name: Line() for name in args.effects}
    for _, path, profile, imu in LOGS[: args.logs]:
        log = read_recording(args.data / path, profile=profile, imu=imu)
        before = diagnose_recording(log, gravity=GRAVITY)
        for name in args.effects:
            size, make = EFFECTS[name]
            touched, truth = inject(log, make, args.size * size)
            judge(table[name], name, before, diagnose_recording(touched, gravity=GRAVITY), truth)
    print(f"{args.size:g} times typical, on {len(LOGS[: args.logs])} real recordings\n")
    print("| effect | named | as rival | parameters within 3 | new names | names gone |")
    print("|---|---|---|---|---|---|")
    for name, line in table.items():
        print(
            f"| {name} | {line.named} of {line.logs} | {line.tied} | "
            f"{line.right} of {line.compared} | {', '.join(line.new)} | {', '.join(line.gone)} |"
        )
    named = sum(line.named + line.tied for line in table.values())
    new = sum(len(line.new) for line in table.values())
    total = sum(line.logs for line in table.values())
    right, compared = (sum(getattr(x, k) for x in table.values()) for k in ("right", "compared"))
    print(
        f"\nnamed or stated as a rival: {named} of {total}; parameters within 3: {right} of "
        f"{compared}; other names that are new: {new}"
    )
    return 0 if new <= max(named, 1) else 1


def inject(
    log: Recording, make: Callable[[Signals, float], Added], size: float
) -> tuple[Recording, dict[str, float]]:
    """Return the log with an effect added, and its parameters."""
    rng = np.random.default_rng(0)
    rate = log.gyro - np.median(log.gyro, axis=0)  # most of it is at rest
    added, truth = make((log.time - log.time[0], log.accel, rate), size)
    both = np.hstack((log.accel, log.gyro))
    for c, values in added.items():
        counts = np.unique(both[:, c])
        lsb = float(np.diff(counts).min()) if len(counts) > 1 else 0.0
        both[:, c] += values
        if len(counts) < 0.5 * len(both) and lsb > 1e-5:
            both[:, c] = np.round(both[:, c] / lsb + rng.uniform(-0.5, 0.5, len(both))) * lsb
    return replace(log, accel=both[:, :3], gyro=both[:, 3:]), truth


def judge(
    line: Line, name: str, before: Diagnosis, after: Diagnosis, truth: dict[str, float]
) -> None:
    """Add what was said of one log to the effect's line."""
    old = {f.effect: f for f in before.findings}
    now = {f.effect: f for f in after.findings}
    line.logs += 1
    rivals = {r.effect for f in after.findings for r in f.rivals}
    if name in now:
        line.named += 1
        for key, value in truth.items():
            q = now[name].parameters.get(key)
            own = old[name].parameters.get(key) if name in old else None
            if q is None or q.sigma is None or (name in old and key == "tau"):
                continue
            start = 0.0 if own is None else own.value
            line.compared += 1
            line.right += abs(q.value - start - value) < 3 * q.sigma
    elif name in rivals:
        line.tied += 1
    # A rival that comes first is no name of its own.
    mine = {f.effect for f in after.findings if name in {r.effect for r in f.rivals}}
    line.new += tuple(sorted(set(now) - set(old) - {name} - mine))
    line.gone += tuple(sorted(set(old) - set(now)))


if __name__ == "__main__":
    raise SystemExit(main())
