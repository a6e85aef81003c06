"""Parquet files with the native columns and metadata."""

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

MAGIC = b"PAR1"


class ParquetWriter(Writer):
    """Appends row groups to a Parquet file; it can be read once it is closed."""

    def _start(self, batch: Recording) -> None:
        from pyarrow import parquet

        self._schema = schema_of(batch)
        self._file = pa.OSFile(os.fsencode(self._target), "wb")
        self._parquet = parquet.ParquetWriter(self._file, self._schema)

    def _append(self, batch: Recording) -> None:
        self._parquet.write_batch(to_batch(batch, self._schema))

    def _finish(self) -> None:
        self._parquet.close()
        self._file.close()


class Parquet(Format):
    """Parquet."""

    name = "parquet"
    title = "Parquet file"
    stands_alone = True
    suffixes = (".parquet", ".pq")
    writer = ParquetWriter

    def sniff(self, head: bytes) -> bool:
        """Look for the magic bytes."""
        return head.startswith(MAGIC)

    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Read row groups in order."""
        from pyarrow import parquet

        name = str(source.path)
        try:
            file = parquet.ParquetFile(pa.BufferReader(source.buffer))
            assembler = assembler_of(
                file.schema_arrow, name=name, drop_invalid=options.drop_invalid
            )
            if options.batch is None:
                tables = iter([file.read()] if file.metadata.num_rows else [])
            else:
                tables = file.iter_batches(batch_size=options.batch)
            for table in tables:
                recording = add_table(assembler, table)
                if recording is not None:
                    yield recording
        except DAMAGED as error:
            raise RecordingFormatError(
                f"{name} is damaged, or was not closed: {error}. A Parquet file has its index at "
                "its end; record to .arrow, which can be read up to where it was cut"
            ) from error
        if not assembler.rows:
            raise no_samples(name)


FORMAT = Parquet()
