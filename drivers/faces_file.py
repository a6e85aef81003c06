"""Which face of the housing was up in which pose: a small CSV or TOML file.

CSV with a header ``time,up`` or ``pose,up``; TOML with tables ``[[pose]]`` that hold ``time`` or
``pose``, and ``up``. ``time`` is any moment within the pose in recording seconds, ``pose`` its
number from 1, ``up`` the face: ``+X``, ``-X``, ``+Y``, ``-Y``, ``+Z`` or ``-Z``.
"""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path
from typing import Any

from calib.errors import RecordingFormatError
from calib.housing import FACES, FacePose

EXPECTED = "expected CSV with the header `time,up` or `pose,up`, and lines such as `12.5,+Z`"


def read_faces(path: str | Path) -> tuple[FacePose, ...]:
    """Read the file; RecordingFormatError says which line or table is wrong."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingFormatError(f"{path}: cannot read the housing faces: {error}") from error
    rows = _toml_rows(path, text) if path.suffix.lower() == ".toml" else _csv_rows(path, text)
    faces = tuple(_face(f"{path}, {where}", row) for where, row in rows)
    if not faces:
        raise RecordingFormatError(f"{path}: names no pose; {EXPECTED}")
    return faces


def _toml_rows(path: Path, text: str) -> list[tuple[str, dict[str, Any]]]:
    try:
        tables = tomllib.loads(text).get("pose", [])
    except tomllib.TOMLDecodeError as error:
        raise RecordingFormatError(f"{path}: not TOML: {error}") from error
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise RecordingFormatError(f"{path}: expected tables [[pose]] with time or pose, and up")
    return [(f"[[pose]] {k + 1}", table) for k, table in enumerate(tables)]


def _csv_rows(path: Path, text: str) -> list[tuple[str, dict[str, Any]]]:
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    names = [name.strip() for name in lines[0][1].split(",")] if lines else []
    if "up" not in names or not {"time", "pose"} & set(names):
        raise RecordingFormatError(f"{path}: {EXPECTED}; found {','.join(names)[:60]!r}")
    rows = csv.reader(line for _, line in lines[1:])
    return [
        (f"line {number}", dict(zip(names, (cell.strip() for cell in row), strict=False)))
        for (number, _), row in zip(lines[1:], rows, strict=True)
    ]


def _face(where: str, row: dict[str, Any]) -> FacePose:
    up = str(row.get("up", "")).upper()
    if up not in FACES:
        raise RecordingFormatError(f"{where}: up is {up!r}, expected one of {', '.join(FACES)}")
    try:
        if row.get("pose") not in (None, ""):
            return FacePose(up, pose=int(row["pose"]))
        return FacePose(up, time=float(row["time"]))
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingFormatError(
            f"{where}: expected a time in seconds or the number of a pose, found {row}"
        ) from error
