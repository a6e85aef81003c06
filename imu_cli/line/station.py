"""The station file: one TOML that says what a station does with every unit.

::

    [station]
    name = "bench-1"
    fixture = "cube A"                    # optional
    operator = "night shift"              # optional; --operator wins
    history = "sqlite:///history.db"      # relative to the station file; any SQLAlchemy URL
    artefacts = "runs"                    # folder for recordings, calibrations, reports

    [device]
    address = "serial:///dev/ttyUSB0?dialect=witmotion"

    [record]
    duration = "90 s"

    [calibrate]                           # optional, all of it
    gravity = "9.80665 m/s²"              # or latitude = "52 deg" and height = 30
    accel_method = "maximum_likelihood"
    gyro_method = "rotation_segment_3x3"

    [flash]                               # without this table nothing is written to the device
    persist = false

    [verify]                              # without this table the unit is not measured again
    duration = "5 s"                      # of the still device

    [limits]                              # see imu_cli.line.limits; also accel.residual_rms, ...
    [findings]
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.gravity import STANDARD_GRAVITY, normal_gravity
from imu_cli.line.errors import StationError
from imu_cli.line.limits import Limits
from imu_cli.line.quantity import parse_quantity

_KEYS = {
    "station": {"name", "fixture", "operator", "history", "artefacts"},
    "device": {"address"},
    "record": {"duration"},
    "calibrate": {"gravity", "latitude", "height", "accel_method", "gyro_method"},
    "flash": {"persist"},
    "verify": {"duration"},
}


@dataclass(frozen=True)
class Station:
    """A station as its file describes it; quantities in SI."""

    name: str
    fixture: str
    operator: str
    history: str
    artefacts: Path
    address: str
    duration: float
    gravity: float
    accel_method: str | None
    gyro_method: str | None
    flash: bool
    persist: bool
    verify_duration: float | None
    limits: Limits


def load_station(path: Path) -> Station:
    """Read a station file.

    Raises
    ------
    StationError
        If it cannot be read; the message names the file, the table and the key.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StationError(f"{path} cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise StationError(f"{path} is no TOML: {error}") from error
    try:
        return _station(tables, path.parent)
    except ValueError as error:
        raise StationError(f"{path}: {error}") from error


def _station(tables: Mapping[str, Any], folder: Path) -> Station:
    unknown = set(tables) - set(_KEYS) - {"limits", "findings"}
    if unknown:
        known = ", ".join([*_KEYS, "limits", "findings"])
        raise ValueError(f"unknown table [{sorted(unknown)[0]}]; known: {known}")
    for table, value in tables.items():
        if not isinstance(value, Mapping):
            raise ValueError(f"{table} must be a table, [{table}], got {value!r}")
    for table, keys in _KEYS.items():
        strange = set(tables.get(table, {})) - keys
        if strange:
            raise ValueError(
                f"[{table}] has the unknown key {sorted(strange)[0]!r}; "
                f"known: {', '.join(sorted(keys))}"
            )
    station = tables.get("station", {})
    calibrate, flash = tables.get("calibrate", {}), tables.get("flash")
    return Station(
        name=_text(station, "station", "name"),
        fixture=_text(station, "station", "fixture", ""),
        operator=_text(station, "station", "operator", ""),
        history=_history(_text(station, "station", "history", "sqlite:///history.db"), folder),
        artefacts=folder / _text(station, "station", "artefacts", "runs"),
        address=_text(tables.get("device", {}), "device", "address"),
        duration=_duration(tables.get("record", {}), "record"),
        gravity=_gravity(calibrate),
        accel_method=calibrate.get("accel_method"),
        gyro_method=calibrate.get("gyro_method"),
        flash=flash is not None,
        persist=_flag(flash or {}, "flash", "persist"),
        verify_duration=_verify_duration(tables.get("verify")),
        limits=Limits.from_tables(tables.get("limits", {}), tables.get("findings", {})),
    )


def _text(table: Mapping[str, Any], name: str, key: str, default: str | None = None) -> str:
    value = table.get(key, default)
    if value is None:
        raise ValueError(f"[{name}] needs {key}")
    if not isinstance(value, str):
        raise ValueError(f"[{name}] {key} must be text in quotes, got {value!r}")
    return value


def _flag(table: Mapping[str, Any], name: str, key: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise ValueError(f"[{name}] {key} must be true or false, without quotes, got {value!r}")
    return value


def _gravity(table: Mapping[str, Any]) -> float:
    if "gravity" in table:
        if "latitude" in table or "height" in table:
            raise ValueError("[calibrate] takes gravity, or latitude and height, not both")
        return parse_quantity(_text(table, "calibrate", "gravity"), unit="m/s²")
    if "latitude" in table:
        latitude = parse_quantity(_text(table, "calibrate", "latitude"), unit="rad")
        height = table.get("height", 0.0)
        if isinstance(height, bool) or not isinstance(height, (int, float)):
            raise ValueError(f"[calibrate] height must be a number of metres, got {height!r}")
        return normal_gravity(latitude, height=height)
    if "height" in table:
        raise ValueError("[calibrate] height needs latitude beside it")
    return STANDARD_GRAVITY


def _duration(table: Mapping[str, Any], name: str, default: str | None = None) -> float:
    text = _text(table, name, "duration", default)
    value = parse_quantity(text, unit="s")
    if not 0 < value < math.inf:
        raise ValueError(f"[{name}] duration must be more than 0 s, and finite, got {text!r}")
    return value


def _verify_duration(table: Mapping[str, Any] | None) -> float | None:
    if table is None:
        return None
    return _duration(table, "verify", "5 s")


def _history(url: str, folder: Path) -> str:
    """Make a relative SQLite path relative to the station file, wherever the run was started."""
    prefix = "sqlite:///"
    if url.startswith(prefix) and not url.startswith(prefix + "/"):
        return f"{prefix}{(folder / url.removeprefix(prefix)).resolve()}"
    return url
