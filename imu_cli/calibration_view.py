"""A calibration as a person reads it: tables with standard errors, in SI and in everyday units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calib.calibration import Calibration, TriadSummary, parameter_unit
from calib.effects.base import PRESENCE
from calib.gravity import STANDARD_GRAVITY
from imu_cli.output import console, styled

if TYPE_CHECKING:
    from rich.table import Table

EVERYDAY = {
    "accel.bias": (1e3 / STANDARD_GRAVITY, "mg"),
    "gyro.bias": (np.degrees(1.0), "°/s"),
    "accel.scale_factor_error": (100.0, "%"),
    "gyro.scale_factor_error": (100.0, "%"),
    "accel.misalignment": (np.degrees(1.0), "°"),
    "gyro.misalignment": (np.degrees(1.0), "°"),
}
"""Factor and unit in which people know each group of parameters."""

WIDE = 72
"""Columns of a window from which both units are shown."""
NUMBER = 11
"""Characters of a number: a narrow window takes none of them away."""

SHOWN = 4
"""So many of what was left out are listed on the screen; the file has all."""


def plus_minus(value: float, sigma: float | None) -> str:
    """Return ``value ± sigma`` with two digits of sigma, or the value alone."""
    if sigma is None:
        return f"{value:.5g}"
    if not sigma > 0:
        return f"{value:.6g} ± 0"
    decimals = 1 - int(np.floor(np.log10(sigma)))
    if not 0 <= decimals <= 8 or abs(value) >= 1e6:
        return f"{value:.4g} ± {sigma:.2g}"
    return f"{value:.{decimals}f} ± {sigma:.{decimals}f}"


def parameter_table(calibration: Calibration) -> Table:
    """Return the table of all parameters that are determined or should be.

    A narrow window has the SI units alone, and breaks lines between numbers.
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    wide = console().width >= WIDE
    table.add_column("parameter", overflow="fold")
    table.add_column("value ± std error", justify="right", min_width=NUMBER)
    table.add_column("unit", overflow="fold")
    if wide:
        table.add_column("", justify="right", min_width=NUMBER)
        table.add_column("", overflow="fold")
    sigmas = calibration.sigmas
    previous = ""
    for name, value in calibration.values.items():
        status = calibration.status(name)
        if status == "fixed" and not value:
            continue
        group = name.rsplit(".", 1)[0]
        if previous and group.partition(".")[0] != previous.partition(".")[0]:
            table.add_row()
        previous = group
        unit = parameter_unit(name)
        if unit == PRESENCE:  # what it is like is in the rows after it
            continue
        unit = "" if unit == "1" else unit
        if status == "undetermined":
            table.add_row(name, styled(("undetermined", "yellow")), unit)
            continue
        sigma = sigmas.get(name)
        cells = [name, plus_minus(value, sigma), unit]
        if wide and group in EVERYDAY:
            factor, everyday = EVERYDAY[group]
            scaled = None if sigma is None else factor * sigma
            cells += [plus_minus(factor * value, scaled), everyday]
        table.add_row(*cells)
    return table


def summary_lines(calibration: Calibration) -> list[str]:
    """Return what is to be said of a calibration beside its parameters, a line each."""
    source = calibration.provenance
    device = " ".join(filter(None, (source.device.chip, source.device.serial_number)))
    lines = [f"device       {device or 'not named in the recording'}"]
    for item in source.inputs:
        lines.append(f"from         {item.name}  sha256 {item.sha256[:12]}…")
    if source.date:
        lines.append(f"made         {source.date} by imu-cal {source.tool_version}")
    lines.append(
        f"gravity      {calibration.gravity.value:.5f} m/s² ({calibration.gravity.source})"
    )
    span = calibration.temperature
    lines.append(
        "temperature  not measured"
        if span is None
        else f"temperature  {span.low:.1f} to {span.high:.1f} °C"
    )
    for label, summary, what in (
        ("accel", calibration.accel, "poses"),
        ("gyro", calibration.gyro, "turns"),
    ):
        if summary is not None:
            lines += _triad_lines(label, summary, what)
    if calibration.housing is not None:
        housing = calibration.housing
        angle = np.degrees(np.arccos(np.clip((np.trace(housing.mat_hs) - 1) / 2, -1, 1)))
        sigma, rms = np.degrees(housing.sigma.max()), np.degrees(housing.residual_rms)
        lines.append(
            f"housing      sensor turned {angle:.3f} ± {sigma:.3f}° in it "
            f"({housing.poses} poses on known faces, {rms:.3f}° rms)"
        )
    for event in calibration.events:
        spans = ", ".join(f"{a:.2f}-{b:.2f} s" for a, b in event.intervals)
        lines.append(f"event        {event.effect} in {spans}: not part of the sensor")
    lines += [f"note         {key}: {value}" for key, value in source.notes.items()]
    return lines


def undetermined_lines(calibration: Calibration) -> list[str]:
    """Return what is not determined, and what to record for it."""
    if calibration.complete:
        return []
    groups: dict[str, list[str]] = {}
    for name in calibration.undetermined:
        group, _, index = name.rpartition(".")
        groups.setdefault(group, []).append(index)
    lines = ["not determined by this recording:"]
    lines += [f"  {group}  {' '.join(indices)}" for group, indices in groups.items()]
    advice = [
        text
        for summary in (calibration.accel, calibration.gyro)
        if summary is not None
        for text in summary.advice
    ]
    if advice:
        lines += ["to determine it:", *(f"  {text}" for text in advice)]
    return lines


def residual_text(value: float, unit: str) -> str:
    """Return a residual in the unit that people know it in."""
    if unit == "m/s²":
        return f"{value * 1e3:.2f} mm/s² ({value / STANDARD_GRAVITY * 1e3:.3f} mg)"
    if unit == "rad":
        return f"{np.degrees(value):.3f}°"
    return f"{value:.3g} {unit}"


def _triad_lines(label: str, summary: TriadSummary, what: str) -> list[str]:
    text = f"{label:<12} {summary.method}: {len(summary.residuals)} {what}"
    if summary.residuals.size:
        text += f", residual {residual_text(summary.residual_rms, summary.residual_unit)} rms"
    lines = [text]
    for item in summary.excluded[:SHOWN]:
        a, b = item.interval
        what_of_it = "left out" if item.weight == 0 else f"weight {item.weight:.2f}"
        lines.append(f"             {what_of_it}: {a:.2f} to {b:.2f} s, {item.reason}")
    if len(summary.excluded) > SHOWN:
        lines.append(f"             and {len(summary.excluded) - SHOWN} more")
    return lines
