"""Whether a recording and a truth are of one motion, in the same units."""

from __future__ import annotations

import numpy as np

from calib import faults
from calib.effects.base import State
from calib.errors import NoCommonMotionError
from calib.gravity import STANDARD_GRAVITY
from calib.mismatch.noise.hush import count_of, least_noise
from calib.mismatch.reference.filters import smoothed
from calib.recording import CHANNELS, Recording
from calib.types import FloatArray

UNLIKE = 0.3
"""Share of the power of rotation that differs, after the fit of the baseline, from which on the
two are two motions."""

UNIT = 10.0
"""Factor beyond which rates or forces are of other units, not of another scale. What a sensor feels
far from the axis of a fast table, and the reference does not, may be more: the square of it."""

LIGHT = 4.0
"""How many times less than gravity nothing weighs most of the time."""

COMPARED = 20_000
"""Samples that tell whether positions and accelerometer agree, at most."""

LITTLE = 0.5
"""Share that positions leave of what a fixed point leaves, from which they explain little: right
ones leave a hundredth, or a tenth where a soft mount gives way."""

AMISS = 0.1
"""m/s² that an accelerometer feels beyond what turns about a fixed point make it feel, from which
positions can be told from none."""

SLOWER = (4.0, 2.0, 1.0)
"""Hz up to which a hand moves: the slower, the less of the noise of positions is left."""

LOOKED = 200
"""Samples in motion that tell whether two recordings are one."""


def check_apart(real: Recording, other: Recording) -> None:
    """Refuse a recording beside itself, or a copy or a part of it: nothing differs, not even noise.

    Of two simulations without noise that is nothing to wonder at.

    Raises
    ------
    NoCommonMotionError
    """
    speed = np.linalg.norm(real.gyro - np.median(real.gyro, axis=0), axis=1)
    fast = np.argsort(speed)[-LOOKED:]
    own, known = (
        {row.tobytes() for row in np.hstack((r.accel[at], r.gyro[at]))}
        for r, at in ((real, fast), (other, slice(None)))
    )
    if len(own & known) > 0.5 * len(own) and not smooth(real):
        raise NoCommonMotionError(
            "the two are one recording: their samples are the same, and there is nothing to "
            "compare; give a simulation, or what else saw the motion"
        )


def smooth(recording: Recording) -> bool:
    """Whether a recording moves without any noise, that its eighth differences would show.

    What moves at a tenth of the rate has 2e-4 of itself left in them; beside rests that is enough.
    """
    values = faults.values_of(recording)
    least = least_noise(recording.interval)
    noise = np.abs(np.diff(values, n=8, axis=0)) / np.sqrt(12870.0)  # of 16 things, 8
    quiet = np.quantile(noise, 0.2, axis=0) / 0.2533 < least
    return bool((quiet & (count_of(values) < least)).all())


def check_motion(state: State, measured: FloatArray, left: FloatArray) -> None:
    """Refuse a truth of another motion: (n, 6) `left` is what differs of the `measured`.

    Raises
    ------
    NoCommonMotionError
    """
    power = np.square(left[:, 3:]).sum()
    # Of the quieter of the two: what does not move leaves nothing where scales became zero.
    total = min(
        float(np.square(rate - rate.mean(axis=0)).sum()) for rate in (state.rate, measured[:, 3:])
    )
    if power > UNLIKE * total:
        raise NoCommonMotionError(
            "the two do not show the same motion: where they match best, "
            f"{100 * min(power / total, 1.0):.0f} % of the rotation differs; check that they "
            "belong together and that the axes are the same"
        )


def check_units(state: State, measured: FloatArray) -> None:
    """Refuse a truth in other units, which a scale factor would take up.

    Raises
    ------
    NoCommonMotionError
    """
    turns = _spread(state.rate) / max(_spread(measured[:, 3:]), 1e-12)
    pulls = float(np.quantile(np.linalg.norm(state.force, axis=1), 0.95))
    felt = float(np.quantile(np.linalg.norm(measured[:, :3], axis=1), 0.95))
    if not 1 / UNIT < turns < UNIT:
        raise NoCommonMotionError(
            f"the reference turns {turns:.3g} times as fast as the recording: check its unit "
            "(degrees or radians; 1 rad is 57.3 degrees)"
        )
    usual = float(np.median(np.linalg.norm(state.force, axis=1)))
    if usual < STANDARD_GRAVITY / LIGHT:
        raise NoCommonMotionError(
            f"the reference's accelerometer reads {usual:.3g} m/s² most of the time, where gravity "
            f"is {STANDARD_GRAVITY:.3g}: check its unit (expected m/s²; 1 g is "
            f"{STANDARD_GRAVITY:.3g} m/s²)"
        )
    if not felt / UNIT**2 < pulls < felt * UNIT:
        raise NoCommonMotionError(
            f"the reference accelerates {pulls / felt:.3g} times as much as the recording "
            "feels: check the unit of its positions (expected m) or of its accelerometer "
            "(expected m/s²)"
        )
    level = np.abs(np.median(np.hstack((state.force, state.rate)), axis=0))
    channel = faults.outsized(level)
    if channel is not None:
        raise NoCommonMotionError(
            f"most of the time {CHANNELS[channel]} of the reference is "
            f"{faults.size_of(channel, level)}: check that column"
        )


def _spread(values: FloatArray) -> float:
    return float(np.linalg.norm(values - np.median(values, axis=0)))


def misleads(time: FloatArray, state: State, measured: FloatArray) -> bool:
    """Whether the positions of a truth explain little of what a fixed point does not explain.

    Either has an arm, a bias and any matrix that fits (n, 3) `measured` best. What moves about a
    fixed point is explained by both. Positions in other axes, or at other moments, add a motion
    that is not there; such as are right but noisy explain what is slow, as their noise grows with
    the square of the frequency.
    """
    some = np.linspace(0, len(measured) - 1, min(len(measured), COMPARED)).astype(np.int64)
    fixed = state.gravity * state.gravity_direction
    signals = np.hstack((state.force, fixed, state.gradient.reshape(-1, 9), measured))
    placed, about = _left_of_both(signals[some])
    if about <= AMISS**2 or placed <= LITTLE * about:
        return False
    slower = (_left_of_both(smoothed(time, signals, cutoff)[some]) for cutoff in SLOWER)
    return all(placed > LITTLE * about for placed, about in slower)


def _left_of_both(signals: FloatArray) -> tuple[float, float]:
    """Return the mean squares of what positions, and a fixed point, leave of measured forces."""
    placed, fixed, gradient, seen = np.split(signals, (3, 6, 15), axis=1)
    arm = gradient.reshape(-1, 3, 3)
    return _left_beside(placed, arm, seen), _left_beside(fixed, arm, seen)


def _left_beside(force: FloatArray, gradient: FloatArray, measured: FloatArray) -> float:
    """Return the mean square of what (n, 3) forces, and an arm, leave of those measured."""
    n = len(force)
    design = np.zeros((n, 3, 15))
    for i in range(3):
        design[:, i, 4 * i : 4 * i + 3] = force
        design[:, i, 4 * i + 3] = 1.0
    design[:, :, 12:] = gradient
    flat, y = design.reshape(3 * n, 15), measured.reshape(3 * n)
    return float(np.mean(np.square(y - flat @ np.linalg.lstsq(flat, y, rcond=1e-9)[0])))
