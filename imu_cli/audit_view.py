"""An audit as a person reads it, in 80 columns, and as a JSON document."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.audit import Audit
from calib.gravity import STANDARD_GRAVITY as G
from calib.recording import CHANNELS, Recording

if TYPE_CHECKING:
    from rich.table import Table

WIDTH = 80
LABEL = 15
CLOCKS = {
    "device": "by the device's clock",
    "host": "by the host's arrival times",
    "nominal": "by the nominal rate, without stamps",
    "invalid": "by a clock that is known to be wrong",
}


def summary_lines(recording: Recording, audit: Audit, name: str) -> list[str]:
    """Return what the recording holds, a line each."""
    device = recording.device
    parts = [" ".join(filter(None, (device.chip, device.serial_number))) or "not named"]
    if device.accel_full_scale is not None:
        parts.append(f"±{device.accel_full_scale / G:.3g} g")
    if device.gyro_full_scale is not None:
        parts.append(f"±{np.degrees(device.gyro_full_scale):.4g} °/s")
    rows = [
        ("recording", name),
        ("device", ", ".join(parts)),
        ("samples", f"{audit.samples} over {audit.duration:.2f} s, {audit.lost} lost"),
        ("rate", f"{audit.rate:.5g} Hz {CLOCKS[audit.clock]}, jitter {_jitter(audit)}"),
        ("rest", _rest(audit)),
        ("range", _ranges(recording)),
    ]
    if audit.temperature is not None:
        low, high = audit.temperature
        rows.append(("temperature", f"{low:.2f} to {high:.2f} °C"))
    rows.append(("complete", "yes" if audit.complete else "no, it was cut"))
    rows += [(key.replace("_", " "), value) for key, value in recording.notes.items()]
    return [line for label, text in rows for line in _row(label, text)]


def findings_table(audit: Audit) -> Table:
    """Return what is wrong, a row each."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("finding", no_wrap=True, style="yellow")
    table.add_column("what", overflow="fold")
    table.add_column("first at, s", justify="right", no_wrap=True)
    for finding in audit.findings:
        first = ", ".join(f"{t:.2f}" for t in finding.times[:2])
        more = " .." if finding.count > 2 and len(finding.times) > 2 else ""
        table.add_row(finding.kind, finding.message, first + more)
    return table


def remark_lines(audit: Audit) -> list[str]:
    """Return what is not wrong but good to know."""
    return [line for remark in audit.remarks for line in _row("remark", remark)]


def document(recording: Recording, audit: Audit, paths: list[str]) -> dict[str, Any]:
    """Return the audit as JSON holds it; SI units, °C."""
    device = recording.device
    return {
        "format": "imu-cal/audit",
        "version": 1,
        "files": paths,
        "device": {
            "chip": device.chip,
            "serial_number": device.serial_number,
            "accel_full_scale": device.accel_full_scale,
            "gyro_full_scale": device.gyro_full_scale,
            "accel_lsb": device.accel_lsb,
            "gyro_lsb": device.gyro_lsb,
            "rate": device.rate,
        },
        "notes": dict(recording.notes),
        "samples": audit.samples,
        "lost": audit.lost,
        "duration": audit.duration,
        "clock": audit.clock,
        "rate": audit.rate,
        "jitter": audit.jitter,
        "complete": audit.complete,
        "temperature": None if audit.temperature is None else list(audit.temperature),
        "range": {
            name: [float(recording.channel(name).min()), float(recording.channel(name).max())]
            for name in CHANNELS
        },
        "static_share": audit.static,
        "distinct_poses": audit.distinct_poses,
        "poses": [
            {"interval": interval.tolist(), "accel": accel.tolist(), "gyro": gyro.tolist()}
            for interval, accel, gyro in zip(
                audit.poses.interval, audit.poses.accel, audit.poses.gyro, strict=True
            )
        ],
        "findings": [
            {
                "kind": finding.kind,
                "message": finding.message,
                "channels": list(finding.channels),
                "count": finding.count,
                "times": list(finding.times),
            }
            for finding in audit.findings
        ],
        "remarks": list(audit.remarks),
    }


def _jitter(audit: Audit) -> str:
    share = audit.jitter * audit.rate
    return "none" if share < 1e-6 else f"{1e3 * audit.jitter:.2g} ms ({share:.2g} of a step)"


def _rest(audit: Audit) -> str:
    if audit.rest_norm is None or audit.rest_rate is None:
        return "no static pose"
    rates = ", ".join(f"{rate:.3f}" for rate in np.degrees(audit.rest_rate))
    count = len(audit.poses)
    return (
        f"{count} static {'pose' if count == 1 else 'poses'} ({audit.distinct_poses} distinct), "
        f"{audit.static:.0%} of the samples; |a| {audit.rest_norm:.3f} m/s², rate ({rates}) °/s"
    )


def _ranges(recording: Recording) -> str:
    accel, gyro = np.abs(recording.accel).max(axis=0), np.abs(recording.gyro).max(axis=0)
    return (
        f"up to ({', '.join(f'{v:.2f}' for v in accel)}) m/s², "
        f"({', '.join(f'{v:.1f}' for v in np.degrees(gyro))}) °/s"
    )


def _row(label: str, text: str) -> list[str]:
    lines = textwrap.wrap(text, WIDTH - LABEL) or [""]
    return [f"{label if k == 0 else '':<{LABEL}}{line}" for k, line in enumerate(lines)]
