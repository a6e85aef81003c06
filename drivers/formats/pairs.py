"""One recording in two text files: the accelerometer in one, the gyroscope in the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.errors import RecordingFormatError
from calib.recording import Recording
from calib.types import FloatArray
from drivers.formats.base import ReadOptions, Source
from drivers.formats.columns import no_samples
from drivers.formats.foreign import TextLog, Timekeeper, text_assembler
from drivers.formats.profile import Profile
from drivers.formats.text import decode_head

WIDEST = 3.0
"""Intervals; across a wider gap of the accelerometer nothing is interpolated."""


def read_pair(accel: Source, gyro: Source, profile: Profile, options: ReadOptions) -> Recording:
    """Read both files and put them on the gyroscope's times.

    The rate is integrated and stays as it was measured; the specific force, which is averaged at
    rest, is interpolated linearly where the stamps differ. Gyroscope samples where the
    accelerometer has none become a gap.

    Raises
    ------
    RecordingFormatError
        If a file does not fit the profile, or they do not overlap in time.
    """
    zero, first = _read(accel, profile, options, "accel", None)
    _, second = _read(gyro, profile, options, "gyro", zero)
    if profile.time is None:
        return _row_by_row(accel, gyro, first, second)
    t = second.time
    after = np.searchsorted(first.time, t)
    inside = (t >= first.time[0]) & (t <= first.time[-1])
    step = np.diff(first.time, prepend=-np.inf)[np.minimum(after, len(first) - 1)]
    near = np.isin(t, first.time) | (step <= WIDEST * first.interval)
    keep = inside & near
    if not keep.any():
        raise RecordingFormatError(
            f"{accel.path} covers {first.time[0]:.3f} to {first.time[-1]:.3f} s, {gyro.path} "
            f"{t[0]:.3f} to {t[-1]:.3f} s: they do not overlap, expected one recording"
        )
    assert second.lost is not None
    total = np.cumsum(second.lost + ~keep)[keep]
    lost = np.diff(total, prepend=total[0] - second.lost[keep][0])
    notes = dict(second.notes)
    if not np.array_equal(first.time, t):
        notes["resampled"] = "accelerometer interpolated to the gyroscope's times"
    return replace(
        second,
        time=t[keep],
        accel=_interpolated(t[keep], first.time, first.accel),
        gyro=second.gyro[keep],
        temperature=_heat(first, t[keep]),
        lost=lost,
        complete=first.complete and second.complete,
        notes=notes,
    )


def _read(
    source: Source, profile: Profile, options: ReadOptions, name: str, zero: object
) -> tuple[object, Recording]:
    """Return one file as a recording whose other triad is zero, and the stamp that is 0 s."""
    text = decode_head(source.head)
    triad = profile.accel if name == "accel" else profile.gyro
    if text is None or triad is None:
        what = "is not text" if text is None else f"needs [{name}] in profile {profile.name}"
        raise RecordingFormatError(f"{source.path} {what}")
    heat = profile.temperature if name == "accel" else None
    log = TextLog(source, text, replace(profile, temperature=heat), (triad,))
    assembler, clock = text_assembler(source, log, options), Timekeeper(log.profile, zero)
    for seconds, (values,), degrees in log.read(clock, batch=None):
        empty = np.zeros_like(values)
        pair = (values, empty) if name == "accel" else (empty, values)
        recording = assembler.add(seconds, *pair, degrees)
        if recording is not None:
            return clock.zero, recording
    raise no_samples(str(source.path))


def _row_by_row(accel: Source, gyro: Source, first: Recording, second: Recording) -> Recording:
    """Put rows together that have no stamps: there must be as many of both."""
    if len(first) != len(second) or first.samples_lost or second.samples_lost:
        raise RecordingFormatError(
            f"{accel.path} has {len(first)} usable rows, {gyro.path} {len(second)}, and no time "
            "stamps say which belong together; expected as many, all of them valid"
        )
    return replace(
        first, gyro=second.gyro, complete=first.complete and second.complete, notes=first.notes
    )


def _interpolated(t: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(t, time, column) for column in values.T], axis=1)


def _heat(first: Recording, t: FloatArray) -> FloatArray | None:
    if first.temperature is None:
        return None
    return np.asarray(np.interp(t, first.time, first.temperature), np.float64)
