"""How often does evidence reach its threshold where there is nothing but noise of known size?

The residual of a 30-pose bench recording is replaced by normal errors with exactly the covariance
that the diagnosis works with, many times, and the e-value that anything is left is taken of each:
the average of the Bayes factors of all candidates. Its mean is at most 1 (Markov's inequality then
bounds the shares below by 1/E); how much rarer it is than that bound is what this counts.

``--draws`` and ``--seed``; exit status 1 if more than 0.5 % reach the threshold of a claim.
"""

from __future__ import annotations

import argparse
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.special import logsumexp

from calib.mismatch.arrow import Factor
from calib.mismatch.grid import make_grid
from calib.mismatch.noise import Whitener, expected_levels, make_whitener
from calib.mismatch.ranking import CLAIM, fitted, make_stack
from calib.mismatch.rows import Rows
from calib.mismatch.score import Stack
from calib.mismatch.selfmode import SelfProblem
from calib.model import SensorModel
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

GRAVITY = 9.80665
THRESHOLDS = (2, CLAIM, 10, 20, 100)
MOST = 0.005


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=4)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    motion = bench_protocol(rng, poses=30, power_on=0.0)
    recording = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    grid = make_grid(recording, find_poses(recording))
    rows = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False).rows()
    stack = make_stack(rows, skip=(), reference=False)
    logs = e_values(rows, stack, rng, args.draws)
    print(f"{len(stack.candidates)} candidates, {args.draws} draws of normal errors")
    print(f"mean e-value {np.exp(logs).mean():.2f} (at most 1 by construction)\n")
    print("| e-value | reached by | Markov's bound |")
    print("|---|---|---|")
    for threshold in THRESHOLDS:
        share = np.mean(logs > np.log(threshold))
        print(f"| {threshold:.0f} | {share:.2%} | {1 / threshold:.0%} |")
    return int(np.mean(logs > np.log(CLAIM)) > MOST)


def e_values(rows: Rows, stack: Stack, rng: np.random.Generator, draws: int) -> np.ndarray:
    """Return the log e-values of draws of normal errors."""
    variance = rows.white_diagonal
    whitener = make_whitener(rows, expected_levels(rows), variance, fitted(rows, []))
    weight = np.log([c.weight for c in stack.candidates])
    # Whitened once: all draws share it.
    plain = Stack(len(rows.residual))
    plain.columns.add(whitener.project(stack.columns.take(np.arange(len(stack.columns)))))
    plain.candidates = stack.candidates
    unit = Whitener(Factor.unit(rows.n_dense), np.ones(len(variance)), whitener.basis, rows.n_dense)
    out = np.empty(draws)
    for k in range(draws):
        y = rng.normal(size=len(rows.residual))
        y -= whitener.basis @ (whitener.basis.T @ y)
        out[k] = logsumexp(plain.log_bayes_factors(unit, y) + weight)
    return out


if __name__ == "__main__":
    sys.exit(main())
