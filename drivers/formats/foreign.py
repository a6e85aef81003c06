"""Text logs of other programs, read through an import profile."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from calib.errors import RecordingFormatError
from calib.recording import Recording
from calib.types import FloatArray
from drivers.formats.assemble import Assembler
from drivers.formats.base import Format, ReadOptions, Source
from drivers.formats.columns import column_values, no_samples, stack_columns
from drivers.formats.profile import Column, Profile, TimeColumn, TriadColumns, shipped_profiles
from drivers.formats.text import TextTable, decode_head

DELIMITERS = (",", ";", "\t", " ")


class Foreign(Format):
    """Any other text log."""

    name = "text"
    title = "text log of another program"
    suffixes = (".log", ".dat", ".tsv", ".csv", ".txt")
    binary = False

    def sniff(self, head: bytes) -> bool:
        """Recognise the logs for which a profile ships."""
        text = decode_head(head)
        return text is not None and find_profile(text) is not None

    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Read rows through the profile that was given, or that recognises the file."""
        text = decode_head(source.head)
        if text is None:
            raise RecordingFormatError(f"{source.path} is not text, expected a text log")
        profile = options.profile or find_profile(text)
        if profile is None:
            raise RecordingFormatError(_unknown(source, text))
        yield from read_text(source, text, profile, options)


FORMAT = Foreign()


def find_profile(text: str) -> Profile | None:
    """Return the one shipped profile that recognises the start of a file, if there is one."""
    found = [profile for profile in shipped_profiles().values() if profile.recognises(text)]
    return found[0] if len(found) == 1 else None


def read_text(
    source: Source, text: str, profile: Profile, options: ReadOptions
) -> Iterator[Recording]:
    """Read the rows of one file, both triads in it."""
    profile = profile.for_file(text)
    table, names = open_table(source, text, profile)
    if profile.accel is None or profile.gyro is None:
        raise RecordingFormatError(
            f"profile {profile.name} has no {'[accel]' if profile.accel is None else '[gyro]'}"
        )
    types = _types(source, text, profile, names)
    assembler = Assembler(
        name=str(source.path),
        clock=profile.clock,
        device=profile.device,
        drop_invalid=options.drop_invalid,
        row_name=table.line_name,
        notes={"profile": profile.name, **profile.notes},
    )
    if options.profile is None:
        assembler.notes["profile"] += " (recognised from the file)"
    if table.cut:
        assembler.complete = False
        assembler.notes["cut"] = table.cut
    clock = Timekeeper(profile)
    for part in table.read(types, batch=options.batch):
        seconds = clock.seconds(part, names)
        temperature = None
        if profile.temperature is not None:
            values = column_values(part, _find(names, profile.temperature.column, source, profile))
            temperature = profile.temperature.factor * values + profile.temperature.zero
        recording = assembler.add(
            seconds,
            _triad(part, names, profile.accel, source, profile),
            _triad(part, names, profile.gyro, source, profile),
            temperature,
        )
        if recording is not None:
            yield recording
    if not assembler.rows:
        raise no_samples(str(source.path))


class Timekeeper:
    """Seconds of each row, running on from batch to batch."""

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self._rows = 0
        self._first: Any = None
        self._turns = 0
        self._last: float | None = None

    def seconds(self, part: Any, names: list[str]) -> FloatArray:
        """Return the time of the rows of one batch, (n,) s."""
        count, time = part.num_rows, self._profile.time
        start = self._rows
        self._rows += count
        if time is None or time.column is None:
            assert self._profile.rate is not None
            return np.arange(start, start + count) / self._profile.rate
        values = part.column(names[_position(names, time.column) or 0])
        if time.factor is None:
            stamps = np.asarray(values.to_numpy(zero_copy_only=False), "datetime64[ns]")
            return self._scaled(stamps.astype(np.int64), 1e-9)
        if pa.types.is_integer(values.type) and not values.null_count:
            stamps = np.asarray(values.to_numpy(zero_copy_only=False), np.int64)
            return self._scaled(self._unwrapped(stamps, time), time.factor)
        stamps = np.asarray(values.cast(pa.float64()).to_numpy(zero_copy_only=False), np.float64)
        return self._scaled(self._unwrapped(stamps, time), time.factor)

    def _scaled(self, stamps: Any, factor: float) -> FloatArray:
        if self._first is None and len(stamps):
            self._first = stamps[0]
        return np.asarray(stamps - self._first, np.float64) * factor

    def _unwrapped(self, stamps: Any, time: TimeColumn) -> Any:
        if time.wraps is None or not len(stamps):
            return stamps
        before = stamps[0] if self._last is None else self._last
        step = np.diff(stamps, prepend=before)
        turns = self._turns + np.cumsum(step < -time.wraps / 2)
        self._last, self._turns = stamps[-1], int(turns[-1])
        return stamps + turns * time.wraps


def open_table(source: Source, text: str, profile: Profile) -> tuple[TextTable, list[str]]:
    """Return the rows of a file and the names of its columns (``1, 2, ..`` without a header)."""
    lines = text.splitlines()
    at = profile.skip_lines
    while at < len(lines) and (lines[at].startswith("#") or not lines[at].strip()):
        at += 1
    if at >= len(lines):
        raise no_samples(str(source.path))
    delimiter = profile.delimiter or _guess_delimiter(lines[at])
    fields = split_line(lines[at], delimiter)
    if profile.header:
        names = [name.strip().strip('"') for name in fields]
        at += 1
    else:
        names = [str(number + 1) for number in range(len(fields))]
    for triad in (profile.accel, profile.gyro):
        for column in triad.columns if triad else ():
            _find(names, column, source, profile)
    return (
        TextTable(source, delimiter=delimiter, names=names, skip_lines=at, decimal=profile.decimal),
        names,
    )


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the fields of a line; a space stands for any run of blanks."""
    return line.split() if delimiter == " " else line.rstrip("\r\n").split(delimiter)


def _guess_delimiter(line: str) -> str:
    return next((d for d in DELIMITERS if d in line.strip()), ",")


def _position(names: list[str], column: Column) -> int | None:
    if isinstance(column, int):
        return column - 1 if column <= len(names) else None
    return names.index(column) if column in names else None


def _find(names: list[str], column: Column, source: Source, profile: Profile) -> str:
    """Return the name of a column in the table."""
    position = _position(names, column)
    if position is None:
        raise RecordingFormatError(
            f"{source.path} does not fit profile {profile.name}: it has no column {column!r} among "
            f"{', '.join(names[:12])}"
        )
    return names[position]


def _types(source: Source, text: str, profile: Profile, names: list[str]) -> dict[str, Any]:
    types: dict[str, Any] = {}
    for triad in (profile.accel, profile.gyro):
        for column in triad.columns if triad else ():
            types[_find(names, column, source, profile)] = pa.float64()
    if profile.temperature is not None:
        types[_find(names, profile.temperature.column, source, profile)] = pa.float64()
    if profile.time is not None and profile.time.column is not None:
        name = _find(names, profile.time.column, source, profile)
        types[name] = pa.timestamp("ns") if profile.time.factor is None else pa.float64()
        if profile.time.factor is not None and profile.time.factor < 1:
            types[name] = _stamp_type(text, names.index(name))
    return types


def _stamp_type(text: str, position: int) -> Any:
    """Return int64 where the stamps are whole numbers: nanoseconds since 1970 need all 64 bits."""
    last = text.splitlines()[-1]
    fields = re.split(r"[,;\t ]", last)
    whole = position < len(fields) and re.fullmatch(r"[+-]?\d+", fields[position].strip())
    return pa.int64() if whole else pa.float64()


def _triad(
    part: Any, names: list[str], triad: TriadColumns, source: Source, profile: Profile
) -> FloatArray:
    columns = tuple(_find(names, column, source, profile) for column in triad.columns)
    return triad.to_si(stack_columns(part, columns))


def _unknown(source: Source, text: str) -> str:
    """Return what to do with a text log that no profile recognises."""
    rows = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    first = rows[0] if rows else ""
    delimiter = _guess_delimiter(rows[-1] if rows else "")
    count = len(split_line(rows[-1], delimiter)) if rows else 0
    fits = [
        profile.name
        for profile in shipped_profiles().values()
        if profile.format == "text" and profile.pattern is None
    ]
    numbers = rows and all(re.fullmatch(r"[-+0-9.eE]+", f) for f in split_line(first, delimiter))
    if rows and not re.search(r"\d", rows[-1]):
        return (
            f"{source.path} is text but no log: its lines hold no numbers (first: {first[:60]!r}). "
            "Expected rows of at least 6 numbers"
        )
    if count < 6:
        return (
            f"{source.path} is no IMU log: {count} columns ({first[:60]!r}), expected at least 6 "
            "(three of the accelerometer, three of the gyroscope)"
        )
    what = f"{count} columns of numbers without names" if numbers else f"the header {first[:80]!r}"
    return (
        f"{source.path}: cannot tell columns and units from {what}. Say which import profile it "
        f"has: --profile {' or '.join(fits)}, or --profile FILE.toml with your own "
        "(columns, units and rate in a few lines; see docs, 'Import profiles')"
    )
