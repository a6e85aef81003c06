"""The motion that a reference measured: motion capture, a table, a simulation.

Orientation and position are splines (`calib.simulation.through`). The second derivative of a
position makes much of its noise: where a reference has noise, it passes a low-pass first. What a
hole hides is bridged, and marked as hidden.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt, spectrogram, welch

from calib.effects.observed import observed_turns
from calib.errors import InsufficientMotionError
from calib.simulation.bridges import LOOSE, bridged, holes
from calib.simulation.kinematics import Motion, Segment
from calib.simulation.noise import CONSUMER
from calib.simulation.through import motion_through, one_sign, path_through, spline_through
from calib.types import BoolArray, FloatArray

WINDOW = 4.0
"""s of the periodograms whose mean tells motion from noise."""

NARROWEST = 5.0
"""Hz: hand motion reaches so far in any case."""

REST = 1.0
"""s of a rest, at least."""

SMOOTH = 0.12
"""Of a frequency, on either side, over which a spectrum is averaged."""

TOP = 0.75
"""Of half the rate, above which there is noise if there is any."""

QUIET = 0.1
"""Times a consumer part's noise, up to which a reference counts as exact."""


def motion_from_reference(
    time: FloatArray,
    quat: FloatArray,
    position: FloatArray | None = None,
    *,
    gravity: float,
    bandwidth: float | None = None,
    start: float | None = None,
    name: str = "reference",
) -> Motion:
    """Return the motion that a reference measured: motion capture, a table, a simulation.

    Parameters
    ----------
    time : (n,) array, s
        Increasing; the motion's time 0 is the first of them.
    quat : (n, 4) array
        Orientations ``mat_ns``, scalar first. Rows that are not finite, or zero, are gaps. Where
        they are too long for a spline the motion goes on smoothly, and has ``hidden`` segments.
    position : (n, 3) array, m, or None
        None has the sensor stay where it is.
    gravity : float, m/s²
    bandwidth : float, Hz, or None
        Low-pass without delay, against noise of the reference; None takes it as exact. Two
        derivatives of a position make much of its noise.
    start : float, s, or None
        Which time is the motion's time 0 instead.

    Raises
    ------
    ValueError
        If shapes disagree, time does not increase, or fewer than four rows are known.
    InsufficientMotionError
        If there are holes all over.
    """
    time, quat = np.asarray(time, np.float64), np.asarray(quat, np.float64)
    if quat.shape != (len(time), 4):
        raise ValueError(f"`quat` must be {(len(time), 4)}, got {quat.shape}")
    if position is not None:
        position = np.asarray(position, np.float64)
        if position.shape != (len(time), 3):
            raise ValueError(f"`position` must be {(len(time), 3)}, got {position.shape}")
    good = _known(quat, position)
    if good.sum() < 4:
        raise ValueError(f"`quat` has {good.sum()} known rows, expected at least four")
    at = time[good] - (time[0] if start is None else start)
    if np.diff(at).min() <= 0:
        raise ValueError("`time` must increase")
    values = one_sign(quat[good])
    if position is not None:
        values = np.hstack((values, position[good]))
    hidden = _hidden(at, bandwidth)
    at, values = bridged(at, values)
    if bandwidth is not None:
        values = _low_pass(at, values, bandwidth)
    where = np.zeros((len(at), 3)) if position is None else values[:, 4:]
    kinematics = motion_through(at, values[:, :4], path_through(at, where))
    found = observed_turns(at, kinematics(at).turning.rate)
    turns = np.transpose((found.start, found.end))
    segments = [Segment("turn", a, b, f"turn {k}") for k, (a, b) in enumerate(turns.tolist(), 1)]
    segments += [
        Segment("hidden", a, b, f"hole {k}") for k, (a, b) in enumerate(hidden.tolist(), 1)
    ]
    segments.sort(key=lambda segment: segment.start)
    motion = Motion(name, float(at[-1]), kinematics, tuple(segments), gravity=gravity)
    if not motion.seen(at).any():
        raise InsufficientMotionError(
            f"the reference is torn by {len(hidden)} holes: nowhere is it free of them for long "
            f"enough to be followed, expected more than {2 * LOOSE} rows in a row"
        )
    return motion


def _known(quat: FloatArray, position: FloatArray | None) -> BoolArray:
    """Return which rows say how the body lay, and where it was if that is asked for."""
    good = np.isfinite(quat).all(axis=1) & quat.any(axis=1)
    if position is not None:
        good &= np.isfinite(position).all(axis=1)
    return np.asarray(good)


def _hidden(time: FloatArray, bandwidth: float | None) -> FloatArray:
    """Return from when to when holes between (n,) times hide the motion, (k, 2) s.

    Beside a hole a spline, and a low-pass, has not forgotten its bridge.
    """
    beside = LOOSE * float(np.median(np.diff(time)))
    if bandwidth is not None:
        beside = max(beside, 0.5 / bandwidth)
    before = np.flatnonzero(holes(time))
    return np.stack((time[before] - beside, time[before + 1] + beside), axis=1)


def shown_bandwidth(
    time: FloatArray, quat: FloatArray, position: FloatArray | None = None
) -> float | None:
    """Return the frequency (Hz) above which a reference shows noise and no motion.

    The rates and accelerations of what moves fall with frequency, those that come of noise rise: it
    is the first frequency from which on their power does not fall for an octave. None if the
    reference is as good as exact beside a consumer part, or too short to say.

    Parameters
    ----------
    time, quat, position
        As for `motion_from_reference`.
    """
    good = _known(quat, position)
    if good.sum() < 2:
        return None
    at, step = _even(time[good])
    length = round(WINDOW / step)
    if len(at) < 2 * length or length < 64:
        return None
    found = []
    # A rate is twice the change of a quaternion.
    sides = [(2.0 * one_sign(quat[good]), 1, CONSUMER.gyro_noise_density)]
    if position is not None:
        sides.append((position[good], 2, CONSUMER.accel_noise_density))
    for values, order, density in sides:
        even = np.stack([np.interp(at, time[good], column) for column in values.T], axis=1)
        # The differences are what is judged, and leak less: they fall less with frequency.
        changes = np.diff(even, n=order, axis=0) / step**order
        if _floor(changes, step) < 3 * (QUIET * density) ** 2:
            continue
        f, power = welch(changes, 1 / step, nperseg=length, axis=0)
        found.append(_lowest(f[1:], power[1:].sum(axis=1)))
    return min(found) if found else None


def _floor(changes: FloatArray, step: float) -> float:
    """Return the density of what is at the top of the band where a reference is quietest.

    Motion may reach up there too, but not all the time.
    """
    f, _, power = spectrogram(changes, 1 / step, nperseg=round(REST / step), axis=0)
    each = np.median(power[f > TOP * f[-1]].sum(axis=1), axis=0)
    return float(np.quantile(each, 0.2))


def _lowest(f: FloatArray, power: FloatArray) -> float:
    sums = np.concatenate(([0.0], np.cumsum(power)))
    low, high = (np.searchsorted(f, f * (1 + side * SMOOTH)) for side in (-1, 1))
    high = np.maximum(high, low + 1)
    smooth = (sums[high] - sums[low]) / (high - low)
    for k in np.flatnonzero((f >= NARROWEST) & (f < 0.5 * f[-1])):
        if smooth[k] <= smooth[k : np.searchsorted(f, 2 * f[k])].min():
            return float(f[k])
    return float(f[-1])


def _even(time: FloatArray) -> tuple[FloatArray, float]:
    """Return even times over the span of (n,) times, and their step, s."""
    step = float(np.median(np.diff(time)))
    count = round((time[-1] - time[0]) / step) + 1
    return np.linspace(time[0], time[-1], count), step


def _low_pass(time: FloatArray, values: FloatArray, bandwidth: float) -> FloatArray:
    """Return (n, k) values through a low-pass without delay; as they are if it is too wide.

    Gaps are bridged by straight lines.
    """
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    if bandwidth >= 0.45 / step or len(time) < 32:
        return np.array(values)
    at, step = _even(time)
    even = np.stack([np.interp(at, time, column) for column in values.T], axis=1)
    sos = butter(4, bandwidth, fs=1 / step, output="sos")
    out: FloatArray = spline_through(at, sosfiltfilt(sos, even, axis=0))(time - at[0])
    return out
