"""Static detection: poses found, turns kept out of them, latency when live.

Simulated sensors with known truth (this generator shares no code with the project's simulator):
twelve rests of 1.5 to 6 s and turns of 20 to 180 degrees about any axis, smooth, trapezoidal and
abrupt, in 0.25 to 4 s; white noise, rounding and a bias walk; hands that tremble and wander; slow
turns (6 to 15 s); a constant vibration; other units; and logs in which nothing rests.

A sample of a turn is one between its beginning and its end whose rate is above 0.1 deg/s.

    python benchmarks/statics.py [--seeds N]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import numpy as np

from calib import Recording
from calib.live_statics import LiveStatics
from calib.statics import find_poses

G = 9.80665
ACCEL_DENSITY = 0.003  # m/s² per √(Hz/2): 0.02 m/s² per sample at 100 Hz
GYRO_DENSITY = 0.0003


@dataclass(frozen=True)
class Truth:
    recording: Recording
    poses: np.ndarray  # (k, 2) s
    turning: np.ndarray  # (n,) bool


def profile(kind: str, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return angle and rate, per unit, of a turn over 0..1."""
    if kind == "smooth":
        return s - np.sin(2 * np.pi * s) / (2 * np.pi), 1 - np.cos(2 * np.pi * s)
    if kind == "jerk":
        return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2
    if kind == "trapezoid":
        ramp = 0.2
        rate = np.minimum(1, np.minimum(s, 1 - s) / ramp) / (1 - ramp)
        early, late = np.minimum(s, ramp), np.clip(s - (1 - ramp), 0, ramp)
        middle = np.clip(s - ramp, 0, 1 - 2 * ramp)
        angle = (early**2 / (2 * ramp) + middle + late - late**2 / (2 * ramp)) / (1 - ramp)
        return angle, rate
    return s, np.ones_like(s)  # abrupt


def rotate(vec: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rodrigues' formula for one vector, one axis and many angles."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return vec * c + np.cross(axis, vec) * s + axis * (axis @ vec) * (1 - c)


def simulate(
    rng: np.random.Generator,
    *,
    rate: float,
    noise: float = 1.0,
    hand: bool = False,
    slow: bool = False,
    vibration: float = 0.0,
    k: int = 12,
    rests: tuple[float, float] = (1.5, 6.0),
    turns: tuple[float, float] = (0.25, 4.0),
    unit: tuple[float, float] = (1.0, 1.0),
    lsb: tuple[float, float] = (0.0006, 0.00013),
) -> Truth:
    up = rng.standard_normal(3)
    up /= np.linalg.norm(up)
    pieces, poses, edge = [], [], 0.0
    for index in range(k):
        rest = rng.uniform(*rests)
        poses.append((edge, edge + rest))
        edge += rest
        if index == k - 1:
            break
        length = rng.uniform(6.0, 15.0) if slow and index % 3 == 1 else rng.uniform(*turns)
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        least = 40 if slow else 20
        angle = np.radians(rng.uniform(least, 180)) * rng.choice((-1, 1))
        kind = rng.choice(("smooth", "jerk", "trapezoid", "abrupt"))
        pieces.append((edge, length, axis, angle, kind))
        edge += length
    time = np.arange(int(edge * rate)) / rate
    accel, gyro = np.empty((len(time), 3)), np.zeros((len(time), 3))
    turning = np.zeros(len(time), bool)
    before = 0
    for begin, length, axis, angle, kind in pieces:
        a, b = np.searchsorted(time, (begin, begin + length))
        accel[before:a] = up
        share, speed = profile(kind, (time[a:b] - begin) / length)
        accel[a:b] = rotate(up, axis, -angle * share)  # gravity turns the other way
        gyro[a:b] = axis * (angle * speed / length)[:, None]
        up = rotate(up, axis, np.array([-angle]))[0]
        turning[a:b] = np.abs(angle * speed / length) > np.radians(0.1)
        before = b
    accel[before:] = up
    accel *= G
    n = len(time)
    if hand:
        # Tremor at 8 to 12 Hz and a slow wander, as angles; the hand also moves a little.
        tilt = np.zeros((n, 3))
        for low, high, rms in ((8, 12, 0.0004), (0.3, 1.5, 0.003)):
            for axis_index in range(3):
                for _ in range(6):
                    f = rng.uniform(low, high)
                    tilt[:, axis_index] += (
                        rms * np.sqrt(2 / 6) * np.sin(2 * np.pi * (f * time + rng.uniform()))
                    )
        wander = np.gradient(tilt, time, axis=0)
        accel += (
            np.cross(accel, tilt)
            + 0.04 * rng.standard_normal(3) * np.sin(2 * np.pi * 9.3 * time)[:, None]
        )
        gyro += wander
    if vibration:
        accel += vibration * np.sin(2 * np.pi * 37.0 * time)[:, None] * np.array([0.4, 0.2, 1.0])
    root = np.sqrt(rate / 2)
    accel += noise * ACCEL_DENSITY * root * rng.standard_normal((n, 3))
    gyro += noise * GYRO_DENSITY * root * rng.standard_normal((n, 3))
    gyro += np.array([0.02, -0.01, 0.015]) + 2e-5 * np.cumsum(
        rng.standard_normal((n, 3)) / np.sqrt(rate), axis=0
    )
    accel = np.round(accel / lsb[0]) * lsb[0] * unit[0]
    gyro = np.round(gyro / lsb[1]) * lsb[1] * unit[1]
    return Truth(Recording(time, accel, gyro, "nominal"), np.array(poses), turning)


@dataclass
class Score:
    true: int = 0
    found: int = 0
    wrong: int = 0  # intervals that are no true pose, or span two
    split: int = 0  # true poses that were found as more than one
    turning: int = 0  # samples of a turn inside a pose
    covered: float = 0.0

    def add(self, truth: Truth) -> None:
        poses = find_poses(truth.recording)
        inside = np.zeros(len(truth.turning), bool)
        hits = np.zeros(len(truth.poses), int)
        for a, b, (t0, t1) in zip(poses.start, poses.stop, poses.interval, strict=True):
            inside[a:b] = True
            overlap = np.minimum(t1, truth.poses[:, 1]) - np.maximum(t0, truth.poses[:, 0])
            hit = overlap > 0
            hits[hit] += 1
            self.wrong += int(hit.sum() != 1)
        self.true += len(hits)
        self.found += int((hits > 0).sum())
        self.split += int((hits > 1).sum())
        self.turning += int((inside & truth.turning).sum())
        self.covered += inside.sum() / (~truth.turning).sum()


@dataclass
class Latency:
    """Delays, s, with which a live detector knows of rest and of motion."""

    rest: list[float]
    motion: list[float]

    def add(self, truth: Truth, rate: float) -> None:
        recording = truth.recording
        live = LiveStatics()
        resting = np.zeros(len(recording), bool)
        step = max(1, round(0.05 * rate))
        for first in range(0, len(recording), step):
            for event in live.update(recording.slice(first, min(first + step, len(recording)))):
                resting[np.searchsorted(recording.time, event.known) :] = event.resting
        edges = np.searchsorted(recording.time, truth.poses)
        for k, (begin, end) in enumerate(edges):
            known = np.flatnonzero(resting[begin:end])
            self.rest.append(known[0] / rate if known.size else np.inf)
            if k + 1 < len(edges):
                after = edges[k + 1, 0]
                known = np.flatnonzero(~resting[end:after])
                # A turn shorter than a second may be over before it must be known.
                self.motion.append(known[0] / rate if known.size else (after - end) / rate)


UNITS = {"SI": (1.0, 1.0), "g": (1 / G, 180 / np.pi), "LSB": (16384 / G, 16.4 * 180 / np.pi)}


CASES: dict[str, dict] = {
    **{f"{rate} Hz, noise x {noise:g}": {"rate": rate, "noise": noise}
       for rate in (8, 100, 1000, 8000) for noise in (0.3, 1, 10)},
    **{f"100 Hz, {unit}": {"rate": 100, "unit": size} for unit, size in UNITS.items()},
    **{f"{rate} Hz, hand-held": {"rate": rate, "hand": True} for rate in (8, 100, 1000)},
    "100 Hz, LSB, hand-held": {"rate": 100, "hand": True, "unit": UNITS["LSB"]},
    **{f"{rate} Hz, slow turns": {"rate": rate, "slow": True} for rate in (8, 100, 1000)},
    "100 Hz, vibration 1 m/s²": {"rate": 100, "vibration": 1.0},
    "100 Hz, one rest": {"rate": 100, "k": 1, "rests": (60.0, 60.0)},
}  # fmt: skip


def moving_only(rng: np.random.Generator, rate: float) -> dict[str, Recording]:
    """Return logs in which nothing ever rests."""
    time = np.arange(int(90 * rate)) / rate

    def turn(rates: np.ndarray) -> np.ndarray:
        up = np.empty((len(time), 3))
        u = np.array([0.1, -0.2, 0.97])
        for i, w in enumerate(rates / rate):
            up[i] = u
            u = u - np.cross(w, u)
            u /= np.linalg.norm(u)
        return up * G

    def smooth(rms: float, f: float) -> np.ndarray:
        out = np.zeros((len(time), 3))
        for _ in range(8):
            out += np.sin(
                2 * np.pi * (rng.uniform(0.2, 1, (1, 3)) * f * time[:, None] + rng.uniform(size=3))
            )
        return rms * out / 2

    logs = {}
    for name, rates, force in (
        (
            "sinusoid",
            np.column_stack((np.cos(0.31 * time), 0.3 * np.cos(0.19 * time), 0 * time)),
            0,
        ),
        ("hand waving", smooth(1.5, 1.5), smooth(1.5, 2.0)),
        ("walking", smooth(0.5, 2.0), smooth(2.0, 4.0)),
        ("steady turn", np.tile([0.3, 0.2, 0.4], (len(time), 1)), 0),
    ):
        accel = turn(rates) + force + ACCEL_DENSITY * 7 * rng.standard_normal((len(time), 3))
        gyro = rates + GYRO_DENSITY * 7 * rng.standard_normal((len(time), 3))
        logs[name] = Recording(time, accel, gyro, "nominal")
    return logs


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--seeds", type=int, default=40, help="recordings a case (a tenth at 8 kHz)"
    )
    args = parser.parse_args()
    print("| case | poses found | split | wrong | turn samples in a pose | rest used | ", end="")
    print("live: rest known after, s (worst) | motion (worst) |")
    print("|---|---|---|---|---|---|---|---|")
    true = found = wrong = turning = 0
    slowest = 0.0
    for name, options in CASES.items():
        score, latency = Score(), Latency([], [])
        count = max(3, args.seeds // (10 if options["rate"] >= 8000 else 1))
        for seed in range(count):
            truth = simulate(np.random.default_rng(seed), **options)
            score.add(truth)
            if seed < count // 4 + 1:
                latency.add(truth, options["rate"])
        true, found = true + score.true, found + score.found
        wrong, turning = wrong + score.wrong, turning + score.turning
        motion = (
            f"{np.median(latency.motion):.2f} ({max(latency.motion):.2f})" if latency.motion else ""
        )
        slowest = max(slowest, *latency.rest)
        if "slow" not in options:
            slowest = max(slowest, *latency.motion, 0.0)
        print(
            f"| {name} | {score.found} of {score.true} | {score.split} | {score.wrong} | "
            f"{score.turning} | {100 * score.covered / count:.0f} % | "
            f"{np.median(latency.rest):.2f} ({max(latency.rest):.2f}) | {motion} |"
        )
    print("\n| log that only moves | rate | poses |\n|---|---|---|")
    for rate in (8, 100, 400):
        for name, recording in moving_only(np.random.default_rng(1), rate).items():
            count = len(find_poses(recording))
            wrong += count
            print(f"| {name} | {rate} Hz | {count} |")
    print(
        f"\n{found} of {true} poses found ({100 * found / true:.2f} %, goal 99 %), {wrong} wrong, "
        f"{turning} samples of a turn inside a pose (goal 0), live latency at most {slowest:.2f} s "
        "(goal 1 s; a slow turn is known as motion when it has turned far enough)."
    )
    return 0 if found >= 0.99 * true and not wrong and not turning and slowest <= 1 else 1


if __name__ == "__main__":
    sys.exit(main())
