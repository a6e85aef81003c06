"""What a recording of `_independent_generator.py` is judged beside: a simulation, or a reference.

Each reference is a file on a clock and at a rate of its own, that begins later and ends earlier
than the recording. Nothing here comes from the project that it judges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from _independent_generator import (
    AXES,
    DPS,
    Motion,
    exponential,
    logarithm,
    matrix,
    multiply,
    noise,
    write_csv,
)


@dataclass(frozen=True)
class Reference:
    """Option of the command line, and what is true of the two as they are mounted."""

    option: str
    allowed: tuple[str, ...] = ()
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)


def _moments(rng: np.random.Generator, motion: Motion, rates: tuple[float, ...]) -> np.ndarray:
    late, early = rng.uniform(0.0, 2.5, 2)
    step = 1 / float(rng.choice(rates))
    return np.arange(motion.time[0] + late, motion.time[-1] - early, step)


def _at(motion: Motion, signals: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return signals of the fine grid at these times.

    A cubic through four points, as far apart as a hundredth of what trembles, errs by less than
    1e-6.
    """
    place = (time - motion.time[0]) / motion.step
    k = np.clip(place.astype(int), 1, len(motion.time) - 3)
    u = (place - k)[:, None]
    weights = (-u * (u - 1) * (u - 2) / 6, (u + 1) * (u - 1) * (u - 2) / 2,
               -(u + 1) * u * (u - 2) / 2, (u + 1) * u * (u - 1) / 6)  # fmt: skip
    return sum((w * signals[k + i] for i, w in enumerate(weights, start=-1)), np.zeros(1))


def simulation(rng: np.random.Generator, motion: Motion, path: Path) -> Reference:
    """Write what a perfect sensor has, as CSV."""
    time = _moments(rng, motion, (50.0, 80.0, 100.0, 200.0))
    output = _at(motion, np.hstack((motion.force, motion.rate)), time)
    write_csv(path, time + float(rng.choice([0.0, 1000.0, -37.2])), output, None, rng)
    return Reference("--against")


def noisy(rng: np.random.Generator, motion: Motion, path: Path) -> Reference:
    """Write what a perfect sensor has but for noise, which is as loud as the part's, as CSV."""
    time = _moments(rng, motion, (50.0, 100.0, 200.0))
    own = replace(motion, setting=replace(motion.setting, rate=1 / (time[1] - time[0])))
    output = _at(motion, np.hstack((motion.force, motion.rate)), time)
    output = output + noise(rng, own, len(time))
    write_csv(path, time + float(rng.choice([0.0, 1000.0, -37.2])), output, None, rng)
    return Reference("--against")


def captured(rng: np.random.Generator, motion: Motion, path: Path) -> Reference:
    """Write orientation and position of markers near the sensor, with noise, as CSV."""
    time = _moments(rng, motion, (60.0, 100.0, 120.0, 200.0, 240.0))
    place = (time - motion.time[0]) / motion.step
    k = np.clip(place.astype(int), 0, len(motion.time) - 2)
    turn = logarithm(multiply(motion.quaternion[k] * [1, -1, -1, -1], motion.quaternion[k + 1]))
    q = multiply(motion.quaternion[k], exponential((place - k)[:, None] * turn))
    arm, mounting = rng.normal(0, 0.05, 3), exponential(rng.normal(0, 0.3, 3))
    position = _at(motion, motion.position, time) + matrix(q) @ arm
    position += rng.uniform(1e-4, 4e-4) * rng.normal(size=position.shape)
    shaken = exponential(rng.uniform(0.03, 0.15) * DPS * rng.normal(size=position.shape))
    table = np.column_stack((time + rng.uniform(-100, 100), multiply(multiply(q, shaken), mounting),
                             position))  # fmt: skip
    if rng.random() < 0.3:
        lost = rng.uniform(time[0], time[-1] - 3.0)
        table = table[(time < lost) | (time > lost + rng.uniform(0.2, 2.0))]
    np.savetxt(path, table, delimiter=",", fmt="%.9g", header="time,qw,qx,qy,qz,x,y,z", comments="")
    return _mounted(-arm)


def imu(rng: np.random.Generator, motion: Motion, path: Path) -> Reference:
    """Write what another IMU on the same body has, mounted apart and turned, as CSV."""
    time = _moments(rng, motion, (50.0, 64.0, 100.0, 200.0))
    arm, mounting = rng.normal(0, 0.03, 3), matrix(exponential(rng.normal(0, 0.3, 3)))
    rate = motion.rate
    spin = np.gradient(rate, motion.step, axis=0)
    force = motion.force + np.cross(rate, np.cross(rate, arm)) + np.cross(spin, arm)
    output = _at(motion, np.hstack((force @ mounting, rate @ mounting)), time)
    own = replace(motion, setting=replace(motion.setting, rate=1 / (time[1] - time[0])))
    output = output + noise(rng, own, len(time))
    write_csv(path, time + rng.uniform(-100, 100), output, None, rng)
    return _mounted(-arm)


def _mounted(arm: np.ndarray) -> Reference:
    return Reference(
        "--reference",
        ("time_offset", "reference_misalignment", "accel_lever_arm"),
        {"accel_lever_arm": {f"r{a}": float(v) for a, v in zip(AXES, arm, strict=True)}},
    )


REFERENCES: dict[str, Callable[[np.random.Generator, Motion, Path], Reference]] = {
    "beside": simulation,
    "noisy": noisy,
    "captured": captured,
    "imu": imu,
}
