"""Channels that are alone with a disturbance so large that rests are hidden by it, or useless.

What finds rests needs both triads to be still. A channel that hums, or is pulled about, hides those
of its window, and what is left of the recording is in order. So where the other five are as quiet
as they ever are, and one is not, for seconds, in several poses, that one is disturbed: nothing
moves a sensor along or about one of its own axes alone, however it lies. What a bench that shakes
does, it does to other axes in other poses.
"""

from __future__ import annotations

import numpy as np

from calib.faults import noise_at_rest, resolution
from calib.stillness import spans_of
from calib.types import BoolArray, FloatArray

WINDOWS, FEWEST = (0.5, 2.0), 8
"""s, and samples at least, in which a channel is quiet or not."""

ALIKE = 3.0
"""Times as noisy as the others of its triad a channel is at most, and they as it: what is more is
no noise, and what is less is stuck."""

QUIET, LOUD = 3.0, 10.0
"""Standard deviation in a window, in noises of the channel, up to which it is quiet, and from which
it is not: of less, the rests are found, and looked at."""

QUARTILES = 1.349
"""Between those of a normal distribution, in standard deviations."""

LONG = 1.0
"""s for which one channel alone is loud in a pose."""

POSES, APART = 2, 0.1
"""Poses in which it is, and rad between them."""

MOST = 0.8
"""Share of the moments without motion, by the other triad, in which it is alone."""

TURNED = 0.02
"""Angle by which a hand that holds still wanders, rad: a gyroscope that shows more may be right,
unless gravity would be seen to move."""


def find_unrest(values: FloatArray, interval: float) -> list[tuple[int, int, int]]:
    """Return ``(channel, start, stop)`` of channels that are alone with a large disturbance.

    Parameters
    ----------
    values : (n, 6) array
    interval : float, s
    """
    found: dict[int, tuple[int, int]] = {}
    if interval <= 0 or len(values) < FEWEST:
        return []
    floor = _floor(values)
    for width in WINDOWS:
        size = max(round(width / interval), FEWEST)
        for c, start, stop in _alone(values, floor, interval, size):
            a, b = found.get(c, (start, stop))
            found[c] = min(a, start), max(b, stop)
    return [(c, *found[c]) for c in sorted(found)]


def _alone(
    values: FloatArray, floor: FloatArray, interval: float, size: int
) -> list[tuple[int, int, int]]:
    """Return what `find_unrest` does, by windows of so many samples beside their noise (6,)."""
    number, least = len(values) // size, max(round(LONG / (size * interval)), 1)
    if number < POSES * least:
        return []
    parts = values[: number * size].reshape(number, size, 6)
    mean, scatter = parts.mean(axis=1), parts.std(axis=1)
    # By its quartiles, as a turn that begins at the window's end is no disturbance of all of it.
    low, high = np.quantile(parts, (0.25, 0.75), axis=1)
    quiet, loud = scatter <= QUIET * floor, high - low > QUARTILES * LOUD * floor
    out = []
    for c in range(6):
        alone = loud[:, c] & np.delete(quiet, c, axis=1).all(axis=1)
        spans = _long_runs(alone, least)
        if c >= 3:
            seen = QUIET * float(np.linalg.norm(floor[:3]))
            bias = float(np.median(mean[quiet[:, c] if quiet[:, c].any() else slice(None), c]))
            spans = [
                (a, b)
                for a, b in spans
                if _is_no_turn(parts[a:b, :, c] - bias, mean[a:b, :3], c - 3, interval, seen)
            ]
        if not spans:
            continue
        whole = slice(spans[0][0], spans[-1][1])
        motionless = quiet[whole, 3:] if c < 3 else quiet[whole, :3]
        if alone[whole].sum() < MOST * motionless.all(axis=1).sum():
            continue
        up = np.array([mean[a:b, :3].mean(axis=0) for a, b in spans])
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), np.finfo(float).tiny)
        turned = np.einsum("ij,ij->i", up[1:], up[:-1]) < np.cos(APART)
        if 1 + turned.sum() >= POSES:
            out.append((c, whole.start * size, whole.stop * size))
    return out


def _long_runs(flags: BoolArray, least: int) -> list[tuple[int, int]]:
    return [(a, b) for a, b in spans_of(flags) if b - a >= least]


def _is_no_turn(
    rate: FloatArray, force: FloatArray, axis: int, interval: float, seen: float
) -> bool:
    """Whether what a gyroscope shows is less than a hand wanders about, or moves no gravity.

    A turn about its axis by an angle moves specific force, of which there are means (n, 3), by that
    times what is across it; accelerometers that are quiet show less than ``seen`` in a window.
    """
    angle = np.cumsum(rate, axis=None).reshape(rate.shape) * interval
    across = float(np.linalg.norm(np.delete(force.mean(axis=0), axis)))
    moved = float(np.linalg.norm(np.ptp(force, axis=0)))
    expected = float(np.ptp(angle.mean(axis=1))) * across
    # A turn that begins goes one way.
    most, way = float(np.ptp(angle)), float(np.abs(rate).sum()) * interval
    wanders = most <= TURNED and most < 0.5 * way
    return wanders or expected > 2.0 * max(seen, moved)


def _floor(values: FloatArray) -> FloatArray:
    """Return the noise of each channel, (6,), as far as it is that of its triad."""
    floor = np.minimum(noise_at_rest(values), _hiss(values))
    usual = np.repeat(np.median(floor.reshape(2, 3), axis=1), 3)
    least = 0.5 * resolution(values)
    return np.asarray(np.maximum(np.clip(floor, usual / ALIKE, ALIKE * usual), least))


def _hiss(values: FloatArray) -> FloatArray:
    """Return the noise of each channel from sample to sample, (6,): slow swings are none."""
    change = np.abs(np.diff(values, axis=0))
    # Of a normal difference the lower quartile is 0.3186, and its spread that of noise by sqrt(2).
    return np.asarray(np.quantile(change, 0.25, axis=0) / (0.3186 * np.sqrt(2.0)))
