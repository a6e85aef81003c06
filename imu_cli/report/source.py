"""From a file to its report: a calibration, a diagnosis, or a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calib.document import FORMAT as CALIBRATION
from calib.errors import CalibrationFileError
from imu_cli.report.model import Report

DIAGNOSIS = "imu-cal/diagnosis"


def load_report(path: Path, *, profile: str | None = None, imu: int | None = None) -> Report:
    """Return the report of a file, whatever kind it is.

    Raises
    ------
    CalibrationFileError
        If it is JSON, but neither a calibration nor a diagnosis.
    RecordingError
        If it is no recording either.
    """
    if path.suffix.lower() != ".json" or not path.is_file():
        from drivers.calibration_file import name_of
        from drivers.formats import read_recording
        from imu_cli.report.recording import recording_report

        return recording_report(
            read_recording([path], profile=profile, imu=imu), name=name_of(path)
        )
    kind, document = _kind(path)
    if kind == DIAGNOSIS:
        from imu_cli.report.diagnosis import diagnosis_report

        return diagnosis_report(document)
    from drivers.calibration_file import load_calibration
    from imu_cli.report.contents import calibration_report

    return calibration_report(load_calibration(path))


def _kind(path: Path) -> tuple[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        return CALIBRATION, None  # whose reader says exactly what is wrong
    kind = document.get("format") if isinstance(document, dict) else None
    if kind not in (CALIBRATION, DIAGNOSIS):
        raise CalibrationFileError(
            f"{path}: `format` is {kind!r}; a report is made of a calibration ({CALIBRATION!r}), "
            f"a diagnosis ({DIAGNOSIS!r}) or a recording"
        )
    return kind, document
