"""Recordings on disk: one file per format, found by suffix and by content.

`read_recording` reads one recording from one or more files, `open_batches` the same in bounded
memory, `write_recording` writes one, `open_writer` appends to one batch by batch.
"""

from __future__ import annotations

import difflib
import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from calib.errors import (
    EmptyRecordingError,
    RecordingError,
    RecordingFormatError,
    RecordingNotFoundError,
)
from calib.recording import Recording, join
from calib.registry import discover
from drivers.formats.arrow import ArrowWriter
from drivers.formats.base import HEAD, Format, ReadOptions, Source, Writer
from drivers.formats.profile import get_profile
from drivers.formats.text import decode_head

__all__ = [
    "ArrowWriter",
    "Writer",
    "open_batches",
    "open_writer",
    "read_recording",
    "write_recording",
]

BATCH = 1 << 16
"""Samples in a batch of `open_batches`."""
PACKED = {
    b"\x1f\x8b": "compressed by gzip: gunzip it first, and give what is in it",
    b"PK\x03\x04": "a ZIP archive, or a sheet of Excel: unpack it first, or export it as CSV",
}
"""How files begin that hold a recording in another wrapping, and what to do."""

FILE_GAP = 1.0
"""s between files that are one recording but whose clocks do not run on."""

Path_ = str | os.PathLike[str]


@cache
def formats() -> dict[str, Format]:
    """Return every format by name."""
    return discover(__name__, __path__, attribute="FORMAT", kind=Format, key="name")  # type: ignore[type-abstract]


def read_recording(
    paths: Path_ | Sequence[Path_],
    *,
    profile: str | None = None,
    imu: int | None = None,
    drop_invalid: bool = False,
) -> Recording:
    """Read a recording from a file, or from several that follow each other.

    Several files are one recording of one device: separate files of the accelerometer and the
    gyroscope where the profile says so, otherwise one after the other, as with one file per pose.
    A file whose clock does not run on from the one before is put one second after it, and the
    samples that would fill the gap are counted in ``lost``.

    Parameters
    ----------
    paths : path or sequence of paths
    profile : str, optional
        An import profile: a shipped name, or the path of a TOML file.
    imu : int, optional
        Which sensor of a board with several, from 1.
    drop_invalid : bool
        Leave out rows that are not finite or whose time does not increase, and count them in
        ``lost``, instead of refusing them.

    Raises
    ------
    RecordingError
        RecordingNotFoundError, RecordingFormatError, EmptyRecordingError or InvalidSampleError; the
        message says what was seen, what was expected and what to do.
    """
    batches = _batches(paths, profile, imu, drop_invalid=drop_invalid, batch=None)
    return join(list(batches))


def open_batches(
    paths: Path_ | Sequence[Path_],
    *,
    profile: str | None = None,
    imu: int | None = None,
    drop_invalid: bool = False,
    batch: int = BATCH,
) -> Iterator[Recording]:
    """Read as `read_recording` does, but `batch` samples at a time: memory stays bounded."""
    if batch < 1:
        raise ValueError(f"`batch` must be at least 1, got {batch}")
    return _batches(paths, profile, imu, drop_invalid=drop_invalid, batch=batch)


def write_recording(recording: Recording, path: Path_) -> None:
    """Write a recording in the format of the suffix, whole or not at all."""
    with open_writer(path, atomic=True) as writer:
        writer.append(recording)


def open_writer(path: Path_, *, atomic: bool = False) -> Writer:
    """Return a writer that appends batches to a file in the format of its suffix.

    With ``atomic`` the file appears only when the writer is closed without an error.

    Raises
    ------
    RecordingFormatError
        If the suffix is none that can be written, or the folder is not there.
    """
    path = Path(path)
    for item in formats().values():
        if path.suffix.lower() in item.suffixes and item.writer is not None:
            if not path.parent.is_dir():
                raise RecordingNotFoundError(f"there is no folder {path.parent} to write {path} in")
            if path.is_dir():
                raise RecordingNotFoundError(f"{path} is a folder, expected a file to write")
            return item.writer(path, atomic=atomic)
    known = ", ".join(s for f in formats().values() if f.writer is not None for s in f.suffixes)
    raise RecordingFormatError(
        f"cannot write {path}: its suffix {path.suffix!r} names no format; expected one of {known}"
    )


def find_source(path: Path_) -> Source:
    """Open a file and look at its start.

    Raises
    ------
    RecordingNotFoundError
        If there is no such file, or it is a folder.
    EmptyRecordingError
        If it holds nothing.
    """
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        raise RecordingNotFoundError(_not_found(path)) from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from error
    if stat.S_ISDIR(mode):
        raise RecordingNotFoundError(
            f"{path} is a folder, expected a recording; give the files in it, such as {path}/*"
        )
    regular = stat.S_ISREG(mode)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD if regular else -1)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from error
    if not head:
        raise EmptyRecordingError(
            f"{path} is empty (0 bytes), expected a recording; was the disk full, or the logger "
            "stopped before it wrote?"
        )
    return Source(path, head, regular=regular)


def find_format(source: Source, options: ReadOptions) -> Format:
    """Return the format of a file: what its content says, as far as its suffix allows it.

    Raises
    ------
    RecordingFormatError
        If the content is of no known format, or not what the suffix says.
    """
    for magic, packed in PACKED.items():
        if source.head.startswith(magic):
            raise RecordingFormatError(f"{source.path} is {packed}")
    suffix = source.path.suffix.lower()
    every = formats()
    found = next((f for f in every.values() if f.sniff(source.head)), None)
    named = [f for f in every.values() if suffix in f.suffixes]
    starts = f"it starts with {source.head[:8].hex(' ')}"
    if named and not named[0].binary:
        binary = decode_head(source.head) is None
        if binary or (found is not None and found.binary):
            what = found.title if found is not None and found.binary else "binary data"
            raise RecordingFormatError(
                f"{source.path} holds {what} ({starts}), expected text, as {suffix} says; give it "
                "its right suffix, or give the file that you meant"
            )
    elif named and found is not named[0] and (found is None or suffix not in found.suffixes):
        what = found.title if found is not None else "nothing that is known"
        raise RecordingFormatError(
            f"{source.path} is no {named[0].title}: {starts}, which is {what}. It is damaged, "
            "or has a wrong suffix"
        )
    if options.profile is not None and found is not None and found.stands_alone:
        raise RecordingFormatError(
            f"{source.path} is an {found.title} and states its columns and units itself; leave "
            f"--profile {options.profile.name} away"
        )
    if options.profile is not None and options.profile.format in every:
        return every[options.profile.format]
    if found is not None:
        return found
    if decode_head(source.head) is None:
        known = ", ".join(f.title for f in every.values())
        raise RecordingFormatError(f"{source.path} is of no known format: {starts}; known: {known}")
    return every["text"]


def _batches(
    paths: Path_ | Sequence[Path_],
    profile: str | None,
    imu: int | None,
    *,
    drop_invalid: bool,
    batch: int | None,
) -> Iterator[Recording]:
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not files:
        raise ValueError("`paths` must name at least one file")
    options = ReadOptions(
        None if profile is None else get_profile(profile), imu, drop_invalid, batch
    )
    last: Recording | None = None
    for group in _groups(files, options):
        sources = [find_source(file) for file in group]
        shift: float | None = None if last is not None else 0.0
        for part in _parts(sources, options):
            if shift is None and last is not None:
                shift, part = _follow(last, part, sources[0])
            elif shift:
                part = replace(part, time=part.time + shift)
            last = part
            yield part


def _groups(files: list[Path_], options: ReadOptions) -> list[list[Path_]]:
    """Return the files that belong together: pairs where the profile says so."""
    profile = options.profile
    if profile is None or not profile.separate_files:
        return [[file] for file in files]
    if len(files) % 2:
        raise RecordingFormatError(
            f"profile {profile.name} reads pairs of files, the accelerometer's and then the "
            f"gyroscope's, but {len(files)} were given: {', '.join(map(str, files))}"
        )
    return [files[k : k + 2] for k in range(0, len(files), 2)]


def _parts(sources: list[Source], options: ReadOptions) -> Iterator[Recording]:
    if len(sources) == 1:
        form = find_format(sources[0], options)
        if options.imu is not None and not form.several_sensors:
            raise RecordingFormatError(
                f"{sources[0].path} holds one sensor, and --imu {options.imu} was given; leave it "
                "away, it is for boards with several"
            )
        yield from form.batches(sources[0], options)
        return
    from drivers.formats.pairs import read_pair

    assert options.profile is not None
    whole = read_pair(sources[0], sources[1], options.profile, options)
    width = options.batch or len(whole)
    for at in range(0, len(whole), width):
        yield whole.slice(at, min(at + width, len(whole)))


def _follow(last: Recording, part: Recording, source: Source) -> tuple[float, Recording]:
    """Put the first batch of a file after the file before it; return the shift of its clock, s."""
    mine, theirs = part.device, last.device
    if (mine.chip, mine.serial_number) != (theirs.chip, theirs.serial_number):
        raise RecordingFormatError(
            f"{source.path} is of device {mine.chip} {mine.serial_number}, the file before it of "
            f"{theirs.chip} {theirs.serial_number}; expected files of one device"
        )
    if (part.temperature is None) != (last.temperature is None):
        has = ("a", "none") if last.temperature is None else ("no", "one")
        raise RecordingFormatError(
            f"{source.path} has {has[0]} temperature, the file before it has {has[1]}; expected "
            "all or none of them to"
        )
    end, interval = float(last.time[-1]), part.interval or last.interval
    shift = 0.0 if part.time[0] > end else end + FILE_GAP - float(part.time[0])
    lost = np.array(part.lost)
    if interval > 0:
        lost[0] += max(0, round((float(part.time[0]) + shift - end) / interval) - 1)
    return shift, replace(part, time=part.time + shift, lost=lost)


def _not_found(path: Path) -> str:
    near: list[str] = []
    if path.parent.is_dir():
        names = [item.name for item in path.parent.iterdir()]
        near = difflib.get_close_matches(path.name, names, n=1)
    hint = f"; did you mean {path.parent / near[0]}?" if near else ""
    return f"there is no file {path}{hint}"
