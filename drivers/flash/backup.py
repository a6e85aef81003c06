"""What a device held before it was flashed, on disk before anything is written."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from calib.errors import CalibrationFileError
from drivers.calibration_file import write_atomic
from drivers.flash.target import Native

FORMAT = "imu-cal flash backup"
VERSION = 1


@dataclass(frozen=True)
class Backup:
    """A device's values by their names there, whose they are, and when they were read."""

    address: str
    chip: str
    serial_number: str
    target: str
    date: str
    values: Native


def backup_path(folder: Path, chip: str, now: datetime) -> Path:
    """Return a name that no earlier backup has: ``backup-CHIP-20260102T030405.678Z.json``."""
    stamp = now.astimezone(UTC).strftime("%Y%m%dT%H%M%S.%f")[:-3]
    name = "".join(c if c.isalnum() or c in "-_" else "-" for c in chip) or "device"
    return folder / f"backup-{name}-{stamp}Z.json"


def save_backup(backup: Backup, path: Path) -> None:
    """Write it, whole and on disk, or raise CalibrationFileError; never over an older one."""
    if path.exists():
        raise CalibrationFileError(f"{path}: exists, and a backup is never written over")
    document = {"format": FORMAT, "version": VERSION} | asdict(backup)
    write_atomic(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def load_backup(path: Path) -> Backup:
    """Read a backup.

    Raises
    ------
    CalibrationFileError
        If it is missing, damaged, or no backup; the message names the file.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationFileError(f"{path}: cannot read it: {error.strerror}") from error
    except ValueError as error:
        raise CalibrationFileError(f"{path}: not a backup: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise CalibrationFileError(f"{path}: no backup of `imu-cal flash`")
    if document.get("version") != VERSION:
        raise CalibrationFileError(
            f"{path}: version {document.get('version')}, this imu-cal reads {VERSION}"
        )
    values = document.get("values")
    if not isinstance(values, dict) or not values or not all(map(_is_number, values.values())):
        raise CalibrationFileError(f"{path}: its values are damaged")
    texts = ("address", "chip", "serial_number", "target", "date")
    if not all(isinstance(document.get(key), str) for key in texts):
        raise CalibrationFileError(f"{path}: it does not say whose values these are")
    return Backup(
        **{key: document[key] for key in texts},
        values={name: float(value) for name, value in values.items()},
    )


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
