"""Text logs of other programs, read through an import profile."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from calib.errors import RecordingFormatError
from calib.recording import Recording
from calib.types import FloatArray
from drivers.formats.assemble import Assembler
from drivers.formats.base import Format, ReadOptions, Source
from drivers.formats.columns import column_values, no_samples, stack_columns
from drivers.formats.header import EXAMPLE, profile_of_header
from drivers.formats.profile import Column, Profile, TimeColumn, TriadColumns, shipped_profiles
from drivers.formats.text import TextTable, decode_head

DELIMITERS = (",", ";", "\t", " ")

EXACT = 15
"""Digits of a whole number up to which a floating point number is exact."""


class Foreign(Format):
    """Any other text log."""

    name = "text"
    title = "text log of another program"
    suffixes = (".log", ".dat", ".tsv", ".csv", ".txt")
    binary = False

    def sniff(self, head: bytes) -> bool:
        """Recognise the logs for which a profile ships, and headers that name their units."""
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
    """Return the one shipped profile that recognises the start of a file, or that of its header."""
    found = [profile for profile in shipped_profiles().values() if profile.recognises(text)]
    if len(found) == 1:
        return found[0]
    lines = _rows(text)[:2]
    if not lines:
        return None
    delimiter = _guess_delimiter(lines[0])
    names, *first = (list(map(_unquoted, split_line(line, delimiter))) for line in lines)
    return profile_of_header(names, *first)


class TextLog:
    """One text file under a profile: the rows of some triads, in SI, batch by batch.

    Raises
    ------
    RecordingFormatError
        If the file does not fit the profile.
    EmptyRecordingError
        If there is no line of samples.
    """

    def __init__(
        self, source: Source, text: str, profile: Profile, triads: Sequence[TriadColumns]
    ) -> None:
        self.profile = profile.for_file(text)
        self._source, self._triads = source, triads
        lines = text.splitlines()
        at = profile.skip_lines
        while at < len(lines) and (lines[at].startswith("#") or not lines[at].strip()):
            at += 1
        if at >= len(lines):
            raise no_samples(str(source.path))
        delimiter = self._delimiter = profile.delimiter or _guess_delimiter(lines[at])
        fields = split_line(lines[at], delimiter)
        self._names = [str(number + 1) for number in range(len(fields))]
        if profile.header:
            self._names = list(map(_unquoted, fields))
            at += 1
        self._stamp = self._heat = None
        if profile.time is not None and profile.time.column is not None:
            self._stamp = self._find(profile.time.column)
        if profile.temperature is not None:
            self._heat = self._find(profile.temperature.column)
        self._columns = [tuple(map(self._find, triad.columns)) for triad in triads]
        self._types: dict[str, Any] = {}
        for name in itertools.chain(*self._columns, [self._heat] if self._heat else []):
            self._types[name] = pa.float64()
        if self._stamp is not None:
            self._types[self._stamp] = self._stamp_type(lines[at:], delimiter)
        self.table = TextTable(
            source,
            delimiter=delimiter,
            names=self._names,
            skip_lines=at,
            decimal=profile.decimal,
        )

    def read(
        self, clock: Timekeeper, *, batch: int | None
    ) -> Iterator[tuple[FloatArray, list[FloatArray], FloatArray | None]]:
        """Yield seconds (n,), the triads (n, 3) in SI, and the temperature (n,) or None."""
        for part in self.table.read(self._types, batch=batch):
            values = [
                triad.to_si(stack_columns(part, columns))
                for triad, columns in zip(self._triads, self._columns, strict=True)
            ]
            heat = None
            if self._heat is not None and self.profile.temperature is not None:
                raw = column_values(part, self._heat)
                heat = self.profile.temperature.factor * raw + self.profile.temperature.zero
            stamps = None if self._stamp is None else part.column(self._stamp)
            yield clock.seconds(part.num_rows, stamps), values, heat

    def _find(self, column: Column) -> str:
        if isinstance(column, int) and column <= len(self._names):
            return self._names[column - 1]
        if column in self._names:
            return str(column)
        raise RecordingFormatError(
            f"{self._source.path} does not fit profile {self.profile.name}: it has no column "
            f"{column!r}; separated by {self._delimiter!r} its columns are "
            f"{', '.join(self._names[:12])}"
        )

    def _stamp_type(self, lines: Sequence[str], delimiter: str) -> Any:
        """Return int64 where stamps need it: nanoseconds since 1970 do.

        Seconds may be whole ones in some lines; and others are exact as floating point numbers.
        """
        assert self.profile.time is not None
        assert self._stamp is not None
        if self.profile.time.factor is None:
            return pa.timestamp("ns")
        position = self._names.index(self._stamp)
        rows = [split_line(line, delimiter) for line in lines if line.strip()]
        stamps = [fields[position].strip() for fields in rows if position < len(fields)]
        whole = all(re.fullmatch(r"[+-]?\d+", stamp) for stamp in stamps)
        return pa.int64() if whole and max(map(len, stamps), default=0) > EXACT else pa.float64()


def read_text(
    source: Source, text: str, profile: Profile, options: ReadOptions
) -> Iterator[Recording]:
    """Read the rows of one file, both triads in it."""
    if profile.accel is None or profile.gyro is None:
        raise RecordingFormatError(
            f"profile {profile.name} has no {'[accel]' if profile.accel is None else '[gyro]'}"
        )
    log = TextLog(source, text, profile, (profile.accel, profile.gyro))
    assembler = text_assembler(source, log, options)
    clock = Timekeeper(log.profile)
    for seconds, (accel, gyro), heat in log.read(clock, batch=options.batch):
        recording = assembler.add(seconds, accel, gyro, heat)
        if recording is not None:
            yield recording
    if not assembler.rows:
        raise no_samples(str(source.path))


def text_assembler(source: Source, log: TextLog, options: ReadOptions) -> Assembler:
    """Return the assembler for one text file, with what is known of it before it is read."""
    recognised = " (recognised from the file)" if options.profile is None else ""
    assembler = Assembler(
        name=str(source.path),
        clock=log.profile.clock,
        device=log.profile.device,
        drop_invalid=options.drop_invalid,
        row_name=log.table.line_name,
        notes={"profile": log.profile.name + recognised, **log.profile.notes},
    )
    if log.table.cut:
        assembler.complete = False
        assembler.notes["cut"] = log.table.cut
    return assembler


class Timekeeper:
    """Seconds of each row, running on from batch to batch.

    They are those of the file, so that what is said of a time is found there; of dates, and of what
    counts from an epoch, those since the first row. `zero` is the stamp that counts as 0, if it is
    known.
    """

    def __init__(self, profile: Profile, zero: Any = None) -> None:
        self._profile = profile
        self._rows = 0
        self.zero = zero
        self._turns = 0
        self._last: Any = None

    def seconds(self, count: int, column: Any) -> FloatArray:
        """Return the time of `count` rows, (n,) s, from their stamps, or from the rate."""
        start, time = self._rows, self._profile.time
        self._rows += count
        if column is None or time is None:
            assert self._profile.rate is not None
            return np.arange(start, start + count) / self._profile.rate
        if time.factor is None:
            stamps = np.asarray(column.to_numpy(zero_copy_only=False), "datetime64[ns]")
            missing = np.isnat(stamps)
            seconds = self._since_zero(stamps.astype(np.int64), time)
            return np.where(missing, np.nan, seconds)
        if not pa.types.is_integer(column.type) or column.null_count:
            column = column.cast(pa.float64())
        stamps = np.asarray(column.to_numpy(zero_copy_only=False))
        return self._since_zero(self._unwrapped(stamps, time.wraps), time)

    def _since_zero(self, stamps: Any, time: TimeColumn) -> FloatArray:
        if self.zero is None and len(stamps):
            self.zero = time.zero(stamps[0])
        factor = 1e-9 if time.factor is None else time.factor
        return np.asarray(stamps - self.zero, np.float64) * factor

    def _unwrapped(self, stamps: Any, wraps: int | None) -> Any:
        if wraps is None or not len(stamps):
            return stamps
        step = np.diff(stamps, prepend=stamps[0] if self._last is None else self._last)
        turns = self._turns + np.cumsum(step < -wraps / 2)
        self._last, self._turns = stamps[-1], int(turns[-1])
        return stamps + turns * wraps


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the fields of a line; a space stands for any run of blanks."""
    return line.split() if delimiter == " " else line.rstrip("\r\n").split(delimiter)


def _rows(text: str) -> list[str]:
    """Return the lines that are neither empty nor comments."""
    return [line for line in text.splitlines() if line.strip() and not line.startswith("#")]


def _unquoted(field: str) -> str:
    return field.strip().strip('"')


def _guess_delimiter(line: str) -> str:
    return next((d for d in DELIMITERS if d in line.strip()), ",")


EXPLAINED = "see Import profiles in docs/pages/recordings.md"


def _unknown(source: Source, text: str) -> str:
    """Return what to do with a text log that no profile recognises."""
    rows = _rows(text)
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
    parted = next((d for d in (";", "\t") if d in rows[-1]), "") if rows else ""
    if parted and re.search(r"\d,\d", rows[-1]):
        return (
            f"{source.path}: its numbers have decimal commas, between columns separated by "
            f"{parted!r}. Write it with decimal points, or use --profile FILE.toml with "
            f'decimal = "," and your own columns, units and rate ({EXPLAINED})'
        )
    if count < 6:
        return (
            f"{source.path} is no IMU log: {count} columns ({first[:60]!r}), expected at least 6 "
            "(three of the accelerometer, three of the gyroscope)"
        )
    what = f"{count} columns of numbers without names" if numbers else f"the header {first[:80]!r}"
    which = f"--profile {' or '.join(fits)} if it is such a log, or " if numbers else ""
    units = "" if numbers else f"name the units there ({EXAMPLE}), or use "
    return (
        f"{source.path}: cannot tell columns and units from {what}. Say what they are: {units}"
        f"{which}--profile FILE.toml with your own (columns, units and rate in a few lines; "
        f"{EXPLAINED})"
    )
