"""A calibration as a person reads it: tables with standard errors, in SI and in everyday units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calib.calibration import Calibration, TriadSummary, parameter_unit
from calib.effects import get_effect
from calib.effects.base import PRESENCE
from calib.gravity import STANDARD_GRAVITY
from imu_cli.output import console, styled
from imu_cli.report.units import people_unit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table
    from rich.text import Text

EVERYDAY = {
    "accel.bias": (1e3 / STANDARD_GRAVITY, "mg"),
    "gyro.bias": (np.degrees(1.0), "°/s"),
    "accel.scale_factor_error": (100.0, "%"),
    "gyro.scale_factor_error": (100.0, "%"),
    "accel.misalignment": (np.degrees(1.0), "°"),
    "gyro.misalignment": (np.degrees(1.0), "°"),
}
"""Factor and unit in which people know each group of parameters."""

NUMBER = 11
"""Characters of a number: a narrow window takes none of them away."""

HEADING = len("value ± std error")

FOLDED = 7
"""Characters of ``(rad/s)/(m/s²)`` on each of two lines."""

SHOWN = 4
"""So many of what was left out are listed on the screen; the file has all."""


def plus_minus(value: float, sigma: float | None) -> str:
    """Return ``value ± sigma`` with two digits of sigma, or the value alone."""
    if sigma is None:
        return f"{value:.5g}"
    if not sigma > 0:
        return f"{value:.6g} ± 0"
    decimals = max(0, 1 - int(np.floor(np.log10(sigma))))
    if decimals > 8 or max(abs(value), sigma) >= 1e6:
        return f"{value:.4g} ± {sigma:.2g}"
    # Adding 0 makes a plain zero of what rounds to minus zero.
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {sigma:.{decimals}f}"


def parameter_table(calibration: Calibration) -> Table:
    """Return the table of all parameters that are determined or should be.

    A window that is too narrow for both has the SI units alone, and breaks lines between numbers.
    """
    from rich.table import Table

    rows: list[list[str | Text]] = []
    sigmas = calibration.sigmas
    previous = ""
    for name, value in calibration.values.items():
        status = calibration.status(name)
        if status == "fixed" and not value:
            continue
        group = name.rsplit(".", 1)[0]
        if previous and group.partition(".")[0] != previous.partition(".")[0]:
            rows.append([])
        previous = group
        unit = parameter_unit(name)
        if unit == PRESENCE:  # what it is like is in the rows after it
            continue
        unit = "" if unit == "1" else unit
        if status == "undetermined":
            rows.append([name, styled(("undetermined", "yellow")), unit, "", ""])
            continue
        sigma = sigmas.get(name)
        cells: list[str | Text] = [name, plus_minus(value, sigma), unit, "", ""]
        factor, people = everyday(name)
        if people != parameter_unit(name):
            scaled = None if sigma is None else factor * sigma
            cells[3:] = [plus_minus(factor * value, scaled), people]
        rows.append(cells)
    wide = _width(rows) <= console().width
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    table.add_column("parameter", overflow="fold", no_wrap=wide)
    table.add_column("value ± std error", justify="right", min_width=NUMBER, no_wrap=wide)
    table.add_column("unit", overflow="fold")
    if wide:
        table.add_column("", justify="right", min_width=NUMBER, no_wrap=True)
        table.add_column("", overflow="fold", no_wrap=True)
    for row in rows:
        table.add_row(*(row if wide else row[:3]))
    return table


def everyday(name: str) -> tuple[float, str]:
    """Return factor and unit in which people know a parameter; its own where they know no other."""
    group = name.rpartition(".")[0]
    if group in EVERYDAY:
        return EVERYDAY[group]
    unit, factor = people_unit(parameter_unit(name))
    return factor, unit


def _width(rows: Sequence[Sequence[str | Text]]) -> int:
    """Return how wide both units are, where an SI unit may be folded but no name and no number."""
    most = [max((len(row[k]) for row in rows if row), default=0) for k in range(5)]
    most[1], most[2], most[3] = max(most[1], HEADING), min(most[2], FOLDED), max(most[3], NUMBER)
    return sum(most) + len(most) - 1


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
        if get_effect(event.effect).kind == "setup":
            lines.append(f"set-up       {event.effect}: of how it was recorded, not of the sensor")
            continue
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
