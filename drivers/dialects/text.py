"""Text lines, as Arduino sketches print them: numbers between delimiters, labelled, or JSON.

What the columns mean is the user's to say: an import profile (``profile=FILE``), or in the address
``columns=t,ax,ay,az,gx,gy,gz,temp`` with ``accel_unit``, ``gyro_unit``, ``time_unit``. A block of
lines is parsed at once; a damaged line costs itself alone, and counts as one lost sample.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from calib.errors import AddressError, BadFrameError, RecordingFormatError
from calib.types import BoolArray, FloatArray, IntArray
from drivers.dialects.base import Dialect, Parser, Samples
from drivers.dialects.framing import Bytes, as_bytes
from drivers.dialects.numbers import NUMBER, parse_block, parse_numbers
from drivers.formats.profile import Column, Profile, get_profile, parse_profile

LABEL = re.compile(rb"[A-Za-z_/][\w/ \[\]()]*[:=]")
LONGEST = 4096
"""Bytes of a line, beyond which it is garbage without a line end."""


class TextParser(Parser):
    """Parser of text lines."""

    def __init__(
        self, profile: Profile, *, names: Sequence[str] | None, delimiter: bytes | None
    ) -> None:
        super().__init__()
        self.profile = profile
        self.info = profile.device
        if profile.time is not None and profile.time.wraps and profile.time.factor:
            self.clock_period = profile.time.wraps * profile.time.factor
        self._names = list(names) if names is not None else None
        self._delimiter = delimiter
        self._json: bool | None = None
        self._labelled = False
        self._started = False
        self._fields = 0
        self._places: list[int] = []
        self._pending = 0  # damaged lines since the last good one

    def _parse(self, buffer: bytes) -> tuple[Samples, int]:
        end = buffer.rfind(b"\n") + 1
        if not end:
            if len(buffer) <= LONGEST:
                return Samples.none(), 0
            self._count("skipped_bytes", len(buffer))
            self._pending += self._started
            return Samples.none(), len(buffer)
        start = 0
        if not self._started:
            self._started = True
            start = buffer.find(b"\n") + 1  # we may have come in the middle of the first line
            self._count("incomplete_bytes", start)
        block = buffer[start:end]
        if block.isspace() or not block:
            return Samples.none(), end
        if self._json is None:
            self._learn(block)
        if not self._json and not self._fields and not self._find_layout(block):
            self._other(block)
            return Samples.none(), end
        values, good, lines = self._rows_of_json(block) if self._json else self._rows(block)
        with np.errstate(over="ignore", invalid="ignore"):
            all_finite = np.isfinite(values.sum())
        if not all_finite:
            good &= np.isfinite(values).all(axis=1)
        self.accepted_bytes += int(lines[good].sum())
        return self._samples(values, good), end

    def _learn(self, block: bytes) -> None:
        """Tell JSON from delimited lines, and whether numbers are labelled."""
        lines = [line.strip() for line in block.splitlines() if line.strip()]
        self._json = sum(line.startswith(b"{") for line in lines) > len(lines) / 2
        if self._json:
            return
        self._labelled = sum(bool(LABEL.search(line)) for line in lines) > len(lines) / 2

    # Delimited lines

    def _find_layout(self, block: bytes) -> bool:
        """Find the delimiter, the number of fields and where the columns stand."""
        plain = self._plain(block)
        for delimiter in [self._delimiter] if self._delimiter else [b",", b";", b"\t", b" "]:
            counts = [
                len(fields)
                for fields in (line.strip().split(delimiter) for line in plain.splitlines())
                if all(NUMBER.fullmatch(field) for field in fields)
            ]
            if counts and max(counts) > 1:
                self._delimiter = delimiter
                self._fields = max(set(counts), key=counts.count)
                break
        else:
            return False
        self._places = [self._place(column, block) for column in self._columns()]
        return True

    def _columns(self) -> list[Column]:
        profile = self.profile
        assert profile.accel is not None
        assert profile.gyro is not None
        columns = [*profile.accel.columns, *profile.gyro.columns]
        if profile.time is not None and profile.time.column is not None:
            columns.append(profile.time.column)
        if profile.temperature is not None:
            columns.append(profile.temperature.column)
        return columns

    def _place(self, column: Column, block: bytes) -> int:
        names = self._names or self._header(block)
        if isinstance(column, int):
            place = column - 1
        elif names is not None and column in names:
            place = names.index(column)
        else:
            raise BadFrameError(
                f"the lines have {self._fields} columns without names; where {column!r} stands "
                "must be said in the address, as in columns=t,ax,ay,az,gx,gy,gz"
            )
        if place >= self._fields:
            raise BadFrameError(
                f"column {column!r} would be number {place + 1}, but the lines have only "
                f"{self._fields}: {block.splitlines()[-1][:80]!r}"
            )
        return place

    def _header(self, block: bytes) -> list[str] | None:
        assert self._delimiter is not None
        for line in block.splitlines():
            fields = [field.strip().decode(errors="replace") for field in _split(line, self)]
            if len(fields) == self._fields and not any(_is_number(field) for field in fields):
                return fields
            if self._labelled and LABEL.search(line):
                labels = [m[0][:-1].decode().strip() for m in LABEL.finditer(line)]
                if len(labels) == self._fields:
                    return labels
        return None

    def _plain(self, block: bytes) -> bytes:
        """Return the lines without labels, runs of blanks as one where blanks delimit."""
        if self._labelled:
            block = LABEL.sub(b"", block)
        if self._delimiter in (b" ", None) and b"," not in block and b";" not in block:
            block = re.sub(rb"[ \t]+", b" ", block)
            block = re.sub(rb"(?m)^ | (?=\r?$)", b"", block)
        return block

    def _rows(self, block: bytes) -> tuple[FloatArray, BoolArray, IntArray]:
        """Return values (n, columns), which lines are good, and how long each line is."""
        assert self._delimiter is not None
        if self._labelled or self._delimiter == b" ":
            block = self._plain(block)
        fast = parse_block(
            block, fields=self._fields, places=self._places, delimiter=self._delimiter
        )
        if fast is not None:
            count = len(fast)
            return fast, np.ones(count, bool), np.full(count, len(block) // count)
        data = as_bytes(block)
        ends = np.flatnonzero(data == 10) + 1
        starts = np.concatenate([[0], ends[:-1]])
        lengths = ends - starts
        delimiters = np.add.reduceat((data == self._delimiter[0]).view(np.uint8), starts)
        table = _ALLOWED.copy()
        table[self._delimiter[0]] = True
        good = (delimiters == self._fields - 1) & np.logical_and.reduceat(table[data], starts)
        values = np.zeros((ends.size, len(self._places)))
        if good.any():
            kept = block if good.all() else data[np.repeat(good, lengths)].tobytes()
            numbers, fine = parse_numbers(
                kept, fields=self._fields, places=self._places, delimiter=self._delimiter
            )
            good[good] = fine
            values[good] = numbers[fine]
        blank = self._not_samples(data, starts, lengths, good)
        if blank.any():
            values, good, lengths = values[~blank], good[~blank], lengths[~blank]
        return values, good, lengths

    def _not_samples(
        self, data: Bytes, starts: IntArray, lengths: IntArray, good: BoolArray
    ) -> BoolArray:
        """Find lines that were never meant as samples: blank ones, comments, titles."""
        out = np.zeros(good.size, bool)
        for k in np.flatnonzero(~good):
            line = data[starts[k] : starts[k] + lengths[k]].tobytes().strip()
            if not line:
                out[k] = True
            elif is_remark(line):
                out[k] = True
                self._count("other_lines", 1)
        return out

    # JSON lines

    def _rows_of_json(self, block: bytes) -> tuple[FloatArray, BoolArray, IntArray]:
        lines = [line for line in block.split(b"\n") if line.strip()]
        try:
            items = json.loads(b"[" + b",".join(lines) + b"]")
        except (ValueError, RecursionError):
            items = [_loads(line) for line in lines]
        if len(items) != len(lines):  # a line that held two values
            items = [_loads(line) for line in lines]
        paths = [str(column).split(".") for column in self._columns()]
        values, good = np.zeros((len(lines), len(paths))), np.zeros(len(lines), bool)
        for k, item in enumerate(items):
            row = [_follow(item, path) for path in paths]
            if None not in row:
                values[k] = row
                good[k] = True
        remark = np.array([is_remark(line.strip()) for line in lines]) & ~good
        self._count("other_lines", int(remark.sum()))
        lengths = np.array([len(line) + 1 for line in lines])
        return values[~remark], good[~remark], lengths[~remark]

    # To samples

    def _other(self, block: bytes) -> None:
        for line in block.splitlines():
            if is_remark(line.strip()):
                self._count("other_lines", 1)
            elif line.strip():
                self._count("damaged_lines", 1)

    def _samples(self, values: FloatArray, good: BoolArray) -> Samples:
        """Convert to SI and count what was damaged before each good line."""
        if good.all() and not self._pending:
            return self._to_si(values, np.zeros(good.size, np.int64))
        damaged = np.cumsum(~good) + self._pending
        before = damaged[good]
        lost = np.diff(before, prepend=0)
        self._pending = int(damaged[-1] - (before[-1] if before.size else 0)) if good.size else 0
        self._count("damaged_lines", int((~good).sum()))
        return self._to_si(values[good], lost)

    def _to_si(self, values: FloatArray, lost: IntArray) -> Samples:
        profile = self.profile
        assert profile.accel is not None
        assert profile.gyro is not None
        rest = 6
        ticks = temperature = None
        if profile.time is not None and profile.time.column is not None:
            ticks = values[:, rest] * (profile.time.factor or 1.0)
            rest += 1
        if profile.temperature is not None:
            temperature = values[:, rest] * profile.temperature.factor + profile.temperature.zero
        return Samples(
            profile.accel.to_si(values[:, :3]),
            profile.gyro.to_si(values[:, 3:6]),
            lost,
            temperature,
            ticks,
        )


_ALLOWED = np.zeros(256, bool)
_ALLOWED[np.frombuffer(b"0123456789+-.eE \t\r\n", np.uint8)] = True


def is_remark(line: bytes) -> bool:
    """Return whether a line is text for people: a comment, a title, column names."""
    if line.startswith((b"#", b"//", b"%")):
        return True
    letters = sum(chr(byte).isalpha() for byte in line if byte < 128)
    return letters > 0.4 * len(line) and all(9 <= byte < 127 for byte in line)


def _split(line: bytes, parser: TextParser) -> list[bytes]:
    assert parser._delimiter is not None
    return line.strip().split(None if parser._delimiter == b" " else parser._delimiter)


def _is_number(field: str) -> bool:
    return NUMBER.fullmatch(field.encode()) is not None


def _loads(line: bytes) -> object:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def _follow(item: object, path: Sequence[str]) -> float | None:
    """Return the number at ``a.b`` or ``a.0`` in a JSON value, None if there is none."""
    for key in path:
        if isinstance(item, dict):
            item = item.get(key)
        elif isinstance(item, list) and key.isdigit() and int(key) < len(item):
            item = item[int(key)]
        else:
            return None
    if isinstance(item, bool) or not isinstance(item, int | float):
        return None
    return float(item) if abs(item) < 1e300 else None


class Text(Dialect):
    """Lines of numbers."""

    name = "text"
    summary = "text lines: CSV, labelled or JSON, as Arduino sketches print"
    options: ClassVar[Mapping[str, str]] = {
        "profile": "an import profile, shipped or a .toml file",
        "columns": "what stands in the columns, in order: t,ax,ay,az,gx,gy,gz,temp; - for others",
        "accel_unit": "m/s^2, g, mg or LSB",
        "gyro_unit": "rad/s, deg/s, mdeg/s or LSB",
        "accel_sensitivity": "LSB per g",
        "gyro_sensitivity": "LSB per deg/s",
        "time_unit": "s, ms, us or ns",
        "time_wraps": "where the time counter starts again at 0",
        "temp_unit": "degC, degF or K",
        "delimiter": "comma, semicolon, tab or space; found from the lines if left out",
    }

    def parser(self, options: Mapping[str, str]) -> Parser:
        """Return a parser for the columns that the options describe.

        Raises
        ------
        AddressError
            If they describe none, or wrongly.
        """
        columns = options.get("columns")
        names = columns.split(",") if columns is not None else None
        try:
            if "profile" in options:
                profile = get_profile(options["profile"])
            elif names is not None:
                profile = _inline_profile(names, options)
            else:
                raise AddressError(
                    "text lines need to be told what their columns are: "
                    "columns=t,ax,ay,az,gx,gy,gz&time_unit=ms&accel_unit=g&gyro_unit=deg/s, or "
                    "profile=FILE"
                )
        except RecordingFormatError as error:
            raise AddressError(str(error)) from error
        if profile.accel is None or profile.gyro is None:
            raise AddressError(
                "text lines need three accelerometer and three gyroscope columns, got only "
                f"{'gyroscope' if profile.accel is None else 'accelerometer'} ones"
            )
        if profile.time is not None and profile.time.factor is None:
            raise AddressError("a stream's time must be a number, not a date")
        words = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
        delimiter = options.get("delimiter") or profile.delimiter
        if delimiter is not None:
            delimiter = words.get(delimiter, delimiter)
        return TextParser(
            profile,
            names=names,
            delimiter=None if delimiter is None else delimiter.encode(),
        )

    def recognise(self, data: bytes) -> float:
        """Return how much of the data is lines of at least six numbers, or JSON objects."""
        lines = data.split(b"\n")[1:-1]
        mine = 0
        for line in lines:
            fields = [f for f in re.split(rb"[,;\t ]+", LABEL.sub(b"", line).strip()) if f]
            numbers = len(fields) >= 6 and all(NUMBER.fullmatch(field) for field in fields)
            if numbers or isinstance(_loads(line), dict):
                mine += len(line) + 1
        return mine / max(len(data), 1)


def _inline_profile(names: Sequence[str], options: Mapping[str, str]) -> Profile:
    """Return the profile that the address spells out."""
    lines = ["rate = 1"]
    if "t" in names:
        lines = ["[time]", 'column = "t"', f"unit = {json.dumps(options.get('time_unit', ''))}"]
        if "time_wraps" in options:
            lines.append(f"wraps = {options['time_wraps']}")
    for triad, letter in (("accel", "a"), ("gyro", "g")):
        axes = [f"{letter}{axis}" for axis in "xyz"]
        lines += [f"[{triad}]", f"columns = {json.dumps(axes)}"]
        lines.append(f"unit = {json.dumps(options.get(f'{triad}_unit', ''))}")
        if f"{triad}_sensitivity" in options:
            lines.append(f"sensitivity = {options[f'{triad}_sensitivity']}")
        missing = [axis for axis in axes if axis not in names]
        if missing:
            raise AddressError(f"columns={','.join(names)} lacks {', '.join(missing)}")
    if "temp" in names:
        lines += ["[temperature]", 'column = "temp"']
        lines.append(f"unit = {json.dumps(options.get('temp_unit', 'degC'))}")
    profile = parse_profile("\n".join(lines), name="in the address")
    return replace(profile, rate=None, device=replace(profile.device, rate=None))


DIALECT = Text()
