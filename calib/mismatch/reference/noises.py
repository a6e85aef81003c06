"""The noise of differences from a truth: its colour, and how captured angles wander."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from calib.effects.base import State
from calib.mismatch.noise.noise import estimate_levels, expected_levels
from calib.mismatch.reference.captured import SLOW_ANGLES
from calib.mismatch.reference.colour import (
    Blur,
    Colour,
    explained_by,
    find_colour,
    steepest_beside,
    whitening,
)
from calib.mismatch.reference.filters import smoothed
from calib.mismatch.rows.rows import Rows
from calib.types import BoolArray, FloatArray

STEEP = (4.0, 1.0, 0.25)
"""s²: how steep the noise of captured rates is taken to be: below half a hertz it may be of any
colour. A filter that is steeper is longer, and sees nothing that is so near to a gap."""

TORN = 0.1
"""Share of the points that gaps may take before a shorter filter is tried."""

HAND = 2.0
"""Hz below which most of what a hand does is."""


class Differences(NamedTuple):
    """Recording minus model, (n, 6), in the true ``state``.

    Through a low-pass of ``band`` (Hz), at points ``interval`` (s) apart. ``least`` are the
    densities that the noise of both triads has at least, SI/√Hz. Where the accelerometer is not
    ``judged`` everywhere, that says where it is.
    """

    state: State
    left: FloatArray
    interval: float
    bands: tuple[float, float]
    least: tuple[float, float] = (0.0, 0.0)
    judged: BoolArray | None = None


def find_noise(
    differences: Differences, columns: Iterable[tuple[str, FloatArray]] | None = None
) -> tuple[list[Colour], Blur]:
    """Return the colours of the noise of both triads, and what makes it white.

    Of a captured motion ``columns`` are what the differences can have besides: channel and values,
    each in its typical size.
    """
    time, left = differences.state.time, differences.left
    interval, bands = differences.interval, differences.bands
    at = slice(None) if differences.judged is None else differences.judged
    steep = steepest_beside(differences.state.rate)
    accel = find_colour(
        time[at],
        left[at, :3],
        interval,
        max(bands),
        steepest=steep,
        least=differences.least[0],
        highest=bands[0],
    )
    found = None if columns is None else _in_one_frame(differences, columns, accel)
    if found is None:
        gyro = find_colour(time, left[:, 3:], interval, bands[1], steepest=steep)
        found = gyro, whitening(time, [accel, gyro], interval, bands)
    return [accel, found[0]], found[1]


def _in_one_frame(
    differences: Differences, columns: Iterable[tuple[str, FloatArray]], accel: Colour
) -> tuple[Colour, Blur] | None:
    """Return the colour of rates in a frame that does not turn, and what makes it white.

    What captured angles err by rates err by there, however a body turns. None if that is not what
    most of the noise is.
    """
    state, left, interval, bands = differences[:4]
    time, mat = state.time, state.mat_ns
    assert mat is not None
    own = [(name, values) for name, values in columns if name.startswith("gyro")]

    def seen(noise: FloatArray, steepest: float) -> tuple[Colour, Blur]:
        rate = np.einsum("nij,nj->ni", mat, noise[:, 3:])
        least = differences.least[1]
        gyro = find_colour(
            time, rate, interval, bands[1], steepest=steepest, least=least, long=True
        )
        return gyro, whitening(time, [accel, gyro], interval, bands, mat)

    for steepest in STEEP:
        _, rough = seen(left, steepest)
        # As slow as a hand is what no model has yet: what effects can explain of that is no noise.
        # Of what is fast a column of the truth has the noise of the differences.
        slow = smoothed(time, explained_by(left, own, rough), HAND)
        gyro, blur = seen(left - slow, steepest)
        if gyro.square * bands[1] ** 2 < 1.0:
            return None
        if len(blur.seen) > (1.0 - TORN) * len(time):
            break
    return gyro, blur


def wandering(rows: Rows, columns: Iterable[tuple[str, FloatArray]]) -> float:
    """Return the variance of slow errors of captured angles beside what may be found, rad².

    That is what ``columns`` are, as `find_noise` has them.
    """
    found = [rows.column({channel: values}) for channel, values in columns]
    mean = np.hstack((rows.baseline, rows.nuisance, np.stack(found, axis=1)))
    levels = estimate_levels(rows, mean, expected_levels(rows)).values
    names = [component.name for component in rows.components]
    return float(levels[names.index(SLOW_ANGLES)])
