"""Each fault, injected into clean logs, is reported; on the clean logs nothing is.

Logs are simulated (rates, noise, tremor, resolution) and, where ``--data`` holds them, real: those
parts of the public logs that are sound. A fault counts as found if `calib.audit` names its kind.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib import DeviceInfo, Recording, SensorModel, Triad
from calib.audit import audit
from calib.effects.base import State
from calib.faults import noise_at_rest, values_of
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

G = 9.80665
DEG = np.pi / 180
Rng = np.random.Generator
Inject = Callable[[Recording, Rng], Recording | None]


def simulated(rng: Rng, kind: str) -> tuple[Recording, SensorModel]:
    """Return a sound log: a raw sensor with biases, scale and misalignment of its kind."""
    rate, noise, lsb, tremor = {
        "100 Hz": (100.0, 1.0, True, 1.0),
        "50 Hz, noise x 3": (50.0, 3.0, True, 1.0),
        "400 Hz, noise x 0.3": (400.0, 0.3, True, 1.0),
        "1 kHz, no rounding": (1000.0, 1.0, False, 1.0),
        "100 Hz, rough hand": (100.0, 1.0, True, 4.0),
        "200 Hz, hand-held": (200.0, 1.0, True, 1.0),
    }[kind]
    model = SensorModel(
        Triad(
            rng.normal(0, 0.3, 3), rng.normal(0, 0.02, 3), np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        ),
        Triad(
            rng.normal(0, 0.03, 3), rng.normal(0, 0.02, 3), np.triu(rng.normal(0, 0.01, (3, 3)), 1)
        ),
    )
    motion = bench_protocol(
        rng,
        poses=14,
        pose_duration=(2.0, 4.0),
        first_pose=3.0,
        tremor=tremor,
        hold_tremor=0.2 if "held" in kind else 0.0,
    )
    device = DeviceInfo(
        chip="simulated",
        accel_full_scale=4 * G,
        gyro_full_scale=1000 * DEG,
        accel_lsb=4 * G / 32768 if lsb else None,
        gyro_lsb=1000 * DEG / 32768 if lsb else None,
        rate=rate,
    )
    return simulate(motion, model, CONSUMER.scaled(noise), rng=rng, rate=rate, device=device), model


SIMULATED = (
    "100 Hz",
    "50 Hz, noise x 3",
    "400 Hz, noise x 0.3",
    "1 kHz, no rounding",
    "100 Hz, rough hand",
    "200 Hz, hand-held",
)


def real(data: Path) -> Iterator[tuple[str, Recording]]:
    """Yield the sound parts of the public logs: before the boards are shaken into saturation."""
    from drivers.formats import read_recording

    for k in range(3):
        path = data / "mpu9150" / f"imu{k}.log"
        if path.exists():
            yield f"mpu9150/imu{k}", read_recording(path, profile="mpu9150")
    for run in (1, 2, 6):
        path = data / "mimu4444" / f"exp_{run}" / "data.bin"
        for imu in (1, 4, 8) if path.exists() else ():
            whole = read_recording(path, imu=imu)
            stop = int(np.searchsorted(whole.time, 470.0))
            yield f"mimu4444/exp_{run}:{imu}", replace(whole.slice(0, stop), complete=True)
    path = data / "mpu6050" / "example_data_tinit_calc.csv"
    if path.exists():
        yield "mpu6050, static", read_recording(path)
    path = data / "broad" / "07_undisturbed_fast_rotation_B.hdf5"
    if path.exists():
        yield "broad 07", read_recording(path)


def _changed(recording: Recording, values: np.ndarray) -> Recording:
    return replace(recording, accel=values[:, :3], gyro=values[:, 3:])


def _kept(recording: Recording, keep: np.ndarray) -> Recording:
    heat = recording.temperature
    return replace(
        recording,
        time=recording.time[keep],
        accel=recording.accel[keep],
        gyro=recording.gyro[keep],
        temperature=None if heat is None else heat[keep],
        lost=np.asarray(recording.lost)[keep],
    )


def _moving(recording: Recording) -> np.ndarray:
    still = np.zeros(len(recording), bool)
    poses = find_poses(recording)
    for start, stop in zip(poses.start, poses.stop, strict=True):
        still[start:stop] = True
    return np.flatnonzero(~still)


def gap(recording: Recording, rng: Rng) -> Recording:
    start = int(rng.integers(100, len(recording) - 200))
    return _kept(recording, np.r_[:start, start + 20 : len(recording)])


def single_losses(recording: Recording, rng: Rng) -> Recording:
    lost = rng.choice(np.arange(10, len(recording) - 10), 5, replace=False)
    return _kept(recording, np.setdiff1d(np.arange(len(recording)), lost))


def counted_losses(recording: Recording, rng: Rng) -> Recording:
    lost = np.zeros(len(recording), np.int64)
    lost[rng.integers(1, len(recording), 4)] = 3
    return replace(recording, lost=lost)


def jitter(recording: Recording, rng: Rng) -> Recording:
    shift = np.clip(rng.normal(0, 0.1, len(recording)), -0.45, 0.45)
    return replace(recording, time=recording.time + recording.interval * shift)


def repeats(recording: Recording, rng: Rng) -> Recording:
    values = values_of(recording).copy()
    for k in rng.choice(np.arange(10, len(values) - 10, 3), 12, replace=False):
        values[k] = values[k - 1]
    return _changed(recording, values)


def held_every_second(recording: Recording, rng: Rng) -> Recording:
    values = values_of(recording).copy()
    values[1::2] = values[: len(values) - 1 : 2][: len(values[1::2])]
    return _changed(recording, values)


def clipped(recording: Recording, rng: Rng) -> Recording | None:
    """Cut the peaks of the channel that turns fastest, full scale not known."""
    values = values_of(recording).copy()
    c = 3 + int(np.argmax(np.abs(recording.gyro).max(axis=0)))
    limit = 0.5 * np.abs(values[:, c]).max()
    if limit < 1.0:
        return None
    values[:, c] = np.clip(values[:, c], -limit, limit)
    return replace(_changed(recording, values), device=DeviceInfo(rate=recording.device.rate))


def clipped_at_full_scale(recording: Recording, rng: Rng) -> Recording | None:
    whole = clipped(recording, rng)
    if whole is None:
        return None
    limit = float(
        np.abs(whole.gyro).max(axis=0)[int(np.argmax(np.abs(recording.gyro).max(axis=0)))]
    )
    values = np.clip(recording.gyro, -limit, limit)
    return replace(recording, gyro=values, device=DeviceInfo(gyro_full_scale=limit))


def dead(recording: Recording, rng: Rng) -> Recording:
    values = values_of(recording).copy()
    values[:, int(rng.integers(6))] = 0.0
    return _changed(recording, values)


def stuck(recording: Recording, rng: Rng) -> Recording | None:
    moving = _moving(recording)
    if moving.size < 100:
        return None
    values = values_of(recording).copy()
    k, c = int(rng.choice(moving[50:-50])), int(rng.integers(6))
    half = round(1.0 / recording.interval)
    values[max(0, k - half) : k + half, c] = values[max(0, k - half), c]
    return _changed(recording, values)


def spikes(recording: Recording, rng: Rng) -> Recording:
    values = values_of(recording).copy()
    noise = np.maximum(noise_at_rest(values), 1e-6)
    at = rng.choice(np.arange(50, len(values) - 50, 30), 8, replace=False)
    for k in at:
        c = int(rng.integers(6))
        values[k, c] += 40 * noise[c] * rng.choice([-1, 1])
    return _changed(recording, values)


def torn_bytes(recording: Recording, rng: Rng) -> Recording | None:
    """Add 256 counts to single gyroscope readings: what a read of single bytes does."""
    lsb = recording.device.gyro_lsb
    if lsb is None or 256 * lsb < 20 * noise_at_rest(recording.gyro).max():
        return None
    values = values_of(recording).copy()
    for k in rng.choice(np.arange(50, len(values) - 50, 30), 8, replace=False):
        values[k, 3 + int(rng.integers(3))] += 256 * lsb
    return _changed(recording, values)


def scaled(**factors: float) -> Inject:
    def inject(recording: Recording, rng: Rng) -> Recording | None:
        if "gyro" in factors and not _turns_enough(recording):
            return None
        values = {name: getattr(recording, name) * factor for name, factor in factors.items()}
        return replace(recording, device=DeviceInfo(), **values)

    return inject


def _turns_enough(recording: Recording) -> bool:
    """Return whether the recording has poses with turns between: else no unit can be told."""
    return len(find_poses(recording)) > 3


def swapped_axes(recording: Recording, rng: Rng) -> Recording | None:
    if not _turns_enough(recording):
        return None
    return replace(recording, gyro=recording.gyro[:, [1, 0, 2]])


def wrong_sign(recording: Recording, rng: Rng) -> Recording | None:
    if not _turns_enough(recording):
        return None
    return replace(recording, gyro=-recording.gyro)


def cut(recording: Recording, rng: Rng) -> Recording:
    return replace(recording, complete=False)


def clock_known_bad(recording: Recording, rng: Rng) -> Recording:
    return replace(recording, clock="invalid")


def wrong_time_unit(recording: Recording, rng: Rng) -> Recording:
    rate = recording.device.rate or 1 / recording.interval
    device = replace(recording.device, rate=rate)
    return replace(recording, time=recording.time * 1e-3, device=device)


def impossible_heating(recording: Recording, rng: Rng) -> Recording:
    sweep = 25 + 40 * np.sin(2 * np.pi * recording.time / 6)
    return replace(recording, temperature=sweep)


FAULTS: dict[str, tuple[str, Inject]] = {
    "gap of 20 samples": ("gaps", gap),
    "5 single samples missing": ("gaps", single_losses),
    "losses counted by the logger": ("gaps", counted_losses),
    "jitter of 10 % of a step": ("jitter", jitter),
    "12 repeated samples": ("repeats", repeats),
    "every second sample held": ("repeats", held_every_second),
    "clipping, full scale unknown": ("clipping", clipped),
    "clipping at full scale": ("clipping", clipped_at_full_scale),
    "dead channel": ("stuck", dead),
    "channel stuck for 2 s": ("stuck", stuck),
    "8 spikes of 40 sigma": ("spikes", spikes),
    "8 torn bytes (256 counts)": ("spikes", torn_bytes),
    "accelerometer in g": ("unit", scaled(accel=1 / G)),
    "accelerometer in mg": ("unit", scaled(accel=1000 / G)),
    "accelerometer at half its scale": ("unit", scaled(accel=0.5)),
    "gyroscope in deg/s": ("unit", scaled(gyro=1 / DEG)),
    "gyroscope converted twice": ("unit", scaled(gyro=DEG)),
    "gyroscope at half its scale": ("unit", scaled(gyro=0.5)),
    "gyroscope axes swapped": ("axes", swapped_axes),
    "gyroscope with wrong sign": ("axes", wrong_sign),
    "cut": ("cut", cut),
    "clock known to be wrong": ("clock", clock_known_bad),
    "time in ms taken for s": ("rate", wrong_time_unit),
    "temperature sweep in 6 s": ("clock", impossible_heating),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=os.environ.get("IMU_CAL_DATA", default))
    parser.add_argument("--seeds", type=int, default=3, help="simulated logs of each kind")
    parser.add_argument("--verbose", action="store_true", help="name every miss")
    args = parser.parse_args()
    logs: list[tuple[str, Recording, SensorModel | None]] = []
    for kind in SIMULATED:
        for seed in range(args.seeds):
            recording, model = simulated(np.random.default_rng([seed, len(kind)]), kind)
            logs.append((f"simulated, {kind}", recording, model))
    logs += [(name, recording, None) for name, recording in real(Path(args.data))]
    sound = Counter[str]()
    false = 0
    for name, recording, _ in logs:
        findings = audit(recording).findings
        sound[name.split(":")[0]] += 1
        for finding in findings:
            false += 1
            print(f"clean log {name}: {finding.kind}: {finding.message}", file=sys.stderr)
    print(f"{len(logs)} clean logs, {false} findings on them\n")
    print("| fault | found | simulated | real |\n|---|---|---|---|")
    missed = 0
    for fault, (kind, inject) in FAULTS.items():
        score = {True: [0, 0], False: [0, 0]}
        for k, (name, recording, model) in enumerate(logs):
            faulty = inject(recording, np.random.default_rng(k))
            if faulty is None:
                continue
            found = kind in {finding.kind for finding in audit(faulty).findings}
            score[model is not None][0] += found
            score[model is not None][1] += 1
            missed += not found
            if not found and args.verbose:
                print(f"missed: {fault} in {name}", file=sys.stderr)
        texts = [f"{a}/{b}" if b else "-" for a, b in (score[True], score[False])]
        print(
            f"| {fault} | {'all' if all(a == b for a, b in score.values()) else 'NOT ALL'} "
            f"| {texts[0]} | {texts[1]} |",
            flush=True,
        )
    missed += calibrated(logs)
    print(f"\n{missed} missed, {false} false")
    return 1 if missed or false else 0


def calibrated(logs: list[tuple[str, Recording, SensorModel | None]]) -> int:
    """Correct the simulated logs with their truth: they must look calibrated."""
    found = count = 0
    for _, recording, model in logs:
        if model is None:
            continue
        true = model.correct(State(recording.time, recording.accel, recording.gyro))
        done = replace(recording, accel=true.accel, gyro=true.gyro, device=DeviceInfo())
        found += "calibrated" in {finding.kind for finding in audit(done).findings}
        count += 1
    print(
        f"| already calibrated | {'all' if found == count else 'NOT ALL'} | {found}/{count} | - |"
    )
    return count - found


if __name__ == "__main__":
    sys.exit(main())
