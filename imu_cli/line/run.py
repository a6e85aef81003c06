"""One unit, unattended: record, audit, calibrate, diagnose, limits, flash, verify, report.

Whatever happens, the run ends in one of four outcomes and stands whole in the history. A limit that
fails stops the run before anything is written to the device.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from calib.audit import audit
from calib.calibrate import ACCEL_METHOD, GYRO_METHOD, calibrate
from calib.calibration import Calibration, Gravity, Provenance
from calib.errors import EmptyRecordingError, FlashError, FlashStateError, ImuError
from calib.mismatch import diagnose_recording
from calib.recording import Recording
from calib.units import check_units
from calib.verify import verify
from drivers.calibration_file import describe_input, save_calibration, write_atomic
from drivers.formats import read_recording
from drivers.record import RecordLimits, RecordState, record
from drivers.transports import make_driver
from imu_cli.line.limits import Check, Measured
from imu_cli.line.station import Station
from imu_cli.line.store import (
    ArtefactRow,
    CheckRow,
    FindingRow,
    History,
    Outcome,
    ParameterRow,
    Run,
    RunResult,
)
from imu_cli.line.summary import unit_record

EXIT_CODES: dict[str, int] = {"PASS": 0, "FAIL": 6, "ERROR": 11, "ABORTED": 130}


class AbortedError(Exception):
    """The operator stopped the run."""


@dataclass
class _Work:
    """What a run has gathered so far; all of it goes into the history, however the run ends."""

    folder: Path
    calibration: Calibration | None = None
    residuals: list[Measured] = field(default_factory=list)
    checks: list[Check] = field(default_factory=list)
    findings: list[tuple[str, float | None, str]] = field(default_factory=list)
    artefacts: dict[str, Path] = field(default_factory=dict)
    steps: list[dict[str, Any]] = field(default_factory=list)
    unverified: bool = False
    """Whether the device holds new values that were not verified yet."""

    def reason(self, why: str) -> str:
        """Return why the run ended early, and what that leaves in the device."""
        return f"{why}; the unit is flashed, and was not verified" if self.unverified else why


def run_unit(
    station: Station,
    history: History,
    *,
    serial_number: str,
    operator: str,
    stop: threading.Event,
    report: Callable[[str], None],
) -> dict[str, Any]:
    """Run one unit through the station and return its record.

    Parameters
    ----------
    stop : Event
        Set it to abort the run between or within steps.
    report : callable
        Is told each step as it begins.

    Raises
    ------
    HistoryError
        If the unit is being run elsewhere, or the history cannot be written.
    """
    run = history.begin(
        serial_number=serial_number,
        station=station.name,
        fixture=station.fixture,
        operator=operator or station.operator,
        tool_version=version("imu-cal"),
        now=datetime.now(UTC),
    )
    folder = station.artefacts / serial_number / f"{run.attempt:03d}"
    work = _Work(folder)
    outcome, reason = _attempt(station, run, work, stop=stop, report=report)
    result = RunResult(
        outcome,
        reason,
        parameters=[
            ParameterRow(
                name=item.name, value=item.value, standard_error=item.standard_error, unit=item.unit
            )
            for item in _measured(work)
        ],
        checks=[_check_row(position, item) for position, item in enumerate(work.checks)],
        findings=[
            FindingRow(position=position, effect=effect, p_value=p_value, action=action)
            for position, (effect, p_value, action) in enumerate(work.findings)
        ],
        artefacts=[
            ArtefactRow(name=name, path=str(path), sha256=describe_input(path).sha256)
            for name, path in work.artefacts.items()
        ],
    )
    history.end(run, result, now=datetime.now(UTC))
    (ended,) = [r for r in history.runs(serial_number=serial_number) if r.id == run.id]
    return {
        "format": "imu-cal/run",
        "version": 1,
        "exit_code": EXIT_CODES[outcome],
        **unit_record(ended),
        "steps": work.steps,
    }


def _attempt(
    station: Station,
    run: Run,
    work: _Work,
    *,
    stop: threading.Event,
    report: Callable[[str], None],
) -> tuple[Outcome, str]:
    try:
        return _steps(station, run, work, stop=stop, report=report)
    except AbortedError:
        return "ABORTED", work.reason("stopped by the operator")
    except KeyboardInterrupt:
        return "ABORTED", work.reason("interrupted by the operator")
    except (ImuError, ValueError, OSError) as error:
        put_back = isinstance(error, FlashError) and not isinstance(error, FlashStateError)
        stopped = put_back and isinstance(error.__cause__, KeyboardInterrupt)
        where = work.steps[-1]["name"] if work.steps else "start"
        return "ABORTED" if stopped else "ERROR", work.reason(f"{where}: {error}")


def _steps(
    station: Station,
    run: Run,
    work: _Work,
    *,
    stop: threading.Event,
    report: Callable[[str], None],
) -> tuple[Outcome, str]:
    @contextmanager
    def step(name: str) -> Iterator[dict[str, Any]]:
        if stop.is_set():
            raise AbortedError
        report(name)
        entry: dict[str, Any] = {"name": name}
        work.steps.append(entry)
        start = time.monotonic()
        yield entry
        entry["seconds"] = round(time.monotonic() - start, 3)

    work.folder.mkdir(parents=True, exist_ok=True)
    with step("record") as entry:
        recording = _record(station, work, entry, stop=stop)
    with step("audit") as entry:
        check_units(recording)
        entry["findings"] = [item.kind for item in audit(recording).findings]
    with step("calibrate"):
        calibration = _calibrate(station, run, work, recording)
    with step("diagnose") as entry:
        entry["verdict"] = _diagnose(station, work, recording)
    with step("limits"):
        work.checks += station.limits.check(_measured(work), [name for name, _, _ in work.findings])
        work.checks += [
            Check(f"{name}.determined", None, "", None, None, False, "fail")
            for name in calibration.undetermined
        ]
        failed = [item.name for item in work.checks if item.failed]
    left = calibration
    if station.flash and not failed:
        with step("flash") as entry:
            left = _flash(station, work, calibration, entry, report=report)
    if station.verify_duration is not None and not failed:
        with step("verify") as entry:
            failed += _verify(station, work, left, entry, stop=stop)
    with step("report"):
        _report(work, calibration)
    if failed:
        return "FAIL", "outside of limits: " + ", ".join(failed)
    return "PASS", ""


def _record(
    station: Station, work: _Work, entry: dict[str, Any], *, stop: threading.Event
) -> Recording:
    path = work.folder / "recording.arrow"
    state = _acquire(station, path, station.duration, stop=stop)
    work.artefacts["recording"] = path
    entry |= {"samples": state.samples, "lost": state.lost, "ended_by": state.ended_by}
    return read_recording(path)


def _acquire(
    station: Station, path: Path, duration: float, *, stop: threading.Event
) -> RecordState:
    state = record(
        make_driver(station.address),
        path,
        limits=RecordLimits(duration, None),
        raw=None,
        reconnect=False,
        stop=stop,
        progress=lambda state: None,
    )
    if stop.is_set():
        raise AbortedError
    if not state.samples:
        raise EmptyRecordingError(f"no sample came from {station.address}; nothing was recorded")
    return state


def _calibrate(station: Station, run: Run, work: _Work, recording: Recording) -> Calibration:
    notes = {"station": station.name, "serial": run.serial_number}
    if run.operator:
        notes["operator"] = run.operator
    if station.fixture:
        notes["fixture"] = station.fixture
    calibration = calibrate(
        recording,
        gravity=Gravity(station.gravity, "station file"),
        accel_method=station.accel_method or ACCEL_METHOD,
        gyro_method=station.gyro_method or GYRO_METHOD,
        provenance=Provenance(
            (describe_input(work.artefacts["recording"]),),
            version("imu-cal"),
            datetime.now(UTC).isoformat(timespec="seconds"),
            notes=notes,
        ),
    )
    work.calibration = calibration
    path = work.folder / "calibration.cal.json"
    save_calibration(calibration, path)
    work.artefacts["calibration"] = path
    for name in ("accel", "gyro"):
        summary = getattr(calibration, name)
        if summary is not None and summary.residuals.size:
            work.residuals.append(
                Measured(f"{name}.residual_rms", summary.residual_rms, None, summary.residual_unit)
            )
    return calibration


def _diagnose(station: Station, work: _Work, recording: Recording) -> str:
    import json

    assert work.calibration is not None
    diagnosis = diagnose_recording(recording, gravity=station.gravity, model=work.calibration.model)
    path = work.folder / "diagnosis.json"
    write_atomic(path, json.dumps(diagnosis.to_json(), indent=2, allow_nan=False) + "\n")
    work.artefacts["diagnosis"] = path
    limits = station.limits
    found = [(item.effect, item.p_value) for item in diagnosis.findings]
    found += [("unexplained", item.p_value) for item in diagnosis.unexplained]
    work.findings += [
        (effect, p_value, limits.findings.get(effect, limits.default_finding))
        for effect, p_value in found
    ]
    return diagnosis.verdict


def _flash(
    station: Station,
    work: _Work,
    calibration: Calibration,
    entry: dict[str, Any],
    *,
    report: Callable[[str], None],
) -> Calibration:
    from drivers.flash import make_target
    from drivers.flash.procedure import flash_device

    with make_target(station.address) as target:
        result = flash_device(
            target,
            calibration,
            backup=work.folder / "backup.json",
            persist=station.persist,
            duration=3.0,
            report=report,
        )
        work.unverified = True
    work.artefacts["backup"] = result.backup
    path = work.folder / "left.cal.json"
    save_calibration(result.left, path)
    work.artefacts["left"] = path
    entry["persisted"] = result.persisted
    return result.left


def _verify(
    station: Station,
    work: _Work,
    left: Calibration,
    entry: dict[str, Any],
    *,
    stop: threading.Event,
) -> list[str]:
    path = work.folder / "verify.arrow"
    assert station.verify_duration is not None
    _acquire(station, path, station.verify_duration, stop=stop)
    work.artefacts["verify"] = path
    result = verify(left, read_recording(path))
    work.unverified = False
    entry["right"] = result.right
    entry["not_tested"] = [item.name for item in result.not_tested]
    for item in result.checks:
        work.checks.append(
            Check(
                f"verify.{item.name}",
                item.rms,
                item.unit,
                None,
                item.expected,
                item not in result.failed,
                "fail",
            )
        )
    return [f"verify.{item.name}" for item in result.failed]


def _report(work: _Work, calibration: Calibration) -> None:
    from imu_cli.report.contents import calibration_report
    from imu_cli.report.page import render_page

    path = work.folder / "report.html"
    write_atomic(path, render_page(calibration_report(calibration)))
    work.artefacts["report"] = path


def _measured(work: _Work) -> list[Measured]:
    if work.calibration is None:
        return []
    from calib.calibration import parameter_unit

    values, sigmas = work.calibration.values, work.calibration.sigmas
    parameters = [
        Measured(name, values[name], sigmas[name], parameter_unit(name))
        for name in work.calibration.names
    ]
    return parameters + work.residuals


def _check_row(position: int, check: Check) -> CheckRow:
    return CheckRow(
        position=position,
        name=check.name,
        value=check.value,
        low=check.low,
        high=check.high,
        unit=check.unit,
        passed=check.passed,
        action=check.action,
    )
