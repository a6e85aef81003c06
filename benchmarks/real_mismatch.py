"""What the diagnosis finds in real recordings that nobody simulated, with no hint what is in them.

Each log goes through the self mode alone: no reference, no calibration. The figures in the last
column are those of independent small scripts on the same logs. Held out means poses with the turns
that follow them (a fifth at a time), or every fifth part of the one rest of the thermal log.

Exit status 1 if something that is known to be in a log is not named, or falls short of a figure.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from calib.mismatch import Diagnosis, diagnose_recording
from calib.mismatch.findings.diagnosis import Finding
from drivers.formats import read_recording

GRAVITY = 9.80665
IMUS = range(1, 9)
NO_DATA = 2

WARM_GYRO = 0.0064
"""dps, held out, mimu4444 run 6: from 0.0466 before. Leaving out one pose in turn, 0.0466 is what a
constant leaves on IMU 6."""

THERMAL = {"constant": 0.191, "cubic": 0.044, "rate": 0.018}
"""m/s², acc.z of the thermal log."""


@dataclass(frozen=True)
class Line:
    """One line of the table; ``good`` is None where nothing is demanded."""

    log: str
    found: str
    where: str
    proof: str
    goal: str
    good: bool | None = None


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = os.environ.get("IMU_CAL_DATA") or Path(__file__).parents[1] / "../shared/data"
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of the logs")
    data = parser.parse_args().data
    if not data.is_dir():
        print(f"no folder {data}: give --data, or set IMU_CAL_DATA", file=sys.stderr)
        return NO_DATA
    print("| log | found | where | held out, before → after | others' scripts | |")
    print("|---|---|---|---|---|---|")
    good = True
    for line in lines(data):
        mark = {None: "", True: "met", False: "MISSED"}[line.good]
        print(
            f"| {line.log} | {line.found} | {line.where} | {line.proof} | {line.goal} | {mark} |",
            flush=True,
        )
        good &= line.good is not False
    return 0 if good else 1


def lines(data: Path) -> Iterator[Line]:
    runs = {
        run: [diagnose(data / f"mimu4444/exp_{run}/data.bin", "mimu4444", imu) for imu in IMUS]
        for run in (1, 2, 6)
    }
    for run in (1, 6):
        yield from warm_up(run, runs[run])
    for run, found in runs.items():
        yield clipping(run, found)
    yield from thermal(diagnose(data / "thermal/imu_raw_data.csv", "thermal"))
    hand = [diagnose(data / f"mpu9150/imu{imu}.log", "mpu9150") for imu in range(3)]
    for imu, found in enumerate(hand):
        yield misalignment(f"mpu9150 imu{imu}", [found], needed=1)
    for run, each in runs.items():
        # Shocks, as the board is tumbled from face to face, leave errors of their own in its turns.
        yield misalignment(f"mimu4444 run {run}", each, needed=None)
    for log, each in (("mpu9150", hand), *((f"mimu4444 run {r}", v) for r, v in runs.items())):
        yield others(log, each)


def diagnose(path: Path, profile: str, imu: int | None = None) -> Diagnosis:
    return diagnose_recording(read_recording(path, profile=profile, imu=imu), gravity=GRAVITY)


def named(found: Diagnosis, effect: str) -> Finding | None:
    return next((f for f in found.findings if f.effect == effect), None)


def warm_up(run: int, boards: list[Diagnosis]) -> Iterator[Line]:
    """Yield a line for each IMU whose gyroscope warms up, and one for the others."""
    silent = []
    for imu, found in zip(IMUS, boards, strict=True):
        item = named(found, "gyro_warm_up")
        if item is None:
            silent.append(str(imu))
            continue
        assert item.held_out is not None
        tau = item.parameters["tau"]
        before, after = np.degrees([item.held_out.before, item.held_out.after])
        rated = run == 6 and imu == 6
        yield Line(
            f"mimu4444 run {run} IMU {imu}",
            f"gyro_warm_up, tau {tau.value:.0f} ± {tau.sigma or 0:.0f} s",
            ", ".join(item.channels),
            f"{before:.4f} → {after:.4f} dps at rest",
            "0.0466 → 0.0064 dps" if rated else "",
            bool(after <= WARM_GYRO) if rated else None,
        )
    some = len(silent) < len(boards)
    where = f"not named on IMU {', '.join(silent)}" if silent else "named on all"
    yield Line(
        f"mimu4444 run {run}", f"gyro_warm_up on {8 - len(silent)} of 8", where, "", "", some
    )


def clipping(run: int, boards: list[Diagnosis]) -> Line:
    """Return a line on all IMUs of a run; clipping needs no fit, so nothing is held out."""
    items = [f for found in boards for f in found.findings if f.effect == "saturation"]
    with_it = sum(named(found, "saturation") is not None for found in boards)
    channels = sorted({c for f in items for c in f.channels})
    start = min((f.intervals[0][0] for f in items), default=float("nan"))
    stop = max((f.intervals[-1][1] for f in items), default=float("nan"))
    return Line(
        f"mimu4444 run {run}",
        f"saturation on {with_it} of 8",
        f"{', '.join(channels)}, {start:.0f} to {stop:.0f} s",
        "seen in the samples",
        "",
        with_it == len(boards),
    )


def thermal(found: Diagnosis) -> Iterator[Line]:
    """Yield what the thermal log shows: powers of temperature, its rate, and no clock."""
    bias = named(found, "accel_bias_temperature")
    rate = named(found, "accel_temperature_rate")
    for item, name, goal, limit in (
        (bias, "accel_bias_temperature", "0.191 constant → 0.044 cubic", THERMAL["cubic"]),
        (rate, "accel_temperature_rate", "0.044 → 0.018 with the rate", THERMAL["rate"]),
    ):
        if item is None or item.held_out is None:
            yield Line("thermal", f"{name} not found", "", "", goal, False)
            continue
        before, after = item.held_out.channels["accel.z"]
        yield Line(
            "thermal",
            name,
            ", ".join(item.channels),
            f"acc.z {before:.4f} → {after:.4f} m/s²",
            goal,
            after <= limit,
        )
    gyro = named(found, "gyro_bias_temperature")
    if gyro is not None and gyro.held_out is not None:
        before, after = np.degrees([gyro.held_out.before, gyro.held_out.after])
        proof = f"{before:.3f} → {after:.3f} dps"
        yield Line("thermal", gyro.effect, ", ".join(gyro.channels), proof, "")
    said = [text for text in found.missing if "clock" in text]
    yield Line("thermal", "invalid clock", "said" if said else "not said", "", "", bool(said))
    allowed = {"accel_bias_temperature", "accel_temperature_rate"}
    allowed |= {"gyro_bias_temperature", "gyro_temperature_rate"}
    other = [f.effect for f in found.findings if f.effect not in allowed]
    text = f"named as well: {', '.join(other)}" if other else "nothing but temperature is named"
    yield Line("thermal", text, "", "", "", not other)


def others(log: str, boards: list[Diagnosis]) -> Line:
    """Return a line on every other name that was given: nobody knows which of them are right."""
    asked = ("gyro_warm_up", "saturation", "gyro_misalignment")
    count = Counter(f.effect for found in boards for f in found.findings if f.effect not in asked)
    text = ", ".join(f"{name} on {n}" for name, n in sorted(count.items()))
    return Line(log, f"also named, of {len(boards)} sensors: {text or 'nothing'}", "", "", "")


def misalignment(log: str, boards: Iterable[Diagnosis], *, needed: int | None) -> Line:
    """Return a line on what the paper's diagonal gyroscope model leaves out."""
    items = [f for f in (named(found, "gyro_misalignment") for found in boards) if f is not None]
    if not items:
        return Line(log, "gyro_misalignment not found", "", "", "", needed is None)
    largest = [max(abs(q.value) for q in f.parameters.values()) for f in items]
    held = [f.held_out for f in items if f.held_out is not None and f.held_out.unit == "rad"]
    low, high = np.degrees([min(largest), max(largest)])
    size = f"{high:.2f}°" if len(items) == 1 else f"{low:.2f} to {high:.2f}°"
    proof = ""
    if held:
        before, after = np.degrees(
            [np.median([h.before for h in held]), np.median([h.after for h in held])]
        )
        proof = f"{before:.3f} → {after:.3f}° a turn" + (", median" if len(held) > 1 else "")
    count = "" if needed == 1 else f" on {len(items)} of 8"
    channels = sorted({c for f in items for c in f.channels})
    return Line(
        log,
        f"gyro_misalignment{count}, up to {size}",
        ", ".join(channels),
        proof,
        "",
        None if needed is None else len(items) >= needed,
    )


if __name__ == "__main__":
    raise SystemExit(main())
