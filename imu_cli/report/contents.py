"""A calibration as a report: what it is worth, where it comes from, and how sure it is."""

from __future__ import annotations

import numpy as np

from calib.calibration import Calibration, TriadSummary
from calib.document import to_document
from calib.gravity import STANDARD_GRAVITY
from calib.recording import AXES
from calib.types import FloatArray
from calib.uncertainty import half_width, uncertainty_budget
from imu_cli.report.model import Block, HeatMap, Paragraph, Plot, Report, Series, Sphere, Table
from imu_cli.report.units import parameter_text, people_unit

MG = 1e3 / STANDARD_GRAVITY


def calibration_report(calibration: Calibration) -> Report:
    """Return the report of a calibration."""
    before, after = _errors_at_rest(calibration)
    if calibration.complete:
        verdict = f"Calibrated: all {len(calibration.names)} parameters are determined."
    else:
        verdict = (
            f"Partly calibrated: {len(calibration.names)} parameters are determined, "
            f"{len(calibration.undetermined)} are not."
        )
    blocks: list[Block] = []
    if not calibration.complete:
        advice = [a for s in _summaries(calibration) for a in s.advice]
        blocks.append(
            Paragraph(
                "What is missing",
                (f"Not determined: {', '.join(calibration.undetermined)}.", *advice),
            )
        )
    excluded = [e for s in _summaries(calibration) for e in s.excluded]
    if excluded:
        blocks.append(
            Paragraph(
                "Left out or down-weighted",
                tuple(
                    f"{e.interval[0]:.1f} to {e.interval[1]:.1f} s (weight {e.weight:.2f}): "
                    f"{e.reason}"
                    for e in excluded
                ),
            )
        )
    blocks.append(_parameters(calibration))
    if before is not None and after is not None:
        blocks += [
            _at_rest(calibration, before, after),
            _left(calibration, after),
            _sphere(calibration),
        ]
    if calibration.gyro is not None and calibration.gyro.residuals.size:
        blocks.append(_turns(calibration.gyro))
    if len(calibration.names) > 1:
        blocks.append(_correlation(calibration))
    blocks += [_budget(calibration), _provenance(calibration)]
    return Report(
        title="Calibration",
        verdict=verdict,
        tone="good" if calibration.complete else "partial",
        facts=_facts(calibration, before, after),
        blocks=tuple(blocks),
        certificate=_certificate(calibration),
        document=to_document(calibration),
    )


def _summaries(calibration: Calibration) -> list[TriadSummary]:
    return [s for s in (calibration.accel, calibration.gyro) if s is not None]


def _errors_at_rest(calibration: Calibration) -> tuple[FloatArray | None, FloatArray | None]:
    """Return |a| - g at each pose before and after the calibration, m/s²."""
    poses = calibration.poses
    if poses is None or not len(poses.accel):
        return None, None
    g = calibration.gravity.value
    corrected = calibration.model.accel.correct(poses.accel)
    return (
        np.linalg.norm(poses.accel, axis=1) - g,
        np.linalg.norm(corrected, axis=1) - g,
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _facts(
    calibration: Calibration, before: FloatArray | None, after: FloatArray | None
) -> tuple[tuple[str, str], ...]:
    facts = []
    if before is not None and after is not None:
        facts.append(
            ("error of |a| at rest", f"{_rms(before) * MG:.3g} → {_rms(after) * MG:.3g} mg")
        )
        facts.append(("poses", str(len(after))))
    if calibration.gyro is not None and calibration.gyro.residuals.size:
        angle = np.degrees(np.linalg.norm(np.atleast_2d(calibration.gyro.residuals), axis=-1))
        facts.append(("angle left per turn", f"{_rms(angle):.3g}°"))
        facts.append(("turns", str(len(angle))))
    if calibration.temperature is not None:
        span = calibration.temperature
        facts.append(("temperature", f"{span.low:.1f} to {span.high:.1f} °C"))
    return tuple((name, value.replace(" ", "\u00a0")) for name, value in facts)


def _parameters(calibration: Calibration) -> Table:
    values, sigmas = calibration.values, calibration.sigmas
    rows = []
    for name in [*calibration.names, *calibration.undetermined]:
        if name in sigmas:
            value, error, unit = parameter_text(name, values[name], sigmas[name])
            rows.append((name, value, error, unit))
        else:
            rows.append((name, "not determined", "", ""))
    return Table(
        "Parameters", ("parameter", "value", "standard error", "unit"), tuple(rows), (1, 2)
    )


def _at_rest(calibration: Calibration, before: FloatArray, after: FloatArray) -> Plot:
    number = np.arange(1.0, len(after) + 1)
    assert calibration.poses is not None
    text = [f"{a:.1f} to {b:.1f} s" for a, b in calibration.poses.interval]
    return Plot(
        "Error of |a| in each pose",
        "pose",
        "|a| - g, mg",
        (
            Series("before", number, before * MG, "bars", text),
            Series("after", number, after * MG, "bars", text),
        ),
        note="At rest the magnitude of specific force is that of gravity, whatever the pose.",
    )


def _left(calibration: Calibration, after: FloatArray) -> Plot:
    assert calibration.poses is not None
    text = [f"{a:.1f} to {b:.1f} s" for a, b in calibration.poses.interval]
    series = Series("after", np.arange(1.0, len(after) + 1), after * MG, "bars", text)
    return Plot("Error left in each pose", "pose", "|a| - g after, mg", (series,))


def _turns(summary: TriadSummary) -> Plot:
    angle = np.degrees(np.linalg.norm(np.atleast_2d(summary.residuals), axis=-1))
    text = [f"{a:.1f} to {b:.1f} s" for a, b in summary.intervals]
    number = np.arange(1.0, len(angle) + 1)
    return Plot(
        "Angle left in each turn",
        "turn",
        "gyroscope against gravity, °",
        (Series("after", number, angle, "bars", text),),
        note="What the calibrated gyroscope says of a turn, less what gravity says of its ends.",
    )


def _sphere(calibration: Calibration) -> Sphere:
    assert calibration.poses is not None
    corrected = calibration.model.accel.correct(calibration.poses.accel)
    up = corrected / np.linalg.norm(corrected, axis=1, keepdims=True)
    text = [
        f"pose {k + 1}: {a:.1f} to {b:.1f} s" for k, (a, b) in enumerate(calibration.poses.interval)
    ]
    return Sphere("Where up was, in the sensor's frame", up, text)


def _correlation(calibration: Calibration) -> HeatMap:
    sigma = np.sqrt(np.diag(calibration.covariance))
    sigma = np.where(sigma > 0, sigma, 1.0)
    return HeatMap(
        "Correlation of the parameters",
        calibration.names,
        calibration.covariance / np.outer(sigma, sigma),
        "Far from the diagonal it should be pale: strong colours are parameters that this "
        "recording can hardly tell apart.",
    )


def _budget(calibration: Calibration) -> Table:
    rows = []
    for item in uncertainty_budget(calibration):
        unit, factor = people_unit(item.unit)
        parts = ", ".join(f"{name} {u * factor:.2g}" for name, u in item.type_b.items()) or "-"
        rows.append(
            (
                item.name,
                f"{item.type_a * factor:.2g}",
                parts,
                f"{item.combined * factor:.2g}",
                f"{item.expanded * factor:.2g}",
                unit,
            )
        )
    measured = calibration.temperature is not None
    return Table(
        "Uncertainty budget",
        ("parameter", "type A (fit)", "type B", "combined", "expanded, k = 2", "unit"),
        tuple(rows),
        (1, 3, 4),
        "After the GUM. Temperature: typical coefficients of consumer parts over "
        f"±{half_width(calibration):.1f} K "
        + ("around the temperatures of the poses." if measured else "(none was recorded).")
        + " An expanded uncertainty with k = 2 covers about 95 %.",
    )


def _provenance(calibration: Calibration) -> Table:
    provenance = calibration.provenance
    device = provenance.device
    rows = [
        ("gravity", f"{calibration.gravity.value:.5f} m/s², {calibration.gravity.source}"),
        ("accelerometer method", calibration.accel.method if calibration.accel else "not solved"),
        ("gyroscope method", calibration.gyro.method if calibration.gyro else "not solved"),
        ("device", " ".join(filter(None, (device.chip, device.serial_number))) or "unknown"),
        ("date", provenance.date or "unknown"),
        ("imu-cal", provenance.tool_version or "unknown"),
        *((f"input {item.name}", f"sha256 {item.sha256}") for item in provenance.inputs),
        *provenance.notes.items(),
    ]
    return Table("Provenance", ("", ""), tuple(rows))


def _certificate(calibration: Calibration) -> tuple[tuple[str, str], ...]:
    device = calibration.provenance.device
    notes = calibration.provenance.notes
    return (
        ("Instrument", device.chip or "unknown"),
        ("Serial number", device.serial_number or notes.get("serial", "unknown")),
        ("Date of calibration", calibration.provenance.date or "unknown"),
        ("Operator", notes.get("operator", "")),
        ("Method", ", ".join(s.method for s in _summaries(calibration)) or "none"),
        ("Axes", "right-handed frame of the accelerometer: " + ", ".join(AXES)),
    )
