"""Rests in which a sensor is moved without being turned: they are no rest while that lasts.

A sensor that is pushed along a bench, or lifted and put back, is accelerated, and then braked. No
gyroscope shows that. Both are in its specific force, which is afterwards what it was before, and
whose integral, the speed, is none again. That tells a push from a bias that steps or is off for a
while, and that the gyroscope saw no such turn tells it from a tilt, which stays.

Means over `SCALES` are compared with those on both sides of them, so that what drifts or leans
slowly is not seen, and with how they scatter in most rests of the recording, and in a rest that
sways throughout by as much more as that does: it is in a hand.
"""

from __future__ import annotations

import numpy as np

from calib.gravity import STANDARD_GRAVITY
from calib.stillness import Blocks, Units, moving_mean, spans_of, spill, sway
from calib.types import FloatArray

SCALES = (2, 5, 10, 20)
"""Blocks in such a mean: half of a push, of 0.2 to 2 s."""

STANDS_OUT, ALSO = 7.0, 4.0
"""Standard deviations on one axis from which the length of a vector of three is no chance, and
from which it is none beside such."""

LEAST = 0.01
"""m over which a sensor is carried at least: a knock or a machine moves it by far less."""

QUARTILE, CHI_SQUARED = 0.25, 1.213
"""Share of the means that tell the scatter of a rest, and what of chi-square with three degrees of
freedom is below that: the larger part of what is between two turns may be a push."""

BESIDE, FEWEST = 10, 3
"""Blocks before and after a push, at most and at least, that tell what the force is at rest."""

ROUNDING = 1e-9
"""g: what computing leaves of no noise."""

LONGEST = 10.0
"""s that a push lasts, at most: what goes to and fro for longer is a disturbance."""

NET, SURE, MOST = 0.2, 3.0, 0.5
"""Share of the mean size of the force in a push that its mean is, at most, but for so many standard
deviations, and with these."""


def without_pushes(
    blocks: Blocks,
    off: FloatArray,
    segments: list[tuple[int, int]],
    *,
    least: int,
    step: float,
    units: Units,
) -> list[tuple[int, int]]:
    """Return what is left of rests when the pushes in them are taken out.

    Parameters
    ----------
    blocks : Blocks
    off : (n, 3) array
        Rates of the blocks without the gyroscope's bias, in the recording's units.
    segments : list of (int, int)
        Blocks ``[a, b)`` of the rests.
    least : int
        Blocks of what is left of one, at least.
    step : float
        Resolution of the specific force, in the recording's units.
    units : Units
    """
    if units.rate is None:
        return segments
    # What shakes a sensor faster than a block lasts, were it white.
    shaken = blocks.accel_power / (3 * max(blocks.size - 1, 1))
    floor = max(step * np.sqrt(1.5 / 12.0), ROUNDING * units.gravity)
    seen: list[tuple[int, int]] | None = None
    for scale in SCALES:
        if segments != seen:
            seen, signals = segments, [turned_back(blocks, off, *s, units.rate) for s in segments]
            # Of a hand the shortest means tell, of which a push has the fewest.
            short = np.array([_levels(contrasts(own, SCALES[0]), floor) for own in signals])
            # A slow one turns the sensor as well.
            turns = np.array([[sway(off[a:b])] for a, b in segments])
        moves = [contrasts(own, scale) for own in signals]
        known = [_levels(own, floor) for own in moves if len(own)]
        if not known:
            break
        usual = np.median(known, axis=0)
        turning = turns / max(float(np.median(turns)), 1e-300)
        sways = np.fmax(np.fmax(short / np.nanmedian(short, axis=0), turning), 1.0)
        carried = LEAST * units.gravity / STANDARD_GRAVITY / (scale * blocks.duration) ** 2
        left: list[tuple[int, int]] = []
        for (a, b), signal, own, times in zip(segments, signals, moves, sways, strict=True):
            moved = np.zeros(b - a, bool)
            level = usual * times
            if len(own):
                inside = 1.5 * moving_mean(shaken[a:b], 3 * scale) / scale
                level = np.maximum(level, np.sqrt(inside)[:, None])
                out = np.all(own > np.maximum(STANDS_OUT * level, (0.0, carried)), axis=1)
                also = np.all(own > ALSO * level, axis=1)
                for p, q in spans_of(also):
                    also[p:q] = out[p:q].any()
                spill(moved[scale:], also, scale)
            noise = float(np.median(level[..., 1])) * np.sqrt(scale / 1.5)
            for p, q in spans_of(moved):
                moved[p:q] = _is_push(signal[:, 1], p, q, scale, noise, blocks.duration)
            parts = [(a + p, a + q) for p, q in spans_of(~moved)]
            left += [(p, q) for p, q in parts if q - p >= least] if len(parts) > 1 else parts
        segments = left
    return segments


def turned_back(blocks: Blocks, off: FloatArray, a: int, b: int, rate: float) -> FloatArray:
    """Return the specific force of a rest, and the same turned back by the rate, (n, 2, 3)."""
    force = blocks.accel[a:b]
    own = off[a:b] - np.median(off[a:b], axis=0)
    turned = np.cross(force, own) * (rate * blocks.duration)
    return np.stack((force, force - (np.cumsum(turned, axis=0) - 0.5 * turned)), axis=1)


def contrasts(signals: FloatArray, scale: int) -> FloatArray:
    """Return by how much means over `scale` rows of signals (n, 2, 3) differ from those beside.

    The k-th is the length of that of the rows from k + scale on, (n - 3 scale + 1, 2).
    """
    if len(signals) < 3 * scale:
        return np.zeros((0, 2))
    mean = moving_mean(signals, scale)
    apart = mean[scale:-scale] - 0.5 * (mean[: -2 * scale] + mean[2 * scale :])
    return np.asarray(np.linalg.norm(apart, axis=2))


def _levels(moves: FloatArray, floor: float) -> FloatArray:
    """Return the standard deviations of contrasts (n, 2) on one axis, (2,); NaN of none."""
    if not len(moves):
        return np.full(2, np.nan)
    square = np.quantile(np.square(moves), QUARTILE, axis=0)
    return np.asarray(np.maximum(np.sqrt(square / CHI_SQUARED), floor))


def _is_push(
    force: FloatArray, first: int, last: int, scale: int, noise: float, duration: float
) -> bool:
    """Return whether what moves in blocks ``[first, last)`` of a rest is at rest after them.

    Then the force (n, 3) is what it was before, and that in between, whose means over `scale` stand
    out, has no integral. ``noise`` is its standard deviation in a block.
    """
    before, after = force[max(first - BESIDE, 0) : first], force[last : last + BESIDE]
    if (last - first) * duration > LONGEST or min(len(before), len(after)) < FEWEST:
        return False
    ends = before.mean(axis=0), after.mean(axis=0)
    unsure = SURE * noise * float(np.sqrt(1 / len(before) + 1 / len(after)))
    pushed = force[first:last] - 0.5 * (ends[0] + ends[1])
    most = float(np.linalg.norm(moving_mean(pushed, scale), axis=1).max())
    size = float(np.linalg.norm(pushed, axis=1).mean())
    net = float(np.linalg.norm(pushed.mean(axis=0)))
    change = float(np.linalg.norm(ends[1] - ends[0]))
    stands_out = most > STANDS_OUT * noise / float(np.sqrt(scale))
    return stands_out and change < size + unsure and net < min(NET * size + unsure, MOST * size)
