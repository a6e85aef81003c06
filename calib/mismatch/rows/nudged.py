"""Rests in which a sensor is turned slowly, by little: only what is still of them is one.

A stage that makes its last small move, or a screw that is tightened, turns a sensor by a tenth of a
degree in seconds: slower than anything that ends a rest, and yet many times what a quiet gyroscope
errs by. Such a rest has no attitude, and its mean rate is no bias. The rate says when it turned,
and gravity, which must have gone where that led, that it did.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.bumps import UNSURE
from calib.mismatch.rows.bumped import scatter
from calib.mismatch.rows.sway import SURE, follows
from calib.mismatch.rows.underway import is_torn
from calib.poses import Poses, average_poses
from calib.recording import Recording
from calib.stillness import moving_mean, runs, spill
from calib.types import BoolArray, FloatArray

WINDOW, WIDTHS = 0.25, (2, 4, 8)
"""s of what the rate of is compared with that of the whole rest, and over how many of these."""

STANDS_OUT = 7.0
"""Standard deviations of a mean from which it is no noise: gravity must have turned as well."""

MOST = 0.5
"""Share of a rest that may turn: what never stops is a hand, and its sway is part of the noise."""

SHORTEST, PAUSE = 0.8, 3.0
"""s of a rest, and of what is still between two turns and no rest, at most."""

SELDOM = 0.25
"""Share of the rests that may turn about the vertical at an end: what does so after most turns is
the gyroscope's own."""

FEWEST = 4
"""Samples in a window."""


class _Parts(NamedTuple):
    """Samples ``[start, stop)`` of the parts of a rest that are still.

    It turned between them, as gravity ``tells``, or as it ``denies``; or as nothing does.
    """

    spans: list[tuple[int, int]]
    tells: bool = False
    denies: bool = False


def still_parts(recording: Recording, poses: Poses) -> Poses:
    """Return the poses of a recording, in the order of time, without what turns slowly in them.

    One in the middle of which that is so is two. About the vertical gravity tells nothing: there
    what a few rests end or begin with, beside turns, is taken for a part of these, but where
    gravity denies that others turned: then it is the gyroscope that is disturbed. Where no seconds
    are known, none is changed.
    """
    if recording.interval <= 0 or recording.clock == "invalid":
        return poses
    whole = list(zip(poses.start.tolist(), poses.stop.tolist(), strict=True))
    windows = [_windows(recording, *span) for span in whole]
    if not any(map(len, windows)):
        return poses
    usual = np.median([scatter(own) for own in windows if len(own)], axis=0)
    each = [
        _still(recording, span, own, np.maximum(usual, scatter(own)))
        if len(own)
        else _Parts([span])
        for span, own in zip(whole, windows, strict=True)
    ]
    unseen = [k for k, parts in enumerate(each) if parts.spans != [whole[k]] and not parts.tells]
    too_many = any(parts.denies for parts in each) or len(unseen) > SELDOM * len(poses)
    for k in unseen:
        # What fades as a recording begins is no end of a turn.
        if too_many or each[k].spans[0][0] != whole[k][0] == whole[0][0]:
            each[k] = _Parts([whole[k]])
    spans = [span for parts in each for span in parts.spans]
    return poses if spans == whole else average_poses(recording, *np.array(spans, np.int64).T)


def _windows(recording: Recording, start: int, stop: int) -> FloatArray:
    """Return force and rate in windows of a rest, (n, 6); none of a brief one, or with a hole."""
    size = _size(recording.interval)
    number = (stop - start) // size
    brief = number * size * recording.interval < 2 * SHORTEST
    if brief or is_torn(recording, start, stop):
        return np.zeros((0, 6))
    used = slice(start, start + number * size)
    both = np.hstack((recording.accel[used], recording.gyro[used]))
    return np.asarray(both.reshape(number, size, 6).mean(axis=1))


def _size(step: float) -> int:
    return max(FEWEST, round(WINDOW / step))


def _still(
    recording: Recording, span: tuple[int, int], windows: FloatArray, noise: FloatArray
) -> _Parts:
    """Return what is still of a rest, samples ``[start, stop)``, by its windows (n, 6)."""
    (start, stop), whole = span, _Parts([span])
    size = _size(recording.interval)
    second = 1.0 / (size * recording.interval)
    force, rate = windows[:, :3], windows[:, 3:]
    if not (noise > 0).all():
        return whole
    moving = _moving(rate - np.median(rate, axis=0), noise[3:])
    if not moving.any() or moving.mean() > MOST:
        return whole
    off = rate - rate[~moving].mean(axis=0)
    angle = np.cumsum(np.where(moving[:, None], off, 0.0), axis=0) / second
    tells, denies = _gravity_went(force, angle, noise[:3])
    if denies:
        return whole._replace(denies=True)
    first, last = runs(~moving)
    length = last - first
    long = length >= SHORTEST * second
    if not tells:
        # Beside the turns: what is still between it and these is a pause.
        long &= (length > PAUSE * second) | (length == length.max())
        if long.sum() != 1:
            return whole
    spans = [
        (start + a * size, stop if b == len(windows) else start + b * size)
        for a, b in zip(first[long].tolist(), last[long].tolist(), strict=True)
    ]
    return _Parts(spans, tells) if spans else whole


def _moving(off: FloatArray, noise: FloatArray) -> BoolArray:
    """Return in which windows a rate (n, 3) stands out, over any of `WIDTHS` of them."""
    moving = np.zeros(len(off), bool)
    for width in (w for w in WIDTHS if len(off) >= 2 * w):
        # Wider ones show what is slower, beside what was seen.
        mean = moving_mean(np.where(moving[:, None], 0.0, off), width)
        size = np.square(mean / noise).sum(axis=1) * width
        spill(moving, size > STANDS_OUT**2, width)
    return moving


def _gravity_went(force: FloatArray, angle: FloatArray, noise: FloatArray) -> tuple[bool, bool]:
    """Return whether gravity tells that a sensor turned by angles (n, 3), and whether it denies it.

    In the sensor's frame specific force (n, 3) changes by ``f x angle``. It tells if it changed by
    that, within the factor of `calib.bumps`, and not by chance; and it denies if that change is
    missing. About the vertical it does neither.
    """
    middle = force.mean(axis=0)
    wanted = np.cross(middle, angle - angle.mean(axis=0)) / noise
    size = max(float(np.linalg.norm(wanted)), np.finfo(float).tiny)
    seen = float(((force - middle) / noise * wanted).sum()) / size
    return follows(seen, size), abs(seen - size) > max(SURE, size / UNSURE)
