"""Correct a text stream as it flows: CSV in SI comes in, the same lines go out corrected.

Whatever is waiting is parsed and formatted at once, so that a burst costs microseconds a line, and
a single line comes out as soon as its line end has come in. Other columns, comments and blank lines
pass through as they are.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv

from calib.apply import Block, Corrector
from calib.calibration import Calibration
from calib.errors import EmptyRecordingError, RecordingFormatError
from calib.types import FloatArray

COLUMNS = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")
EXPECTED = "time," + ",".join(COLUMNS) + "[,temperature][,lost]"

_QUOTED = re.compile(rb'(?m)(?:(?<=,)|^)"((?:[^"\n]|"")*)"(?=,|$)')
_HIDE, _SHOW = bytes.maketrans(b'",', b"\x1e\x1f"), bytes.maketrans(b"\x1e\x1f", b'",')

_SPECIAL = re.compile(rb"(?m)^(?:[ \t]*(?:#.*)?)$\n?")


@dataclass
class CsvFilter:
    """Bytes in, bytes out: call `feed` with what came, in order, and `finish` at the end.

    Parameters
    ----------
    calibration : Calibration
    complain : function of str
        Is told about each damaged line, which is left out: its number, what was seen.
    """

    calibration: Calibration
    complain: Callable[[str], None]
    lines: int = 0
    damaged: int = 0
    corrector: Corrector | None = None
    _names: list[str] = field(default_factory=list)
    _tail: bytes = b""
    _line: int = 0
    _waiting: list[Any] = field(default_factory=list)

    def feed(self, data: bytes) -> bytes:
        """Return what can go out now that `data` has come in."""
        data = self._tail + data
        stop = data.rfind(b"\n") + 1
        self._tail = data[stop:]
        return self._take(data[:stop]) if stop else b""

    def finish(self) -> bytes:
        """Return what is left; a last line without its end counts if it is whole.

        Raises
        ------
        EmptyRecordingError
            If no header came at all.
        """
        out = b""
        if self._tail:
            tail, self._tail = self._tail, b""
            if self._names and len(tail.split(b",")) < len(self._names):
                self._line += 1
                self._drop(tail, "the last line is cut")
            else:
                out = self._take(tail + b"\n")
        if not self._names:
            raise EmptyRecordingError(f"the input is empty, expected the header {EXPECTED}")
        if self.corrector is not None:
            out += self._emit(None, *self.corrector.finish())
        return out

    def _take(self, data: bytes) -> bytes:
        data = data.replace(b"\r\n", b"\n")
        out = b""
        if not self._names:
            out, data = self._head(data)
        if not data:
            return out
        marks = (b"\n", b" ", b"\t", b"#")
        if not data.startswith(marks) and not any(b"\n" + mark in data for mark in marks):
            return out + self._rows(data)
        at = 0
        for match in _SPECIAL.finditer(data):
            if match.start() == match.end():
                continue
            if match.start() > at:
                out += self._rows(data[at : match.start()])
            out += match.group()
            self._line += match.group().count(b"\n")
            at = match.end()
        return out + (self._rows(data[at:]) if at < len(data) else b"")

    def _head(self, data: bytes) -> tuple[bytes, bytes]:
        """Pass comments on, and read the header."""
        at = 0
        while at < len(data):
            stop = data.index(b"\n", at) + 1
            line = data[at:stop].strip()
            at = stop
            self._line += 1
            if not line or line.startswith(b"#"):
                continue
            names = line.decode("utf-8", "replace").lstrip("\ufeff").split(",")
            names = [name.strip().strip('"') for name in names]
            missing = [name for name in ("time", *COLUMNS) if name not in names]
            if missing:
                shown = ",".join(names)[:80]
                raise RecordingFormatError(
                    f"line {self._line} is {shown!r}, which lacks {', '.join(missing[:7])}; "
                    f"expected the header {EXPECTED} in s, m/s², rad/s, °C and counts"
                )
            if len(set(names)) < len(names):
                raise RecordingFormatError(f"line {self._line}: the header names a column twice")
            self._names = names
            break
        return data[:at], data[at:]

    def _rows(self, data: bytes) -> bytes:
        parsed = self._parse(data)
        count = data.count(b"\n")
        if parsed is None:
            if count == 1:
                self._line += 1
                self._drop(data, f"expected {len(self._names)} numbers")
                return b""
            # Somewhere in here is a damaged line: halve until it stands alone.
            half = data.index(b"\n", len(data) // 2 - 1) + 1
            if half == len(data):
                half = data.rindex(b"\n", 0, len(data) - 1) + 1
            return self._rows(data[:half]) + self._rows(data[half:])
        self._line += count
        return self._correct(*parsed)

    def _parse(self, data: bytes) -> tuple[Any, FloatArray] | None:
        """Return the lines as a table, channels as numbers and the rest as text, and their times.

        None if one of the lines is damaged. A quote is one more letter of its own line: one that
        nobody closed must not join lines.
        """
        if b"\x1e" in data or b"\x1f" in data:
            return None
        if b'"' in data:
            data = _QUOTED.sub(_hide, data).replace(b'"', b"\x1e")
        types = dict.fromkeys(COLUMNS, pa.float64())
        for name in self._names:
            types.setdefault(name, pa.string())
        try:
            table = csv.read_csv(
                io.BytesIO(data),
                csv.ReadOptions(
                    use_threads=False, column_names=self._names, block_size=max(1, len(data))
                ),
                csv.ParseOptions(quote_char=False, ignore_empty_lines=False),
                csv.ConvertOptions(
                    column_types=types, strings_can_be_null=False, null_values=[], check_utf8=False
                ),
            )
            if table.num_rows != data.count(b"\n"):  # a carriage return within a line
                return None
            if not all(pc.all(pc.is_finite(table.column(name))).as_py() for name in COLUMNS):
                return None
            return table, _numbers(table.column("time"))
        except pa.ArrowInvalid:
            return None

    def _correct(self, table: Any, times: FloatArray) -> bytes:
        if self.corrector is None:
            noise = self.calibration.noise
            interval = 0.01 if noise is None else 1.0 / noise.rate
            if len(times) > 1:
                interval = float(np.median(np.diff(times)))
            self.corrector = Corrector(self.calibration, interval)
        values = np.empty((6, len(times)))
        for k, name in enumerate(COLUMNS):
            values[k] = table.column(name).to_numpy()
        temperature = None
        if "temperature" in self._names:
            column = table.column("temperature")
            try:
                temperature = _numbers(column)
            except pa.ArrowInvalid:
                temperature = np.full(len(times), np.nan)
        block = Block(times, values[:3].T, values[3:].T, temperature)
        return self._emit(table, *self.corrector.add(block))

    def _emit(self, table: Any | None, accel: Any, gyro: Any) -> bytes:
        """Format the corrected samples with the other columns of the rows that they belong to."""
        assert self.corrector is not None
        if table is not None and (self._waiting or len(accel) < table.num_rows):
            self._waiting.append(table)
            table = None
        if not len(accel):
            return b""
        if table is None:
            whole = pa.concat_tables(self._waiting).combine_chunks()
            table = whole.slice(0, len(accel))
            self._waiting = [whole.slice(len(accel))]
        for k, name in enumerate(COLUMNS):
            values = (accel if k < 3 else gyro)[:, k % 3]
            table = table.set_column(
                table.schema.get_field_index(name), name, pa.array(np.ascontiguousarray(values))
            )
        self.lines += table.num_rows
        sink = io.BytesIO()
        csv.write_csv(table, sink, csv.WriteOptions(include_header=False, quoting_style="none"))
        return sink.getvalue().translate(_SHOW)

    def _drop(self, line: bytes, why: str) -> None:
        self.damaged += 1
        shown = line.rstrip(b"\r\n")[:60].decode("utf-8", "replace")
        self.complain(f"line {self._line} is left out: {why}, found {shown!r}")


def _hide(quoted: re.Match[bytes]) -> bytes:
    """Return a cell in quotes so that its commas and quotes part nothing; a number needs none."""
    try:
        float(quoted[1])
    except ValueError:
        return quoted[0].translate(_HIDE)
    return quoted[1]


def _numbers(column: Any) -> FloatArray:
    return np.asarray(pc.ascii_trim_whitespace(column).cast(pa.float64()).to_numpy())
