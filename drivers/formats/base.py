"""What a recording format is: how it is recognised, read batch by batch, and written."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, Self

from calib.errors import RecordingWriteError
from calib.recording import Recording
from drivers.output_file import can_replace

if TYPE_CHECKING:
    from drivers.formats.profile import Profile

HEAD = 1 << 16
"""Bytes at the start of a file by which its format is recognised."""


@dataclass(frozen=True)
class Source:
    """A file that is there and is not empty; `drivers.formats.find_source` makes it."""

    path: Path
    head: bytes
    regular: bool = True
    """False for a pipe: it can be read once, from start to end."""

    @cached_property
    def buffer(self) -> Any:
        """All bytes as a pyarrow buffer: mapped, not copied, where the file is a regular one."""
        import pyarrow as pa

        if self.regular:
            with pa.memory_map(os.fsencode(self.path)) as mapped:
                return mapped.read_buffer()
        return pa.py_buffer(self.head)

    def stream(self, start: int, size: int) -> Any:
        """`size` bytes from `start` as a file to read once, which keeps nothing of it in memory."""
        import pyarrow as pa

        if self.regular:
            return pa.OSFile(os.fsencode(self.path)).get_stream(start, size)
        return pa.BufferReader(self.buffer.slice(start, size))


@dataclass(frozen=True)
class ReadOptions:
    """What the user says about a recording.

    ``batch`` is the number of samples to hold at once; None reads the file as a whole.
    """

    profile: Profile | None = None
    imu: int | None = None
    drop_invalid: bool = False
    batch: int | None = None


class Writer(ABC):
    """Appends batches of one recording to a file; a context manager.

    With ``atomic`` the file appears under its name only when the writer is closed without an error,
    though a device or a pipe is written into; otherwise it grows in place, and whoever records
    handles the operating system's errors.
    """

    def __init__(self, path: str | os.PathLike[str], *, atomic: bool = False) -> None:
        self.path = Path(path)
        self.atomic = atomic
        self._final = self.path.resolve()  # a link keeps pointing where it points
        self._renamed = atomic and can_replace(self._final)
        self._target = (
            self._final.with_name(f"{self._final.name}.part") if self._renamed else self.path
        )
        self._last: Recording | None = None
        self.remarks: dict[str, str] = {}
        """What becomes known while the file grows, such as how many frames were damaged; it is kept
        beside the samples and read back into the recording's notes."""

    def append(self, batch: Recording) -> None:
        """Write the next samples; time runs on from those before."""
        if self._last is None:
            with self._failures_named():
                self._start(batch)
                self._last = batch  # it is open now, and must be closed even if this fails
        elif (batch.temperature is None) != (self._last.temperature is None):
            raise ValueError("`batch` must have a temperature exactly if the ones before it have")
        elif batch.time[0] <= self._last.time[-1]:
            raise ValueError(
                f"`batch` must go on after {self._last.time[-1]:.9g} s, it starts at "
                f"{batch.time[0]:.9g} s"
            )
        with self._failures_named():
            self._append(batch)
        self._last = batch

    def flush(self) -> None:  # noqa: B027 - formats that are written at the end have nothing to do
        """Hand what was appended to the disk, so that a power cut does not lose it."""

    @abstractmethod
    def _start(self, batch: Recording) -> None:
        """Open the file and write what comes before the samples."""

    @abstractmethod
    def _append(self, batch: Recording) -> None:
        """Write one batch."""

    @abstractmethod
    def _finish(self) -> None:
        """Mark the clean end and close the file."""

    def _abandon(self) -> None:
        """Close the file without marking a clean end."""
        self._finish()

    def close(self) -> None:
        """Mark the clean end; harmless if nothing was appended or it is closed already."""
        if self._last is None:
            return
        self._last = None
        with self._failures_named():
            self._finish()
            if self._renamed:
                os.replace(self._target, self._final)

    @contextmanager
    def _failures_named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if not self.atomic:
                raise
            self._remove()
            why = os.strerror(error.errno) if error.errno else str(error)
            raise RecordingWriteError(f"{self.path} cannot be written: {why}") from error
        except BaseException:
            # A signal may come between the opening of the file and the note that it is open.
            self._remove()
            raise

    def _remove(self) -> None:
        """Take away what is not whole and has not its name yet."""
        if self._renamed:
            self._target.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        elif self._last is not None:
            self._last = None
            with suppress(OSError):  # the error that came first is the one to tell
                self._abandon()
            self._remove()


class Format(ABC):
    """One file format. Subclasses set the class attributes; without ``writer`` it is read only."""

    name: ClassVar[str]
    title: ClassVar[str]
    """A few words, for messages."""
    suffixes: ClassVar[tuple[str, ...]] = ()
    """Lower case, with the dot."""
    binary: ClassVar[bool] = True
    several_sensors: ClassVar[bool] = False
    """Whether ``--imu`` must choose one."""
    stands_alone: ClassVar[bool] = False
    """Whether a file states its columns and units itself, so that no profile may."""
    writer: ClassVar[type[Writer] | None] = None

    @abstractmethod
    def sniff(self, head: bytes) -> bool:
        """Return whether a file that starts with these bytes is of this format."""

    @abstractmethod
    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Read the samples in order, at most ``options.batch`` of them at a time."""
