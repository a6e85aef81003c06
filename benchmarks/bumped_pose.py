"""One pose in ten bumped by 5 to 50 mg: is it found, and is the rest recovered as without it?

Poses of a few seconds (1 mm/s² of noise in the mean) that differ by 2 mm/s² more, as real ones do
(temperature, nonlinearity). A tenth of them is displaced by 5 to 50 mg in a random direction. What
counts is the length of the reading: a bump along the surface of the ellipsoid turns the pose, which
|a| = g does not mind. "visible" bumps move the length by more than 6 standard deviations.

    python benchmarks/bumped_pose.py [--runs N]
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from calib.model import Triad
from calib.poses import Poses
from calib.solvers import accel_solvers
from calib.solvers.quadric import parameters_of

GRAVITY = 9.80665
MG = GRAVITY / 1000
WHITE, BETWEEN = 1e-3, 2e-3
TRUE = Triad.from_matrix(
    np.array([[1.02, 0, 0], [0.01, 0.98, 0], [0.005, -0.008, 1.01]]), np.array([0.3, -0.6, 0.3])
)
TRUTH = parameters_of(TRUE.matrix, TRUE.bias)
GOAL_FOUND, GOAL_RATIO = 0.97, 1.15


def trial(n: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    direction = rng.standard_normal((n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    accel = TRUE.distort(GRAVITY * direction) + WHITE * rng.standard_normal((n, 3))
    accel += BETWEEN * rng.standard_normal((n, 1)) * direction
    bumped = rng.choice(n, n // 10, replace=False)
    push = rng.standard_normal((len(bumped), 3))
    push *= rng.uniform(5 * MG, 50 * MG, (len(bumped), 1)) / np.linalg.norm(push, axis=1)[:, None]
    seen = np.abs(np.einsum("ij,ij->i", push, direction[bumped])) > 6 * np.hypot(WHITE, BETWEEN)
    disturbed = accel.copy()
    disturbed[bumped] += push
    return accel, disturbed, bumped, seen


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    args = parser.parse_args()
    solve = accel_solvers()["maximum_likelihood"].solve
    print(
        "| poses | bumped | visible bumps found | false | rms error without them | with | plain |"
    )
    print("|---|---|---|---|---|---|---|")
    reached = True
    for n in (20, 30, 50, 100):
        rng = np.random.default_rng(n)
        found = visible = wrong = 0
        squares = np.zeros(3)
        for _ in range(args.runs):
            accel, disturbed, bumped, seen = trial(n, rng)
            rest = np.delete(accel, bumped, axis=0)
            reference = solve(Poses.from_vectors(rest, sigma=WHITE), gravity=GRAVITY)
            fit = solve(Poses.from_vectors(disturbed, sigma=WHITE), gravity=GRAVITY)
            plain = accel_solvers()["exact"].solve(
                Poses.from_vectors(disturbed, sigma=WHITE), gravity=GRAVITY
            )
            out = {round(e.interval[0]) for e in fit.excluded}
            visible += int(seen.sum())
            found += sum(int(k) in out for k in bumped[seen])
            wrong += len(out - set(bumped.tolist()))
            scale = reference.standard_errors
            for j, one in enumerate((reference, fit, plain)):
                # Bounded, so that one run in which a bump was missed cannot decide the mean.
                squares[j] += np.minimum(np.square((one.values - TRUTH) / scale), 100).mean()
        error = np.sqrt(squares / args.runs)
        reached &= found >= GOAL_FOUND * visible and (n < 30 or error[1] <= GOAL_RATIO * error[0])
        print(
            f"| {n} | {n // 10} | {found} of {visible} | {wrong} in {args.runs} runs | "
            f"{error[0]:.2f} | {error[1]:.2f} | {error[2]:.2f} |"
        )
    print(
        "\nErrors are in standard errors of the fit without the bumped poses; `plain` is `exact`, "
        "which keeps them."
    )
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
