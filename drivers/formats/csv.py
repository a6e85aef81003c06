"""Interchange text form: comma-separated values in SI, with ``# key: value`` lines above.

Header ``time,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z[,temperature][,lost]`` in s, m/s², rad/s,
°C and counts. Columns may stand in any order; others are passed over.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from typing import IO

import pyarrow as pa
from pyarrow import csv

from calib.errors import RecordingFormatError
from calib.recording import Recording
from drivers.formats.base import Format, ReadOptions, Source, Writer
from drivers.formats.columns import (
    OPTIONAL,
    REQUIRED,
    add_table,
    from_text,
    no_samples,
    schema_of,
    to_batch,
    to_text,
)
from drivers.formats.text import TextTable, decode_head

REMARKS = 4096
"""Bytes at the end of a file in which remarks are looked for."""


class CsvWriter(Writer):
    """Appends rows to a CSV file in SI; numbers are written so that they read back exactly."""

    def _start(self, batch: Recording) -> None:
        self._schema = schema_of(batch)
        self._file: IO[bytes] = open(self._target, "wb")  # noqa: SIM115 - closed in _finish
        self._file.write(_comment_lines(to_text(batch)))
        self._file.write((",".join(self._schema.names) + "\n").encode())

    def _append(self, batch: Recording) -> None:
        options = csv.WriteOptions(include_header=False)
        csv.write_csv(to_batch(batch, self._schema), self._file, options)

    def flush(self) -> None:
        """Hand what was appended to the disk."""
        if self._last is not None:
            self._file.flush()
            os.fsync(self._file.fileno())

    def _finish(self) -> None:
        self._file.write(_comment_lines(self.remarks))
        self._file.close()


class Csv(Format):
    """CSV in SI."""

    name = "csv"
    title = "CSV in SI units"
    suffixes = (".csv", ".txt")
    binary = False
    writer = CsvWriter

    def sniff(self, head: bytes) -> bool:
        """Look for our header below comment lines."""
        text = decode_head(head)
        return text is not None and _header(text) is not None

    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Read rows by pyarrow's CSV reader; a cut last line is left out and noted."""
        text = decode_head(source.head) or ""
        header = _header(text)
        if header is None:
            raise RecordingFormatError(f"{source.path}: no header {','.join(REQUIRED)}")
        line, names = header
        missing = [name for name in REQUIRED if name not in names]
        if missing:
            raise RecordingFormatError(
                f"{source.path}: the header has no column {', '.join(missing)}; expected "
                f"{','.join(REQUIRED)}[,temperature][,lost] in s, m/s², rad/s, °C and counts"
            )
        meta = _comments(text.splitlines()[:line]) | _remarks(source)
        assembler = from_text(meta, name=str(source.path), drop_invalid=options.drop_invalid)
        wanted = [name for name in (*REQUIRED, *OPTIONAL) if name in names]
        table = TextTable(source, delimiter=",", names=names, skip_lines=line + 1)
        assembler.row_name = table.line_name
        if table.cut:
            assembler.complete = False
            assembler.notes["cut"] = table.cut
        types = dict.fromkeys(wanted, pa.float64())
        for part in table.read(types, batch=options.batch):
            recording = add_table(assembler, part)
            if recording is not None:
                yield recording
        if not assembler.rows:
            raise no_samples(str(source.path))


FORMAT = Csv()


def _header(text: str) -> tuple[int, list[str]] | None:
    """Return the line number (from 0) of the header and its names, if there is one of ours."""
    for number, line in enumerate(text.splitlines()):
        if line.startswith("#") or not line.strip():
            continue
        names = [name.strip().strip('"') for name in line.split(",")]
        if "time" in names and len({*names} & {*REQUIRED}) > 1:
            return number, names
        return None
    return None


def _comment_lines(pairs: Mapping[str, str]) -> bytes:
    return "".join(f"# {_quote(k)}: {_quote(v)}\n" for k, v in pairs.items()).encode()


def _remarks(source: Source) -> dict[str, str]:
    """Return what stands in the comment lines below the last sample."""
    buffer = source.buffer
    tail = buffer.slice(max(0, buffer.size - REMARKS)).to_pybytes()
    lines = tail.decode("utf-8", "replace").splitlines()[1:]
    below = []
    for text in reversed(lines):
        if not text.startswith("#"):
            break
        below.append(text)
    return _comments(below)


def _comments(lines: list[str]) -> dict[str, str]:
    out = {}
    for line in lines:
        text = line.lstrip("# \t").rstrip("\r\n")
        if not text:
            continue
        if text.startswith('"'):
            try:
                key, end = json.JSONDecoder().raw_decode(text)
            except ValueError:
                key, end = text, len(text)
            rest = text[end:].lstrip()
            value = rest[1:] if rest.startswith(":") else rest
        else:
            key, _, value = text.partition(":")
            key = key.strip()
        out[str(key)] = _unquote(value.strip())
    return out


def _quote(text: str) -> str:
    """Return text that stands in a comment line as it is, or else as a JSON string."""
    plain = text == text.strip() and text.isprintable() and not set('":#') & set(text)
    return text if plain and text else json.dumps(text)


def _unquote(text: str) -> str:
    if text.startswith('"'):
        try:
            return str(json.loads(text))
        except ValueError:
            return text
    return text
