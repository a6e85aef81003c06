"""Channels that stand still for a moment while the sensor moves: a register that was not read anew.

`calib.faults.find_stuck` finds what stands still for so long that motion alone tells. A few samples
are told by noise: even where nothing moves it makes so many equal values in a row only so often,
and what stands still while the signal goes on has to jump to where it is by then.
"""

from __future__ import annotations

import numpy as np
from scipy.special import pdtrc, stdtr

from calib.decimals import counts_at
from calib.faults import FALSE_ALARM, noise_at_rest, resolution
from calib.stillness import runs
from calib.types import BoolArray, FloatArray, IntArray

PART = 256
"""Samples at rest over which the share of equal neighbours is estimated."""

LOUD = 0.9
"""Quantile of the parts at rest whose share of equal neighbours is taken: where a signal is between
two counts makes it more or less."""

PEAK = np.sqrt(2.0)
"""Density of a Gaussian at its peak over its mean: the value that most samples have is met again
this much more often than values are on average."""

NEARBY = 16
"""Samples on either side that tell how a channel bends without a fault."""

FREEDOM = 3.0
"""Degrees of freedom of how a signal bends: motion jerks, more often than a Gaussian does."""

SHORTEST = 3
"""Samples that are equal in a run."""


def find_frozen(
    values: FloatArray, moving: BoolArray, *, clipped: BoolArray, known: BoolArray
) -> list[tuple[int, int, int]]:
    """Return stretches ``(channel, start, stop)`` of motion in which a channel is frozen.

    Of k samples in motion the chance to be equal is at most ``q**(k - 1)``, of which `q` is the
    chance of the likeliest value at rest: motion only makes it less. Where the channel jumps at an
    end of the run, by more than it bends beside it, that is as unlikely again. Runs that chance
    makes at least once in a recording are none; of the others there must be so many that chance
    makes as many in fewer than `FALSE_ALARM` of recordings.

    Parameters
    ----------
    values : (n, 6) array
    moving : (n,) array of bool
        Where no rest is.
    clipped : (n, 6) array of bool
        Where a channel is at its limit; there it stands still for as long as it is beyond.
    known : (n,) array of bool
        What is not looked at: repeated samples, and what is stuck for longer.
    """
    out: list[tuple[int, int, int]] = []
    rest = ~(moving[1:] | moving[:-1])
    step = resolution(values)
    floor, held = np.maximum(np.sqrt(6.0) * noise_at_rest(values), step), counts_at(values, step)
    told = np.append(0, np.cumsum(known))
    for c in range(values.shape[1]):
        own = values[:, c]
        equal = own[1:] == own[:-1]
        chance = min(1.0, PEAK * _share(equal[rest]))
        start, stop = runs(equal & moving[1:] & moving[:-1])
        stop = stop + 1
        some = (stop - start >= SHORTEST) & (told[stop] == told[start])
        # What is at its range's end is clipped, however short it was there.
        some &= (own[start] < own.max()) & (own[start] > own.min()) & ~clipped[start, c]
        if rest.any():  # where counts are coarser than at rest, chance makes more
            some &= held[start, c] <= np.median(held[1:][rest, c])
        start, stop = start[some], stop[some]
        length = stop - start
        often = moving.sum() / np.sqrt(length) * chance ** (length - 1)
        rare = often < 1.0
        start, stop, often = start[rare], stop[rare], often[rare]
        if not len(start):
            continue
        often = often * _bend_chance(own, start, stop, float(floor[c]))
        order = np.argsort(often)
        number = np.arange(1, len(order) + 1)
        p = pdtrc(number - 1, often[order]) * len(order) * values.shape[1]
        found = np.flatnonzero(p < FALSE_ALARM)
        if len(found):
            which = np.sort(order[: found[-1] + 1])
            out += [(c, int(start[k]), int(stop[k])) for k in which]
    return out


def _share(equal: BoolArray) -> float:
    """Return how often neighbours at rest are equal: in most parts of it no more often."""
    if len(equal) < PART:
        return 1.0
    parts = equal[: len(equal) // PART * PART].reshape(-1, PART).mean(axis=1)
    return float(max(np.quantile(parts, LOUD), 1.0 / len(equal)))


def _bend_chance(channel: FloatArray, start: IntArray, stop: IntArray, floor: float) -> FloatArray:
    """Return how rarely a channel bends as much as at the sharper end of each run (k,).

    At an end it bends by the jump there, less the step beyond: a signal that begins to move after
    a pause does not bend by that.
    """
    n = len(channel)
    bend = np.abs(np.diff(channel, 2, prepend=channel[:1], append=channel[-1:]))
    out = np.ones(len(start))
    for k, (a, b) in enumerate(zip(start.tolist(), stop.tolist(), strict=True)):
        beside = np.concatenate(
            (bend[max(a - 1 - NEARBY, 0) : max(a - 1, 0)], bend[b + 1 :][:NEARBY])
        )
        if a < 2 or b > n - 2 or not len(beside):
            continue
        scale = max(floor, float(np.sqrt(np.mean(np.square(beside)))))
        out[k] = 2.0 * stdtr(FREEDOM, -max(bend[a - 1], bend[b]) / scale)
    return out
