"""Whether gyroscope and accelerometer see a turn at the same time.

How fast a sensor turns, and how fast gravity turns in it, rise and fall together. Which part of a
turn gravity does not show (about the vertical) changes their sizes, not when they are.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from calib.recording import Recording
from calib.types import FloatArray

STEP = 0.02
"""s between what is compared: a fifth of the least delay that is said."""

SMOOTH = 0.2
"""s over which both are averaged: a hand's tremor is none of a turn."""

LEAST = 0.1
"""s: a low-pass of 3 Hz delays by 0.075 s, and what is below is told from one by what it leaves."""

MOST = 20.0
"""s up to which a delay is looked for."""

LONGEST = 3600.0
"""s of a recording that are looked at: what is late there is late."""

ALIKE = 0.7
"""Correlation of the two where they belong together: a hand that moves besides leaves 0.85 and more
of it, two recordings of other motions reach 0.6 by chance (80 s; 0.43 in 160 s)."""

SHAKEN = 0.5
"""How much the length of the specific force may vary beside its direction. Of who walks it varies
as much, and both with the step: that is acceleration, which turns nothing."""

BETTER = 1.5
"""Times by which the variance that is left must be larger without the delay."""


def gyro_delay(recording: Recording) -> float | None:
    """Return by how much the gyroscope is late against the accelerometer, s; None if it is not.

    Less than `LEAST` is not looked for, nor what one half of the recording does not show.
    """
    if recording.clock == "invalid" or not 0 < recording.interval < SMOOTH:
        return None
    if recording.duration < 20.0 * SMOOTH:
        return None
    turning, force = _averages(recording)
    size: FloatArray = np.linalg.norm(force, axis=1)
    up = force / np.maximum(size, 1e-12)[:, None]
    shaken = float(np.std(size) / max(float(np.median(size)), 1e-12))
    if shaken > SHAKEN * float(np.sqrt(up.var(axis=0).sum())):
        return None
    tilting: FloatArray = np.linalg.norm(np.gradient(up, STEP, axis=0), axis=1)
    lag, value = _correlation(tilting, turning)
    best = int(np.argmax(value))
    together = float(value[np.abs(lag) < 0.5 * LEAST].max())
    left, otherwise = 1.0 - value[best] ** 2, 1.0 - max(together, 0.0) ** 2
    if value[best] < ALIKE or abs(lag[best]) < LEAST or otherwise < BETTER * left:
        return None
    delay = float(lag[best])
    half = len(turning) // 2
    for own in (slice(0, half), slice(half, None)):
        lag, value = _correlation(tilting[own], turning[own])
        if abs(lag[int(np.argmax(value))] - delay) > LEAST:
            return None
    return delay


def _averaged(values: FloatArray, width: int) -> FloatArray:
    """Return means (n, k) of as many neighbours, mirrored at the ends."""
    before = width // 2
    padded = np.pad(values, ((before, width - 1 - before), (0, 0)), "symmetric")
    return np.asarray(sliding_window_view(padded, width, axis=0).mean(axis=-1))


def _averages(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return how fast the sensor turns (n,), and the specific force (n, 3), at even times."""
    start = recording.time[0]
    at = np.arange(start, min(recording.time[-1], start + LONGEST), STEP)
    width = max(1, round(SMOOTH / STEP))

    def even(values: FloatArray) -> FloatArray:
        columns = [np.interp(at, recording.time, column) for column in values.T]
        return _averaged(np.stack(columns, axis=1), width)

    rate: FloatArray = np.linalg.norm(
        even(recording.gyro - np.median(recording.gyro, axis=0)), axis=1
    )
    return rate, even(recording.accel)


def _correlation(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return delays of the second, s, and its correlation with the first at each of them."""
    a, b = first - first.mean(), second - second.mean()
    scale = float(np.sqrt((a @ a) * (b @ b))) or 1.0
    most = min(round(MOST / STEP), len(a) // 2)
    size = 1 << (2 * len(a)).bit_length()
    product = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size) / scale
    lag = np.arange(-most, most + 1)
    return np.asarray(STEP * lag, np.float64), np.asarray(product[lag], np.float64)
