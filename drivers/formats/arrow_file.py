"""The Arrow IPC *file* form (Feather version 2), with the native columns and metadata."""

from __future__ import annotations

import os
from collections.abc import Iterator

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

MAGIC = b"ARROW1"


class ArrowFileWriter(Writer):
    """Appends batches to an Arrow file; it can be read once it is closed."""

    def _start(self, batch: Recording) -> None:
        self._schema = schema_of(batch)
        self._file = pa.OSFile(os.fsencode(self._target), "wb")
        self._arrow = pa.ipc.new_file(self._file, self._schema)

    def _append(self, batch: Recording) -> None:
        self._arrow.write_batch(to_batch(batch, self._schema))

    def _finish(self) -> None:
        self._arrow.close()
        self._file.close()


class ArrowFile(Format):
    """Arrow IPC file."""

    name = "arrow_file"
    title = "Arrow IPC file"
    stands_alone = True
    suffixes = (".feather", ".ipc")
    writer = ArrowFileWriter

    def sniff(self, head: bytes) -> bool:
        """Look for the magic bytes."""
        return head.startswith(MAGIC)

    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Read record batches in order."""
        name = str(source.path)
        try:
            reader = pa.ipc.open_file(source.buffer)
            assembler = assembler_of(reader.schema, name=name, drop_invalid=options.drop_invalid)
            if options.batch is None:
                whole = reader.read_all()
                tables = iter([whole] if whole.num_rows else [])
            else:
                tables = (
                    part.slice(at, options.batch)
                    for part in map(reader.get_batch, range(reader.num_record_batches))
                    for at in range(0, part.num_rows, options.batch)
                )
            for table in tables:
                recording = add_table(assembler, table)
                if recording is not None:
                    yield recording
        except DAMAGED as error:
            raise RecordingFormatError(
                f"{name} is damaged, or was not closed: {error}. The file form has its index at "
                "its end; record to .arrow, which can be read up to where it was cut"
            ) from error
        if not assembler.rows:
            raise no_samples(name)


FORMAT = ArrowFile()
