"""Samples that come twice: the one before again, or the last few, as a buffer has them.

Noise never repeats to the last bit in all channels at once, but for what rounding makes of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from calib.faults import BLOCK, FALSE_ALARM, ROBUST, block_sums, resolution
from calib.stillness import runs
from calib.types import BoolArray, FloatArray, IntArray

FAST = 8.0
"""Noises by which a channel moves on from sample to sample, so that none is as the one before."""

MOST = 32
"""Samples that come again together, at most: what a buffer or a packet holds."""

FEW = 8
"""Samples that are the last but one, up to which these tell nothing."""


def find_repeats(values: FloatArray, moving: BoolArray) -> IntArray:
    """Return samples that came just before: the last one, or the last few in their order.

    Parameters
    ----------
    values : (n, 6) array
    moving : (n,) array of bool
        Chance is not the same at rest and in motion.
    """
    key = _keys(values)
    again = _repeated(key)
    times = _together(key, values, moving) if again.any() else 1.0
    found = [_beyond_chance(values, moving, 1, again, times), _as_it_moved(values, again)]
    for lag in range(2, min(MOST, len(values) - 1) + 1):
        found.append(_beyond_chance(values, moving, lag, _replayed(key, lag)))
    return np.unique(np.concatenate(found))


def _keys(values: FloatArray) -> NDArray[np.uint64]:
    """Return a number for each sample (n, 6): the same where all channels are, and else another."""
    # No two zeros; the odds of a coincidence are 2**-64.
    bits = np.ascontiguousarray(values + 0.0).view(np.uint64)
    mixed = np.random.default_rng(0).integers(1 << 63, size=bits.shape[1], dtype=np.uint64)
    return np.asarray((bits ^ (bits >> np.uint64(29))) @ (2 * mixed + np.uint64(1)))


def _repeated(key: NDArray[np.uint64]) -> BoolArray:
    """Return which samples, from the second on, are the one before.

    Where nothing changes for longer than a block there is no noise to tell a repeat by; and if that
    is a fifth of the recording, as without noise rests are, pauses of any length are no repeats.
    """
    whole = np.asarray(key[1:] == key[:-1])
    start, stop = runs(whole)
    long = stop - start >= BLOCK
    if (stop - start)[long].sum() > 0.2 * len(whole):
        long = stop - start >= 8
    for begin, end in zip(start[long].tolist(), stop[long].tolist(), strict=True):
        whole[begin:end] = False
    return whole


def _replayed(key: NDArray[np.uint64], lag: int) -> BoolArray:
    """Return which samples, from ``lag`` on, are those of a block of ``lag`` that comes twice.

    What does not change comes again at any lag, and is no block.
    """
    out = np.zeros(len(key) - lag, bool)
    at = np.flatnonzero(key[lag:] == key[:-lag])
    if len(at) < lag:
        return out
    # Rounding repeats single ones by chance.
    cut = np.flatnonzero(np.diff(at) > 1) + 1
    begin, end = np.append(0, cut), np.append(cut, len(at))
    whole = end - begin >= lag
    begin, end = begin[whole], end[whole]
    still = np.append(0, np.cumsum(key[1:] == key[:-1]))
    block = still[at[end - 1] + lag] == still[at[begin]]
    for first, last in zip(at[begin[block]].tolist(), at[end[block] - 1].tolist(), strict=True):
        out[first : last + 1] = True
    return out


def _beyond_chance(
    values: FloatArray, moving: BoolArray, lag: int, which: BoolArray, times: float = 1.0
) -> IntArray:
    """Return the samples of those ``which`` from ``lag`` on, none if chance may explain them.

    Chance is that of rests, or of motion: these are looked at by themselves. It is so many
    ``times`` that of channels which are independent.
    """
    count = int(which.sum())
    if not count:
        return np.zeros(0, np.int64)
    expected = times * _expected(values, moving, lag)
    if pdtrc(count - 1, 1.2 * expected) > FALSE_ALARM / (1 if lag == 1 else MOST):
        return np.zeros(0, np.int64)
    return np.flatnonzero(which) + lag


def _expected(values: FloatArray, moving: BoolArray, lag: int) -> float:
    """Return how many samples are those of ``lag`` before by chance."""
    order = np.argsort(moving[lag:], kind="stable")
    chance = by_chance(values, lag, order=order)
    return float((block_sums(np.ones((len(order), 1)))[:, 0] * chance).sum())


def _together(key: NDArray[np.uint64], values: FloatArray, moving: BoolArray) -> float:
    """Return how many times as often all channels come again as they would independently.

    Noise of one supply is on several of them. That shows in samples that are the last but one, and
    not the last one: those are no repeats.
    """
    last = key[2:] == key[1:-1]
    seen = int(((key[2:] == key[:-2]) & ~last).sum())
    if seen <= FEW:
        return 1.0
    alone = _expected(values, moving, 2) * (1.0 - float(last.mean()))
    return max(1.0, seen / max(alone, 1e-12))


def _as_it_moved(values: FloatArray, which: BoolArray) -> IntArray:
    """Return the samples of those ``which`` from the second on that came while channels moved on.

    What goes on by `FAST` noises a sample is by chance as it was in one of 10⁷, and on two channels
    never. That it does, the steps before and after tell.
    """
    found = np.flatnonzero(which[1:-1]) + 2
    if not len(found):
        return found
    change = np.abs(np.diff(values, axis=0))
    usual = np.median(change, axis=0) * ROBUST / np.sqrt(2.0)
    moved = np.minimum(change[found - 2], change[found])
    fast = (moved > FAST * np.maximum(usual, resolution(values))).sum(axis=1) > 1
    return np.asarray(found[fast])


def by_chance(values: FloatArray, lag: int, *, order: IntArray | None = None) -> FloatArray:
    """Return the chance that a sample (n, c) is that of ``lag`` before, in each block.

    Rounding makes samples equal by chance. Channels are independent of each other, so that the
    chance of one is seen where *another* changes, and that of all is the product. That holds where
    all of them move, or none: an ``order`` of the samples from `lag` on puts these side by side.
    """
    equal = values[lag:] == values[:-lag]
    if order is not None:
        equal = equal[order]
    others = equal.sum(axis=1)[:, None] - equal < values.shape[1] - 1
    seen = block_sums(others)
    hits = block_sums(others & equal)
    chance = (hits + 0.5) / (seen + 1.0)
    informed = (seen >= 8).all(axis=1)
    if informed.any():
        chance[~informed] = np.quantile(chance[informed], 0.9, axis=0)
    return np.asarray(chance.prod(axis=1))
