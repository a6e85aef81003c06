"""How often does evidence reach its threshold where there is nothing but noise of known size?

The residual of a 30-pose bench recording is replaced by normal errors with exactly the covariance
that the diagnosis works with, many times, and the e-value that anything is left is taken of each:
the average of the Bayes factors of all candidates. Its mean is at most 1 (Markov's inequality then
bounds the shares below by 1/E); how much rarer it is than that bound is what this counts. A claim
rests on the candidates that share a channel with what explains most: these are counted alone, too.

``--draws`` and ``--seed``; exit status 1 if more than 0.5 % reach the threshold of a claim.
"""

from __future__ import annotations

import argparse
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from concealed import grid_of
from scipy.special import logsumexp

from calib.mismatch.hypotheses.candidates import Alike as Make
from calib.mismatch.hypotheses.candidates import Sums
from calib.mismatch.hypotheses.factors import SCALES, log_shares, present_factors
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.shared import DIRECTIONS, one_course
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.ranking import CLAIM, make_stack
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665
THRESHOLDS = (CLAIM, 5, 10, 100)
MOST = 0.005
TOGETHER = 250
"""Draws that are scored at a time."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=4)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    motion = bench_protocol(rng, poses=30, power_on=0.0)
    recording = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    rows = SelfProblem(grid_of(recording), None, gravity=GRAVITY, full_gyro=False).rows()
    stack = make_stack(rows, skip=(), reference=False)
    logs, alike = e_values(rows, stack, rng, args.draws)
    print(f"{len(stack)} candidates, {args.draws} draws of normal errors")
    print(f"mean e-value {np.exp(logs).mean():.2f} (at most 1 by construction)\n")
    print("| e-value | reached by | on channels of the strongest | Markov's bound |")
    print("|---|---|---|---|")
    for threshold in THRESHOLDS:
        share, same = (np.mean(values > np.log(threshold)) for values in (logs, alike))
        print(f"| {threshold:g} | {share:.2%} | {same:.2%} | {1 / threshold:.0%} |")
    return int(np.mean(alike > np.log(CLAIM)) > MOST)


def e_values(
    rows: Rows, stack: Stack, rng: np.random.Generator, draws: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the log e-values of draws of normal errors: of all, and on the strongest's channels.

    The second is that of candidates which share a channel with those that explain most.
    """
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    columns = whitener.project(stack.columns.take(np.arange(len(stack.columns))))
    known = list(hypotheses(stack, columns.T @ columns))
    where = list(dict.fromkeys(each.channels for each in known))
    shared = np.array([[bool(set(a) & set(b)) for b in where] for a in where], float)
    out, alike = np.zeros(draws), np.zeros(draws)
    for first in range(0, draws, TOGETHER):
        some = slice(first, min(first + TOGETHER, draws))
        y = rng.normal(size=(some.stop - first, len(rows.residual))).T
        y -= whitener.basis @ (whitener.basis.T @ y)
        match = columns.T @ y
        parts = np.zeros((len(where), y.shape[1]))
        for each in known:
            parts[where.index(each.channels)] += each.e_value(match)
        out[some] = parts.sum(axis=0)
        alike[some] = np.take_along_axis(shared @ parts, parts.argmax(axis=0)[None], axis=0)[0]
        if not first:
            # All draws at once are a sum of their own: the first is scored by the engine as well.
            engine = stack.log_bayes_factors(whitener, y[:, 0])
            weight = stack.weight
            assert np.isclose(np.log(out[0]), logsumexp(engine + weight), atol=1e-6)
    return np.log(out), np.log(alike)


@dataclass(frozen=True)
class Alike:
    """Hypotheses of some columns, each in directions that are independent of each other.

    Parameters
    ----------
    channels : tuple of str
        Where they all show.
    weight : (n,) array
        Prior probabilities.
    power : (n, r) array
        Of each direction.
    columns : array of int
        Columns of the stack, k for all of them or (n, k) for each its own.
    directions : (n, r, k) array, or a sparse (n, k) one of sums
    present : bool
        Whether the one coefficient is 1 by nature.
    sought : (n,) array of bool
        Whether they are looked for at sizes that would show.
    """

    channels: tuple[str, ...]
    weight: np.ndarray
    power: np.ndarray
    columns: np.ndarray
    directions: Any
    present: bool
    sought: np.ndarray

    def e_value(self, match: np.ndarray) -> np.ndarray:
        """Return the weighted sum of Bayes factors, from what columns have of d residuals, (d,)."""
        n, r = self.power.shape
        if self.columns.ndim == 2:
            along = self.directions @ match[self.columns]
        else:
            along = self.directions.reshape(n * r, -1) @ match[self.columns]
        along = along.reshape(n, r, -1)
        if self.present:
            return self.weight @ np.exp(present_factors(self.power, along[:, 0]))
        square = np.square(SCALES)[:, None]
        strength = square * self.power[:, None]
        gain = (0.5 * square / (1.0 + strength)) @ np.square(along)
        shares = np.exp(log_shares(self.power.mean(axis=1), self.sought)).T
        scale = shares * np.exp(-0.5 * np.log1p(strength).sum(axis=2))
        np.exp(gain, out=gain)
        return (self.weight[:, None] * scale).ravel() @ gain.reshape(n * len(SCALES), -1)


def hypotheses(stack: Stack, gram: np.ndarray) -> Iterator[Alike]:
    """Yield all of a stack's candidates, of which the Gram matrix of all columns is known."""
    for bank in stack.banks:
        for code, channels in enumerate(bank.channels):
            for make in bank.made(bank.channel == code):
                weight = np.exp(bank.weight[make.which])
                if isinstance(make, Sums):
                    inner = make.pick @ gram[np.ix_(make.columns, make.columns)]
                    power = np.asarray(make.pick.multiply(inner).sum(axis=1))
                    power = np.maximum(power, 0.0)
                    rivals = np.zeros(len(power), bool)
                    yield Alike(channels, weight, power, make.columns, make.pick, False, rivals)
                else:
                    sought = bank.sought[make.which]
                    if not bank.shared[make.which].any():
                        yield from _directions(make, channels, weight, gram, sought)
                        continue
                    # A course on each axis, or one that they share: both as likely.
                    yield from _directions(make, channels, weight / 2, gram, sought)
                    weight = weight / 2 / len(DIRECTIONS)
                    for share in DIRECTIONS:
                        one = replace(make, mixing=one_course(make.mixing, share))
                        yield from _directions(one, channels, weight, gram, sought)


def _directions(
    make: Make,
    channels: tuple[str, ...],
    weight: np.ndarray,
    gram: np.ndarray,
    sought: np.ndarray,
) -> Iterator[Alike]:
    """Yield candidates of one make in their independent directions."""
    own = make.columns[make.index]
    for first, last, runs in make.parts:
        # Those of the same columns together, or all where each has few of its own.
        for start, stop in [(first, last)] if make.mixing is None else runs:
            part = slice(start, stop)
            shared = own[start] if make.mixing is not None else own[part]
            inner = gram[shared[..., :, None], shared[..., None, :]]
            if make.mixing is not None:
                inner = np.swapaxes(make.mixing[part], 1, 2) @ inner @ make.mixing[part]
            power, vectors = np.linalg.eigh(inner)
            directions = np.swapaxes(vectors, 1, 2)
            if make.mixing is not None:
                directions = directions @ np.swapaxes(make.mixing[part], 1, 2)
            for kind in (False, True):
                mine = make.present[part] == kind
                if mine.any():
                    yield Alike(
                        channels,
                        weight[part][mine],
                        np.maximum(power[mine], 0.0),
                        shared[mine] if shared.ndim == 2 else shared,
                        directions[mine],
                        kind,
                        sought[part][mine],
                    )


if __name__ == "__main__":
    sys.exit(main())
