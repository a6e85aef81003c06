"""A recording as a report: its signals, its poses, and what an audit says of it."""

from __future__ import annotations

import numpy as np

from calib.gravity import STANDARD_GRAVITY as G
from calib.recording import AXES, Recording
from calib.statics import find_poses
from calib.types import FloatArray, IntArray
from imu_cli.report.model import Block, Plot, Report, Series, Sphere, Table

BINS = 1500
"""Most a screen shows: each bin is drawn by its lowest and highest sample, so that spikes stay."""


def recording_report(recording: Recording, *, name: str) -> Report:
    """Return the report of a recording."""
    poses = find_poses(recording)
    shaded = tuple((float(a), float(b)) for a, b in poses.interval)
    rows = _extremes(recording, BINS)
    time = recording.time[rows]
    blocks: list[Block] = [
        _signals("Specific force", "m/s²", time, recording.accel[rows], shaded),
        _signals("Angular rate", "°/s", time, np.degrees(recording.gyro[rows]), shaded),
    ]
    if recording.temperature is not None:
        series = (Series("temperature", time, recording.temperature[rows], "line"),)
        blocks.append(Plot("Temperature", "time, s", "°C", series, shaded))
    if len(poses):
        up = poses.accel / np.linalg.norm(poses.accel, axis=1, keepdims=True)
        text = [f"pose {k + 1}: {a:.1f} to {b:.1f} s" for k, (a, b) in enumerate(poses.interval)]
        blocks.append(Sphere("Where up was, in the sensor's frame", up, text))
    blocks.append(_device(recording))
    cut = "" if recording.complete else " It was cut: its writer did not end it."
    lost = recording.samples_lost
    return Report(
        title="Recording",
        verdict=f"{name}: {recording.duration:.1f} s, {len(recording)} samples, "
        f"{len(poses)} static poses.{cut}",
        tone="good" if recording.complete and not lost else "partial",
        facts=(
            ("rate", f"{1 / recording.interval:.4g} Hz" if recording.interval else "-"),
            ("samples lost", str(lost)),
            ("clock", recording.clock),
        ),
        blocks=tuple(blocks),
        document={"samples": len(recording), "duration": recording.duration, "poses": len(poses)},
    )


def _extremes(recording: Recording, bins: int) -> IntArray:
    """Return the samples to draw: of each bin, those where a channel is lowest or highest."""
    n = len(recording)
    signals = np.hstack([recording.accel, recording.gyro])
    if n <= 4 * bins:
        return np.arange(n)
    width = n // bins
    whole = signals[: width * bins].reshape(bins, width, 6)
    start = np.arange(bins)[:, None] * width
    rows = np.concatenate([start + whole.argmin(axis=1), start + whole.argmax(axis=1)], axis=1)
    return np.unique(np.append(rows, n - 1))


def _signals(
    title: str,
    unit: str,
    time: FloatArray,
    values: FloatArray,
    shaded: tuple[tuple[float, float], ...],
) -> Plot:
    series = tuple(Series(axis, time, values[:, k], "line") for k, axis in enumerate(AXES))
    return Plot(title, "time, s", unit, series, shaded, "Shaded: at rest.")


def _device(recording: Recording) -> Table:
    device = recording.device
    rows = [
        ("chip", device.chip or "unknown"),
        ("serial number", device.serial_number or "unknown"),
    ]
    if device.accel_full_scale is not None:
        rows.append(("accelerometer full scale", f"{device.accel_full_scale / G:.4g} g"))
    if device.gyro_full_scale is not None:
        rows.append(("gyroscope full scale", f"{np.degrees(device.gyro_full_scale):.5g} °/s"))
    rows += list(recording.notes.items())
    return Table("Device and notes", ("", ""), tuple(rows))
