"""The columns of a recording as Arrow sees them, and its metadata as text: one schema for all.

Columns are ``time, accel_x .. gyro_z[, temperature], lost`` in SI units (s, m/s², rad/s, °C,
count); Arrow, Parquet and CSV files carry the same names.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_args

import numpy as np
import pyarrow as pa

from calib.errors import EmptyRecordingError, RecordingFormatError
from calib.recording import CHANNELS, Clock, DeviceInfo, Recording
from calib.types import FloatArray
from drivers.formats.assemble import Assembler

CHANNEL_COLUMNS = tuple(name.replace(".", "_") for name in CHANNELS)
REQUIRED = ("time", *CHANNEL_COLUMNS)
OPTIONAL = ("temperature", "lost")
UNITS = {
    "time": "s",
    **{name: "m/s²" if name.startswith("accel") else "rad/s" for name in CHANNEL_COLUMNS},
    "temperature": "°C",
    "lost": "1",
}
VERSION = "1"
DAMAGED = (pa.ArrowException, OSError, UnicodeDecodeError)
"""What pyarrow raises on files that are cut or damaged."""
MOST_LOST = 2.0**53
_DEVICE = {f.name: f.type for f in fields(DeviceInfo)}


def to_text(recording: Recording) -> dict[str, str]:
    """Return the metadata of a recording as text by key; `from_text` is its inverse."""
    out = {"format": f"imu-cal recording {VERSION}", "clock": recording.clock}
    if not recording.complete:
        out["complete"] = "false"
    for name in _DEVICE:
        value = getattr(recording.device, name)
        if value not in (None, ""):
            out[name] = value if isinstance(value, str) else repr(float(value))
    return out | {f"note.{key}": value for key, value in recording.notes.items()}


def from_text(meta: Mapping[str, str], *, name: str, drop_invalid: bool) -> Assembler:
    """Return an assembler with the metadata of a file; keys that are not known become notes."""
    clock = meta.get("clock", "device")
    if clock not in get_args(Clock):
        raise RecordingFormatError(
            f"{name}: clock is {clock!r}, expected one of {', '.join(get_args(Clock))}"
        )
    device: dict[str, Any] = {}
    notes = {}
    for key, value in meta.items():
        if key in _DEVICE:
            device[key] = value if "str" in str(_DEVICE[key]) else _number(key, value, name)
        elif key.startswith("note."):
            notes[key.removeprefix("note.")] = value
        elif key not in ("format", "clock", "complete"):
            notes[key] = value
    return Assembler(
        name=name,
        clock=clock,  # type: ignore[arg-type]
        device=DeviceInfo(**device),
        drop_invalid=drop_invalid,
        notes=notes,
        complete=meta.get("complete", "true") != "false",
    )


def _number(key: str, value: str, name: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not 0 <= number < np.inf:
        raise RecordingFormatError(
            f"{name}: {key} is {value!r}, expected a number in SI units, not negative"
        )
    return number


def schema_of(recording: Recording) -> pa.Schema:
    """Return the schema that a recording is written with, units and metadata in it."""
    names = [*REQUIRED, *(() if recording.temperature is None else ("temperature",)), "lost"]
    meta = to_text(recording)
    packed = {"imu_cal": json.dumps(meta, ensure_ascii=False)}
    return pa.schema(
        [
            pa.field(
                name,
                pa.int64() if name == "lost" else pa.float64(),
                nullable=False,
                metadata={"unit": UNITS[name]},
            )
            for name in names
        ],
        metadata=packed,
    )


def to_batch(recording: Recording, schema: pa.Schema) -> pa.RecordBatch:
    """Return the samples as one record batch."""
    columns: list[Any] = [recording.time, *recording.accel.T, *recording.gyro.T]
    if recording.temperature is not None:
        columns.append(recording.temperature)
    columns.append(recording.lost)
    return pa.record_batch([pa.array(np.ascontiguousarray(c)) for c in columns], schema=schema)


def assembler_of(schema: pa.Schema, *, name: str, drop_invalid: bool) -> Assembler:
    """Check a schema and return the assembler for its batches.

    Raises
    ------
    RecordingFormatError
        If a column is missing, is not a number, or has another unit.
    """
    missing = [column for column in REQUIRED if column not in schema.names]
    if missing:
        raise RecordingFormatError(
            f"{name}: no column {', '.join(missing)} among {', '.join(schema.names[:12])}; "
            f"expected {', '.join(REQUIRED)} in SI units"
        )
    for column in (*REQUIRED, *(c for c in OPTIONAL if c in schema.names)):
        found = schema.field(column)
        if not (pa.types.is_floating(found.type) or pa.types.is_integer(found.type)):
            raise RecordingFormatError(f"{name}: column {column} is {found.type}, not a number")
        unit = (found.metadata or {}).get(b"unit", b"").decode()
        if unit not in ("", UNITS[column]):
            raise RecordingFormatError(
                f"{name}: column {column} is in {unit}, expected {UNITS[column]}"
            )
    packed = (schema.metadata or {}).get(b"imu_cal", b"{}")
    try:
        meta = {str(key): str(value) for key, value in json.loads(packed).items()}
    except (ValueError, AttributeError, RecursionError) as error:
        raise RecordingFormatError(f"{name}: its imu_cal metadata is damaged: {error}") from error
    return from_text(meta, name=name, drop_invalid=drop_invalid)


def column_values(table: Any, column: str) -> FloatArray:
    """Return one column of a table or batch as float64; nulls are NaN."""
    values = table.column(column)
    if not _converts(values.type):
        values = values.cast(pa.float64(), safe=False)
    return np.asarray(values.to_numpy(zero_copy_only=False), np.float64)


def _converts(kind: Any) -> bool:
    """Whether Numpy takes values as they are: a cast loads all that Arrow can compute."""
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def stack_columns(table: Any, names: tuple[str, ...]) -> FloatArray:
    """Return columns of a table or batch side by side, (n, k), each contiguous in memory."""
    out = np.empty((len(names), table.num_rows)).T
    for k, name in enumerate(names):
        values = table.column(name)
        at = 0
        for chunk in values.chunks if hasattr(values, "chunks") else (values,):
            if not _converts(chunk.type):
                chunk = chunk.cast(pa.float64(), safe=False)
            out[at : at + len(chunk), k] = chunk.to_numpy(zero_copy_only=False)
            at += len(chunk)
    return out


def add_table(assembler: Assembler, table: Any) -> Recording | None:
    """Return a table or batch with our columns as a recording."""
    names = table.schema.names
    lost = None
    if "lost" in names:
        counts = column_values(table, "lost")
        good = (counts >= 0) & (counts < MOST_LOST)
        if not good.all():
            row = int(np.argmin(good))
            raise RecordingFormatError(
                f"{assembler.name}, {assembler.row_name(assembler.rows + row)}: lost is "
                f"{counts[row]}, expected a count"
            )
        lost = counts.astype(np.int64)
    return assembler.add(
        column_values(table, "time"),
        stack_columns(table, CHANNEL_COLUMNS[:3]),
        stack_columns(table, CHANNEL_COLUMNS[3:]),
        column_values(table, "temperature") if "temperature" in names else None,
        lost,
    )


def no_samples(name: str) -> EmptyRecordingError:
    """Return the error for a file that has its header, or schema, and nothing more."""
    return EmptyRecordingError(
        f"{name} has a header but no samples; expected at least one row. Was the recording stopped "
        "before it began?"
    )
