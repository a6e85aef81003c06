"""Is the simulator right, and how fast is it?

Right: the rate integrates to the orientation, pendulum and turntable match their closed forms, the
noise has its Allan deviation. Exits with 1 if one of these fails. Speed is only reported.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time as clock

import numpy as np
from scipy.integrate import solve_ivp

from calib.model import SensorModel
from calib.rotation import integrate_rate, mat_from_quat
from calib.simulate import simulate
from calib.simulation.library import MOTIONS, make_motion
from calib.simulation.motions import pendulum
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.simulation.turntable import turntable

G = 9.80665


def orientation_error(name: str) -> float:
    """Largest difference of the integrated rate from the orientation, extrapolated to no step."""
    motion = make_motion(name, rng=np.random.default_rng(1), duration=30.0, gravity=G)
    # At 5 kHz, so that what the integral itself leaves is far below the limit.
    found = []
    for rate in (2500.0, 5000.0):
        state = motion.state(np.arange(int(20 * rate)) / rate)
        found.append(state.mat_ns[0] @ mat_from_quat(integrate_rate(state.time, state.rate)))
    half = found[1][::2]
    true = motion.state(np.arange(len(half)) / 2500.0).mat_ns
    return float(np.abs(half + (half - found[0]) / 3 - true).max())


def pendulum_error() -> float:
    """Largest difference in specific force from a numerical solution, m/s², swinging by 140°."""
    length, distance, start = 0.7, 0.3, 2.45
    time = np.linspace(0.0, 20.0, 501)[1:]
    k = G / length
    solved = solve_ivp(
        lambda _, y: [y[1], -k * np.sin(y[0])],
        (0, 20),
        [start, 0.0],
        t_eval=time,
        rtol=1e-12,
        atol=1e-12,
        method="DOP853",
    )
    theta, rate = solved.y
    motion = pendulum(amplitude=start, length=length, distance=distance, hold=0.0, duration=20.0)
    force = motion.state(time).force
    along = G * np.cos(theta) + distance * rate**2
    across = G * np.sin(theta) * (1 - distance / length)
    return float(max(np.abs(force[:, 2] - along).max(), np.abs(force[:, 1] - across).max()))


def turntable_error() -> float:
    """Largest difference from ``w² r`` and g during a steady spin, m/s²."""
    motion = turntable((3.0,), offset=(0.1, 0.0, 0.0))
    spin = next(s for s in motion.segments if s.kind == "spin")
    force = motion.state(np.linspace(spin.start, spin.stop, 101)).force
    return float(np.abs(force - [-0.9, 0.0, G]).max())


def allan_ratios() -> list[tuple[str, float]]:
    """Found over stated Allan deviation: white noise, flicker floor, random walk."""
    step, seconds = 0.1, 50_000.0
    time = np.arange(0, seconds, step)
    rows = []
    for label, noise, average, stated in (
        ("white noise at 1 s", NoiseModel(gyro_noise_density=1e-3), 1.0, 1e-3 / np.sqrt(2)),
        (
            "bias instability at 100 s",
            NoiseModel(gyro_bias_instability=1e-3),
            100.0,
            np.sqrt(2 * np.log(2) / np.pi) * 1e-3,
        ),
        (
            "random walk at 100 s",
            NoiseModel(gyro_random_walk=1e-3),
            100.0,
            1e-3 * np.sqrt(100 / 3),
        ),
    ):
        gyro = noise.draw(time, rng=np.random.default_rng(2)).gyro
        m = round(average / step)
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(gyro, axis=0)]) * step
        second = total[2 * m :] - 2 * total[m:-m] + total[: -2 * m]
        rows.append((label, float(np.sqrt(np.mean(second**2) / 2) / average / stated)))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="length of the timed recordings")
    hours = parser.parse_args().hours
    failed = False
    print("| check | found | limit |\n|---|---|---|")
    checks = [(f"orientation, {name}", orientation_error(name), 1e-9) for name in MOTIONS]
    checks += [
        ("pendulum, m/s²", pendulum_error(), 1e-7),
        ("turntable, m/s²", turntable_error(), 1e-11),
    ]
    for label, found, limit in checks:
        failed |= not found < limit
        print(f"| {label} | {found:.1e} | {limit:.0e} |")
    for label, ratio in allan_ratios():
        failed |= not 0.9 < ratio < 1.1
        print(f"| Allan deviation over its formula, {label} | {ratio:.3f} | 0.9 to 1.1 |")
    print(f"\n| motion, {hours:g} h at 100 Hz | samples | CPU, s | million samples/s |")
    print("|---|---|---|---|")
    for name in MOTIONS:
        rng = np.random.default_rng(3)
        start = clock.process_time()
        motion = make_motion(name, rng=rng, duration=3600 * hours, gravity=G)
        recording = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
        took = clock.process_time() - start
        print(f"| {name} | {len(recording)} | {took:.2f} | {len(recording) / took / 1e6:.2f} |")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"\nPeak memory {peak:.2f} GB.")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
