"""How still a sensor is: statistics of short blocks and windows, in units that the data sets.

Samples are cut into blocks of about 0.1 s, and windows are `WIDTH` blocks that slide by one. All
levels are relative: the accelerometer's unit is its own reading of gravity, the gyroscope's is
found from how gravity turns in the sensor's frame, ``d(u)/dt = u x rate``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.types import BoolArray, FloatArray, IntArray

BLOCK = 0.1
"""Duration of a block, s: longer than the correlation of sensor noise, shorter than a turn."""
WIDTH = 5
"""Blocks in a window: the shortest rest that can be told from the slowest moment of a turn."""
FACTOR = 4.0
"""A level this many times the recording's own at rest is no rest: 15 degrees of freedom reach twice
their median once in 10⁹ windows of white noise; the rest is for noise that is not white."""
SHAKEN = 2.0
"""A machine shakes a rest faster than a block lasts: the block means then change by what the noise
inside blocks says, and up to this many times that by chance. What moves the sensor about moves them
by far more."""
MOST_SHAKEN = 0.6
"""What those changes are at most, in g: 1 g of shaking on every axis, blocks having ten samples."""
CHUNK = 1 << 20
CHI_SQUARED = 2.366
"""Median of chi-square with three degrees of freedom."""
PART = 1 << 13
"""Medians that are found at a time: each has a window of its own."""

# Physical sizes, for what is not a matter of noise.
TREMOR_RATE, MOST_RATE = 0.12, 0.5
"""Rate of a hand that holds still, and rate that no rest has, rad/s (block means)."""
TREMOR_FORCE, MOST_FORCE = 0.03, 0.2
"""Likewise for the change of specific force inside a window, in g."""
LONGEST_GAP = 0.25
"""A gap this long (s) may hide a turn."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means (n, 3) and powers (n,) of n blocks, in the recording's units.

    ``power`` is the variance inside a block, summed over the axes. ``broken`` marks blocks with a
    gap in time in them or just before them.
    """

    size: int
    duration: float
    accel: FloatArray
    gyro: FloatArray
    accel_power: FloatArray
    gyro_power: FloatArray
    broken: BoolArray

    def __len__(self) -> int:
        return len(self.accel)


def block_size(interval: float) -> int:
    """Return how many samples make a block, for an interval between samples in s."""
    return max(1, round(BLOCK / interval))


def cut_blocks(
    time: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    *,
    size: int,
    interval: float,
    before: float | None = None,
) -> Blocks:
    """Return the blocks of `size` samples; what is left over at the end is not used.

    ``before`` (s) is the time of the sample before the first, where there is one.
    """
    n = len(time) // size
    accel_mean, accel_power = _moments(accel, n, size)
    gyro_mean, gyro_power = _moments(gyro, n, size)
    gap = np.zeros(n * size, bool)
    longest = max(LONGEST_GAP, 2.5 * interval)
    gap[1:] = np.diff(time[: n * size]) > longest
    if before is not None and n:
        gap[0] = time[0] - before > longest
    broken: BoolArray = np.asarray(gap.reshape(n, size).any(axis=1))
    return Blocks(size, size * interval, accel_mean, gyro_mean, accel_power, gyro_power, broken)


def _moments(values: FloatArray, n: int, size: int) -> tuple[FloatArray, FloatArray]:
    mean, power = np.empty((n, 3)), np.empty(n)
    rows = max(1, CHUNK // size)
    for first in range(0, n, rows):
        part = slice(first, min(first + rows, n))
        block = values[part.start * size : part.stop * size].reshape(-1, size, 3)
        mean[part] = np.einsum("nsc->nc", block) / size
        rest = block - mean[part, None]
        power[part] = np.einsum("nsc,nsc->n", rest, rest) / size
    return mean, power


def join_blocks(parts: Sequence[Blocks]) -> Blocks:
    """Return blocks that follow each other as one."""
    return replace(
        parts[0],
        accel=np.concatenate([part.accel for part in parts]),
        gyro=np.concatenate([part.gyro for part in parts]),
        accel_power=np.concatenate([part.accel_power for part in parts]),
        gyro_power=np.concatenate([part.gyro_power for part in parts]),
        broken=np.concatenate([part.broken for part in parts]),
    )


@dataclass(frozen=True)
class Units:
    """What the recording's units are: one g, and rad/s per unit of rate (None if not known)."""

    gravity: float
    rate: float | None


def find_units(blocks: Blocks, bias: FloatArray) -> Units:
    """Return the units of a recording from the data, whatever they are.

    The rate's unit is the regression of the change of the direction of gravity on ``u x rate``,
    over blocks where the specific force is close to gravity. Where nothing turned it is taken as
    rad/s if the accelerometer reads m/s².
    """
    length = np.linalg.norm(blocks.accel, axis=1)
    gravity = float(np.median(length)) or 1.0
    usual = 1.0 if 7.0 < gravity < 13.0 else None
    good = np.abs(length / gravity - 1.0) < 0.1
    pair = good[1:] & good[:-1] & ~blocks.broken[1:]
    if pair.sum() < WIDTH:
        return Units(gravity, usual)
    unit = blocks.accel / np.maximum(length, 1e-300)[:, None]
    change = (unit[1:] - unit[:-1])[pair]
    middle = (0.5 * (unit[1:] + unit[:-1]))[pair]
    angle = (0.5 * (blocks.gyro[1:] + blocks.gyro[:-1]) - bias)[pair] * blocks.duration
    predicted = np.cross(middle, angle)
    common = float(np.einsum("ni,ni->", change, predicted))
    square = float(np.einsum("ni,ni->", predicted, predicted))
    total = float(np.einsum("ni,ni->", change, change))
    if square <= 0 or total <= 0 or common <= 0.5 * np.sqrt(square * total):
        return Units(gravity, usual)
    return Units(gravity, common / square)


@dataclass(frozen=True, eq=False)
class Windows:
    """Levels of the windows that start at each block, (n - WIDTH + 1,).

    ``rate`` is the root mean square of the block means of the rate about `bias`; ``force`` that of
    the block means of the specific force about the window's own mean, and ``shake`` what that
    would be if all that happens inside the blocks were white noise. ``whole`` is False where the
    window has a gap in it.
    """

    rate: FloatArray
    force: FloatArray
    shake: FloatArray
    whole: BoolArray


def slide(blocks: Blocks, bias: FloatArray) -> Windows:
    """Return the levels of all windows."""
    rate = moving_mean(np.square(blocks.gyro - bias).sum(axis=1), WIDTH)
    centred = blocks.accel - blocks.accel[len(blocks) // 2]
    mean = moving_mean(centred, WIDTH)
    force = moving_mean(np.square(centred).sum(axis=1), WIDTH) - np.square(mean).sum(axis=1)
    inside = moving_mean(blocks.accel_power, WIDTH) / max(blocks.size - 1, 1)
    whole = moving_mean(blocks.broken.astype(np.float64), WIDTH) < 0.5 / WIDTH
    return Windows(
        np.sqrt(np.maximum(rate, 0.0)),
        np.sqrt(np.maximum(force * WIDTH / (WIDTH - 1), 0.0)),
        np.sqrt(inside),
        whole,
    )


def moving_mean(values: FloatArray, width: int) -> FloatArray:
    """Return means over `width` rows that follow each other, (n - width + 1, ...)."""
    out = np.zeros((len(values) - width + 1, *values.shape[1:]))
    for k in range(width):  # exact, where a running sum would lose digits over a day
        out += values[k : len(values) - width + 1 + k]
    return out / width


def runs(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the index ranges ``[start, stop)`` of the runs of True."""
    edge = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)


def spans_of(mask: BoolArray) -> list[tuple[int, int]]:
    """Return the `runs` of True as ``[start, stop)``, one after another."""
    return list(zip(*(edge.tolist() for edge in runs(mask)), strict=True))


def spill(mask: BoolArray, windows: BoolArray, width: int) -> None:
    """Set in `mask`, in place, every block that lies in one of the windows."""
    for k in range(width):
        mask[k : k + len(windows)] |= windows


def sway(off: FloatArray) -> float:
    """Return the usual deviation of one axis of rates (n, 3) from their median, in their unit.

    A hand that sways slowly turns hardly faster from block to block: it shows here alone.
    """
    return float(
        np.median(np.linalg.norm(off - np.median(off, axis=0), axis=1)) / np.sqrt(CHI_SQUARED)
    )


def moving_median(values: FloatArray, width: int) -> FloatArray:
    """Return the medians (n, k) of (n, k) values and those beside them, `width` in all.

    Beyond the ends the values there go on. Of an even number it is the upper of the middle two.
    """
    before = width // 2
    ends = ((before, width - 1 - before), *((0, 0),) * (values.ndim - 1))
    held = np.pad(values, ends, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(held, width, axis=0)
    out = np.empty(values.shape)
    for first in range(0, len(values), PART):
        part = slice(first, first + PART)
        out[part] = np.partition(windows[part], before, axis=-1)[..., before]
    return out
