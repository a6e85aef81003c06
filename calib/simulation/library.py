"""The motions by their names, as ``imu-cal simulate --motion`` offers them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.motions import paper_sinusoid, pendulum, thermal_soak
from calib.simulation.turntable import RECORD_PLAYER, turntable

Maker = Callable[[np.random.Generator, float, float], Motion]


def _bench(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    # Poses of 3 to 6 s and turns of 0.8 to 2.5 s: so many surely last long enough.
    poses = 2 + int(duration / 3.8)
    return bench_protocol(rng, poses=poses, gravity=gravity).until(duration)


def _hand_held(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    poses = 2 + int(duration / 3.8)
    return bench_protocol(rng, poses=poses, hold_tremor=0.1, gravity=gravity).until(duration)


def _vibrating(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    poses = 2 + int(duration / 3.8)
    return bench_protocol(rng, poses=poses, vibration=2.0, gravity=gravity).until(duration)


def _paper(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    return paper_sinusoid(duration=duration, gravity=gravity)


def _rate_table(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    rates = np.radians([100.0, -100.0, 200.0, -200.0])
    faces = ("+z", "-z", "+x", "-x", "+y", "-y")
    spin = max(1.0, (duration - 6 * (5 * 2.0 + 8 * 1.0) - 5 * 3.0) / 24)
    return turntable(
        tuple(rates), faces=faces, rest=2.0, ramp=1.0, spin=spin, gravity=gravity
    ).until(duration)


def _record_player(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    spin = max(1.0, duration - 2 * 5.0 - 2 * 2.0)
    return turntable(RECORD_PLAYER, spin=spin, gravity=gravity).until(duration)


def _pendulum(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    return pendulum(duration=duration, gravity=gravity)


def _thermal(rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    # Four dwells and three ramps of one and a half.
    dwell = duration / 8.5
    motion = thermal_soak(dwell=dwell, ramp=1.5 * dwell, lag=0.1 * dwell, gravity=gravity)
    return motion.until(duration)


MOTIONS: Mapping[str, tuple[str, Maker]] = {
    "bench": ("static poses, hand turns between them, a warming sensor", _bench),
    "hand-held": ("the same, held still in the hand instead of laid down", _hand_held),
    "vibrating": ("the bench, shaken by 2 m/s² rms during a third of the poses", _vibrating),
    "paper": ("the paper's sinusoidal attitudes", _paper),
    "rate-table": ("six faces at +-100 and +-200 dps, off the centre", _rate_table),
    "record-player": ("33 1/3 rpm, off the centre", _record_player),
    "pendulum": ("held, let go, swinging", _pendulum),
    "thermal": ("one pose through 25, 60, -10 and 25 °C", _thermal),
}
"""Name: what it is, and a function of (rng, duration in s, gravity in m/s²)."""


def make_motion(name: str, *, rng: np.random.Generator, duration: float, gravity: float) -> Motion:
    """Return a motion by its name, as long as asked.

    Raises
    ------
    ValueError
        If there is no such motion, or the duration is not positive.
    """
    if name not in MOTIONS:
        raise ValueError(f"`name` must be one of {', '.join(MOTIONS)}, got {name!r}")
    if not (np.isfinite(duration) and duration > 0):
        raise ValueError(f"`duration` must be positive and finite, got {duration}")
    return replace(MOTIONS[name][1](rng, duration, gravity), name=name)
