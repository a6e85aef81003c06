"""The native form: an Arrow IPC stream that grows batch by batch.

A recording that was killed can be read up to its last whole batch. The clean end is the stream's
own end mark (``FF FF FF FF 00 00 00 00``); without it the recording says ``complete=False``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import pyarrow as pa

from calib.errors import RecordingFormatError
from calib.recording import Recording
from drivers.formats.base import Format, ReadOptions, Source, Writer
from drivers.formats.columns import (
    DAMAGED,
    add_table,
    assembler_of,
    no_samples,
    schema_of,
    to_batch,
)

CONTINUATION = b"\xff\xff\xff\xff"
END = CONTINUATION + b"\0\0\0\0"
MAX_SCHEMA = 1 << 24


class ArrowWriter(Writer):
    """Appends batches to an Arrow IPC stream, each readable as soon as it is written."""

    def _start(self, batch: Recording) -> None:
        self._schema = schema_of(batch)
        self._file = pa.OSFile(os.fsencode(self._target), "wb")  # not buffered: a write is a write
        self._stream = pa.ipc.new_stream(self._file, self._schema)

    def _append(self, batch: Recording) -> None:
        remarks = self.remarks or None
        self._stream.write_batch(to_batch(batch, self._schema), custom_metadata=remarks)

    def flush(self) -> None:
        """Hand what was appended to the disk: after this a power cut does not lose it."""
        if self._last is not None:
            os.fsync(self._file.fileno())

    def _finish(self) -> None:
        self._stream.close()
        os.fsync(self._file.fileno())
        self._file.close()

    def _abandon(self) -> None:
        self._file.close()  # no end mark: it was not a clean end


class Arrow(Format):
    """Arrow IPC stream."""

    name = "arrow"
    title = "Arrow IPC stream"
    stands_alone = True
    suffixes = (".arrow", ".arrows")
    writer = ArrowWriter

    def sniff(self, head: bytes) -> bool:
        """Look for the continuation mark and a schema message of believable length."""
        if len(head) < 8 or not head.startswith(CONTINUATION):
            return False
        return 0 < int.from_bytes(head[4:8], "little") < MAX_SCHEMA

    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Read whole batches up to the end mark, or up to where the file was cut."""
        name, buffer = str(source.path), source.buffer
        try:
            bounded = options.batch is not None
            reader = pa.ipc.open_stream(source.stream(0, buffer.size) if bounded else buffer)
            assembler = assembler_of(reader.schema, name=name, drop_invalid=options.drop_invalid)
        except DAMAGED as error:
            raise RecordingFormatError(
                f"{name} was cut or damaged before its first sample: {error}"
            ) from error
        ended = buffer.slice(max(0, buffer.size - len(END))).to_pybytes() == END
        if not ended:
            assembler.complete = False
            assembler.notes["cut"] = "no end mark; read up to the last whole batch"
        if options.batch is None:
            parts = list(_parts(reader, name, assembler.notes, ended=ended))
            tables = [pa.Table.from_batches(parts)] if parts else []
        else:
            tables = (  # type: ignore[assignment]
                part.slice(at, options.batch)
                for part in _parts(reader, name, assembler.notes, ended=ended)
                for at in range(0, part.num_rows, options.batch)
            )
        for table in tables:
            recording = add_table(assembler, table)
            if recording is not None:
                yield recording
        # What Arrow keeps for a batch to come would be memory that others lack.
        pa.default_memory_pool().release_unused()
        if not assembler.rows:
            raise no_samples(name)


FORMAT = Arrow()


def _parts(reader: Any, name: str, notes: dict[str, str], *, ended: bool) -> Iterator[Any]:
    """Yield the batches with samples; what was remarked beside them goes into `notes`."""
    while True:
        try:
            part, remarks = reader.read_next_batch_with_custom_metadata()
        except StopIteration:
            return
        except DAMAGED as error:
            if ended:
                raise RecordingFormatError(f"{name} is damaged: {error}") from error
            return
        for key, value in (remarks or {}).items():
            notes[key.decode()] = value.decode()
        if part.num_rows:
            yield part
