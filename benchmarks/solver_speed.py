"""How long an accelerometer solve takes, beside what a user would pick instead, in the same run.

`imucal` (Ferraris, six faces and three turns) is timed if it is installed (`pip install imucal`).
The iterative fit is `scipy.optimize.least_squares` on |K (a - b)| - g from an ideal sensor, with
numeric derivatives, as most scripts do it. Speed figures do not fail the run; read the ratios.

    python benchmarks/solver_speed.py [--repeat N]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # what the commands set, too

import numpy as np
from scipy.optimize import least_squares

from calib.model import Triad
from calib.poses import Poses
from calib.solvers import accel_solvers

GRAVITY = 9.80665
TRUE = Triad.from_matrix(
    np.array([[1.02, 0, 0], [0.01, 0.98, 0], [0.02, 0.03, 1.01]]), np.array([0.3, -0.6, 0.3])
)
GOALS = {("exact", 50): 1e-3, ("exact", 10**6): 0.1, ("maximum_likelihood", 10**6): 2.0}


def readings(n: int, rng: np.random.Generator) -> np.ndarray:
    direction = rng.standard_normal((n, 3))
    direction *= GRAVITY / np.linalg.norm(direction, axis=1)[:, None]
    return TRUE.distort(direction) + 0.01 * rng.standard_normal((n, 3))


def iterative(accel: np.ndarray) -> np.ndarray:
    """Return nine parameters by scipy's trust-region least squares."""
    rows, columns = np.tril_indices(3)

    def residual(x: np.ndarray) -> np.ndarray:
        matrix = np.zeros((3, 3))
        matrix[rows, columns] = x[3:]
        return np.linalg.norm((accel - x[:3]) @ matrix.T, axis=1) - GRAVITY

    start = np.concatenate((np.zeros(3), np.eye(3)[rows, columns]))
    return least_squares(residual, start).x


def imucal_solve(n: int, rng: np.random.Generator) -> Callable[[], object] | str:
    """Return a call of imucal on n samples in all, or why there is none."""
    try:
        from imucal import FerrarisCalibration, FerrarisSignalRegions
    except ImportError:
        return "not installed (`pip install imucal`)"
    each = max(2, n // 9)
    faces = [s * e for e in np.eye(3) for s in (1.0, -1.0)]
    accel = [TRUE.distort(GRAVITY * np.tile(f, (each, 1))) for f in faces]
    accel = [a + 0.01 * rng.standard_normal(a.shape) for a in accel]
    still = [0.01 * rng.standard_normal((each, 3)) for _ in faces]
    turns = [np.tile(360.0 * 100 / each * e, (each, 1)) for e in np.eye(3)]
    regions = FerrarisSignalRegions(*accel, *still, *(a * 0 for a in accel[:3]), *turns)
    solver = FerrarisCalibration()
    return lambda: solver.compute(regions, 100.0, from_acc_unit="m/s^2", from_gyr_unit="deg/s")


def best(function: Callable[[], object], repeat: int) -> float:
    """Return the shortest of some CPU times, s."""
    times = []
    for _ in range(repeat):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
        if sum(times) > 20:
            break
    return min(times)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args()
    rng = np.random.default_rng(1)
    print("| readings | method | ms of CPU | x `exact` | goal, ms |")
    print("|---|---|---|---|---|")
    for n in (50, 10**4, 10**6):
        accel = readings(n, rng)
        poses = Poses.from_vectors(accel, sigma=0.01)
        methods: dict[str, Callable[[], object] | str] = {
            name: lambda s=accel_solvers()[name].solve, p=poses: s(p, gravity=GRAVITY)
            for name in ("exact", "published", "maximum_likelihood")
        }
        methods["scipy least_squares"] = lambda a=accel: iterative(a)
        methods["imucal, six faces"] = imucal_solve(n, rng)
        repeat = args.repeat * (20 if n == 50 else 1)
        first = 0.0
        for name, call in methods.items():
            if isinstance(call, str):
                print(f"| {n} | {name} | skipped: {call} | | |")
                continue
            taken = best(call, repeat if "least" not in name or n < 10**6 else 1)
            first = first or taken
            goal = GOALS.get((name, n))
            label = f"`{name}`" if name in accel_solvers() else name
            print(
                f"| {n} | {label} | {1e3 * taken:.3g} | {taken / first:.3g} | "
                f"{'' if goal is None else f'{1e3 * goal:g}'} |"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
