"""Numbers in lines of text, read by pyarrow's CSV reader: what CSV and foreign logs share."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pyarrow as pa
from pyarrow import csv

from calib.errors import RecordingFormatError
from drivers.formats.base import Source

BLOCK = 1 << 22
"""Bytes that pyarrow parses at once, per thread."""
ROW_BYTES = 64
"""A typical row, from which the block size for a batch of rows is taken."""
NULLS = ["", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "-nan"]


def decode_head(head: bytes) -> str | None:
    """Return the start of a file as text, whole lines only, or None if it is no text."""
    if b"\0" in head:
        return None
    end = head.rfind(b"\n")
    try:
        text = (head[: end + 1] if end > 0 else head).decode("utf-8-sig")
    except UnicodeDecodeError:
        text = head[: end + 1].decode("latin-1")
    control = sum(1 for c in text if ord(c) < 32 and c not in "\t\r\n\f\x1b") + sum(
        1 for c in text if 127 <= ord(c) < 160
    )
    return text if control <= len(text) // 1000 else None


class TextTable:
    """The rows of a text file below its header.

    Parameters
    ----------
    source : Source
    delimiter : str
        One character; a space stands for any run of spaces and tabs.
    names : sequence of str
        One for each column of the file.
    skip_lines : int
        Lines above the first row.
    decimal : str
        Decimal point.
    """

    def __init__(
        self,
        source: Source,
        *,
        delimiter: str,
        names: Sequence[str],
        skip_lines: int,
        decimal: str = ".",
    ) -> None:
        self._source = source
        self._names = list(names)
        self._delimiter = delimiter
        self._decimal = decimal
        self._skip_lines = skip_lines
        whole = source.buffer
        start = 0
        for _ in range(skip_lines):
            start = _find_newline(whole, start) + 1
            if start == 0:
                start = whole.size
        stop = _last_newline(whole, start) + 1
        self.cut = ""
        """Why the file counts as cut, or nothing."""
        if stop < whole.size and whole.slice(stop).to_pybytes().strip():
            self.cut = "the last line does not end; it was left out"
        self._start = start
        self._rows = whole.slice(start, max(stop - start, 0))

    def read(self, types: Mapping[str, Any], *, batch: int | None) -> Iterator[Any]:
        """Read columns with the given Arrow types, as one table or in batches of `batch` rows.

        Raises
        ------
        RecordingFormatError
            If a line has another number of columns, or something that is no number.
        """
        if not self._rows.size:
            return
        if batch is None:
            yield self._read_whole(types)
            return
        block = max(4096, batch * ROW_BYTES)
        rows: Any
        if self._delimiter == " " or self._has_comments():
            rows = pa.PythonFile(self._cleaned(), mode="r")
        else:
            rows = self._source.stream(self._start, self._rows.size)
        try:
            with csv.open_csv(rows, **self._options(types, block)) as reader:
                for part in reader:
                    for at in range(0, part.num_rows, batch):
                        yield part.slice(at, batch)
        except pa.ArrowInvalid as error:
            raise self._bad_line(types, error) from error

    def _read_whole(self, types: Mapping[str, Any]) -> Any:
        try:
            return csv.read_csv(self._rows, **self._options(types, BLOCK))
        except pa.ArrowInvalid as error:
            if self._delimiter != " " and not self._has_comments():
                raise self._bad_line(types, error) from error
        try:
            cleaned = pa.py_buffer(self._cleaned().read())
            return csv.read_csv(cleaned, **self._options(types, BLOCK))
        except pa.ArrowInvalid as error:
            raise self._bad_line(types, error) from error

    def _options(self, types: Mapping[str, Any], block: int) -> dict[str, Any]:
        return {
            "read_options": csv.ReadOptions(column_names=self._names, block_size=block),
            "parse_options": csv.ParseOptions(delimiter=self._delimiter),
            "convert_options": csv.ConvertOptions(
                column_types=dict(types),
                include_columns=list(types),
                null_values=NULLS,
                decimal_point=self._decimal,
            ),
        }

    def _cleaned(self) -> _CleanRows:
        return _CleanRows(self._rows, single_spaces=self._delimiter == " ")

    def _has_comments(self) -> bool:
        """Return whether a line among the rows begins with ``#``."""
        before = b"\n"
        with self._source.stream(self._start, self._rows.size) as stream:
            while block := stream.read(BLOCK):
                if b"\n#" in before + block:
                    return True
                before = block[-1:]
        return False

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Return the line number, from 1, and the text of each row."""
        with pa.BufferReader(self._rows) as reader:
            for number, line in enumerate(_iterate_lines(reader), self._skip_lines + 1):
                text = line.decode("utf-8", "replace").strip("\r\n")
                if text and not text.startswith("#"):
                    yield number, text

    def line_name(self, row: int) -> str:
        """Return what a person calls a row: its line in the file."""
        for at, (number, _) in enumerate(self._lines()):
            if at == row:
                return f"line {number}"
        return f"row {row + 1}"

    def _bad_line(self, types: Mapping[str, Any], error: Exception) -> RecordingFormatError:
        expected = len(self._names)
        columns = [self._names.index(name) for name in types]
        for number, text in self._lines():
            stripped = " ".join(text.split()) if self._delimiter == " " else text
            fields = stripped.split(self._delimiter)
            short = text if len(text) <= 60 else f"{text[:57]}..."
            if len(fields) != expected:
                return RecordingFormatError(
                    f"{self._source.path}, line {number}: {len(fields)} columns, expected "
                    f"{expected} ({', '.join(self._names)}): {short!r}"
                )
            for column in columns:
                field = fields[column].strip().replace(self._decimal, ".")
                if field not in NULLS and not _is_number(field):
                    comma = _is_number(field.replace(",", "."))
                    with_point = " with a decimal point, not a comma" if comma else ""
                    return RecordingFormatError(
                        f"{self._source.path}, line {number}: {self._names[column]} is {field!r}, "
                        f"expected a number{with_point}"
                    )
        return RecordingFormatError(f"{self._source.path}: {error}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _iterate_lines(reader: Any) -> Iterator[bytes]:
    rest = b""
    while block := reader.read(BLOCK):
        *lines, rest = (rest + block).split(b"\n")
        yield from lines
    if rest:
        yield rest


def _find_newline(buffer: Any, start: int) -> int:
    """Return where the next line feed is, or -1."""
    while start < buffer.size:
        block = buffer.slice(start, min(BLOCK, buffer.size - start)).to_pybytes()
        at = block.find(b"\n")
        if at >= 0:
            return start + int(at)
        start += len(block)
    return -1


def _last_newline(buffer: Any, start: int) -> int:
    stop = int(buffer.size)
    while stop > start:
        begin = max(start, stop - BLOCK)
        at = int(buffer.slice(begin, stop - begin).to_pybytes().rfind(b"\n"))
        if at >= 0:
            return begin + at
        stop = begin
    return start - 1


class _CleanRows(io.RawIOBase):
    """Rows without comment lines, read as a file.

    With `single_spaces`, also with one space for each run of blanks and none at the ends of lines.
    """

    def __init__(self, rows: Any, *, single_spaces: bool) -> None:
        self._rows = rows
        self._single_spaces = single_spaces
        self._at = 0

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        """Return whole lines of at most `size` bytes, or all that is left."""
        left = int(self._rows.size) - self._at
        text = b""
        while not text and left > 0:
            stop = self._at + (left if size < 0 else min(max(size, 1), left))
            end = _last_newline(self._rows.slice(0, stop), self._at) + 1
            if end <= self._at:
                end = stop
            text = self._rows.slice(self._at, end - self._at).to_pybytes()
            text = re.sub(rb"(?m)^#[^\n]*\n?", b"", text)
            if self._single_spaces:
                text = re.sub(rb"[ \t]+", b" ", text)
                text = re.sub(rb" ?(\r?\n) ?", rb"\1", text).lstrip(b" ")
            self._at = end
            left = int(self._rows.size) - end
        return text
