"""Raw captures: a device's bytes as they came, and beside them when they came.

``bytes.bin`` holds the bytes and nothing else; ``bytes.bin.times`` is text: where they came from,
how to read them, and a line ``seconds total_bytes`` for each read.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from calib.errors import RecordingFormatError, RecordingNotFoundError, RecordingWriteError

HEADER = "# imu-cal capture 1"
PIECE = 1 << 16
"""Bytes in a piece of a capture whose times nobody noted."""


class CaptureWriter:
    """Writes a capture; use it in ``with``."""

    def __init__(self, path: Path, source: str, stream: Callable[[], str]) -> None:
        self.path = path
        self._source = source
        self._stream = stream  # called with the first bytes: by then the dialect is known
        self._total = 0
        self._begin: float | None = None

    def __enter__(self) -> Self:
        try:
            self._bytes = self.path.open("wb")
            self._times = times_path(self.path).open("w", encoding="utf-8")
        except OSError as error:
            raise _cannot_write(self.path, error) from error
        self._times.write(f"{HEADER}\n# source: {self._source}\n")
        return self

    def add(self, data: bytes, arrival: float | None) -> None:
        """Append bytes that arrived at `arrival` s."""
        try:
            self._bytes.write(data)
            self._total += len(data)
            if arrival is not None:
                if self._begin is None:
                    self._begin = arrival
                    self._times.write(f"# stream: {self._stream()}\n")
                self._times.write(f"{arrival - self._begin:.6f} {self._total}\n")
        except OSError as error:
            raise _cannot_write(self.path, error) from error

    def flush(self) -> None:
        """Hand what was written to the disk, bytes first."""
        try:
            for file in (self._bytes, self._times):
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise _cannot_write(self.path, error) from error

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for file in (self._bytes, self._times):
            try:
                file.close()
            except OSError as problem:
                if error is None:
                    raise _cannot_write(self.path, problem) from problem


@dataclass(frozen=True)
class Capture:
    """A capture on disk. ``stream`` is how to read it, as in ``dialect=witmotion``, if known."""

    path: Path
    stream: str
    marks: tuple[tuple[float, int], ...]

    def pieces(self) -> Iterator[tuple[bytes, float | None]]:
        """Return the bytes piece by piece, as they came, with their arrival where it is known."""
        with self.path.open("rb") as file:
            done = 0
            for arrival, total in self.marks:
                data = file.read(total - done)
                done += len(data)
                if data:
                    yield data, arrival
            while data := file.read(PIECE):
                yield data, self.marks[-1][0] if self.marks else None


def open_capture(path: Path) -> Capture:
    """Read what stands beside a capture.

    Raises
    ------
    RecordingError
        If the file is not there or its times are damaged.
    """
    if not path.is_file():
        raise RecordingNotFoundError(f"there is no file {path}")
    times = times_path(path)
    if not times.is_file():
        return Capture(path, "", ())
    stream, marks, last = "", [], 0
    lines = times.read_text(encoding="utf-8", errors="replace").split("\n")
    if lines[0] != HEADER:
        raise RecordingFormatError(f"{times} begins with {lines[0][:40]!r}, expected {HEADER!r}")
    for line in lines[1:-1]:  # a last line without its end was cut
        if line.startswith("#"):
            if line.startswith("# stream: "):
                stream = line.removeprefix("# stream: ")
            continue
        try:
            seconds, total = line.split()
            mark = (float(seconds), int(total))
        except ValueError:
            raise RecordingFormatError(f"{times}: {line[:40]!r} is not `seconds bytes`") from None
        if mark[1] < last:
            raise RecordingFormatError(f"{times}: the byte count goes back at {line!r}")
        marks.append(mark)
        last = mark[1]
    return Capture(path, stream, tuple(marks))


def times_path(path: Path) -> Path:
    """Return where the times of a capture stand."""
    return path.with_name(f"{path.name}.times")


def _cannot_write(path: Path, error: OSError) -> RecordingWriteError:
    return RecordingWriteError(f"{path} cannot be written: {error.strerror or error}")
