"""HDF5 files with one data set for each triad, as BROAD has them, through an import profile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from calib.errors import EmptyRecordingError, RecordingError, RecordingFormatError
from calib.recording import Recording
from calib.types import FloatArray
from drivers.formats.assemble import Assembler
from drivers.formats.base import Format, ReadOptions, Source
from drivers.formats.profile import Column, Profile, TriadColumns, shipped_profiles

MAGIC = b"\x89HDF\r\n\x1a\n"


class Hdf5(Format):
    """HDF5."""

    name = "hdf5"
    title = "HDF5 file"
    suffixes = (".hdf5", ".h5")

    def sniff(self, head: bytes) -> bool:
        """Look for the magic bytes."""
        return head.startswith(MAGIC)

    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Read the data sets that the profile names, or that a shipped profile recognises."""
        try:
            import h5py
        except ImportError as error:
            raise RecordingFormatError(
                f"{source.path} is an HDF5 file, which needs h5py: pip install 'imu-cal[hdf5]'"
            ) from error
        try:
            file = h5py.File(source.path, "r")
        except OSError as error:
            raise RecordingFormatError(f"{source.path} is a damaged HDF5 file: {error}") from error
        try:
            with file:
                profile = options.profile or _recognise(file, source)
                yield from _read(file, source, profile, options)
        except RecordingError:
            raise
        except (OSError, LookupError, RuntimeError, TypeError, ValueError) as error:
            # What h5py makes of damage.
            raise RecordingFormatError(f"{source.path} is a damaged HDF5 file: {error}") from error


FORMAT = Hdf5()


def _recognise(file: Any, source: Source) -> Profile:
    """Return the shipped profile whose data sets are all there."""
    for profile in shipped_profiles().values():
        if profile.format == "hdf5" and all(name in file for name in _names(profile)):
            return profile
    raise RecordingFormatError(
        f"{source.path} has data sets {', '.join(map(str, file))}, which no shipped profile knows; "
        'write a profile with format = "hdf5" and give it with --profile FILE.toml'
    )


def _names(profile: Profile) -> list[str]:
    triads = [triad for triad in (profile.accel, profile.gyro) if triad is not None]
    return [str(triad.columns[0]) for triad in triads]


def _read(file: Any, source: Source, profile: Profile, options: ReadOptions) -> Iterator[Recording]:
    if profile.accel is None or profile.gyro is None:
        raise RecordingFormatError(f"profile {profile.name} needs both [accel] and [gyro]")
    accel = _data_set(file, source, profile.accel.columns[0], 2)
    gyro = _data_set(file, source, profile.gyro.columns[0], 2)
    n = len(accel)
    if len(gyro) != n:
        raise RecordingFormatError(
            f"{source.path}: {len(gyro)} samples of the gyroscope, {n} of the accelerometer; "
            "expected as many of both"
        )
    if n == 0:
        raise EmptyRecordingError(f"{source.path} has its data sets but no samples in them")
    time, rate = profile.time, profile.rate
    stamps = None
    if time is not None and time.column is not None:
        if time.factor is None:
            raise RecordingFormatError(f"profile {profile.name}: an HDF5 time needs a unit of time")
        stamps = _data_set(file, source, time.column, 1)
    elif profile.rate_attribute:
        rate = _rate(file, source, profile.rate_attribute)
    elif rate is None:
        raise RecordingFormatError(f"profile {profile.name}: no [time], rate or rate_attribute")
    temperature = profile.temperature
    heat = None if temperature is None else _data_set(file, source, temperature.column, 1)
    recognised = " (recognised from the file)" if options.profile is None else ""
    assembler = Assembler(
        name=str(source.path),
        clock=profile.clock,
        device=replace(profile.device, rate=rate),
        drop_invalid=options.drop_invalid,
        notes={"profile": profile.name + recognised, **profile.notes},
    )
    width = options.batch or n
    for at in range(0, n, width):
        part = slice(at, min(at + width, n))
        if stamps is not None and time is not None and time.factor is not None:
            seconds: FloatArray = (stamps[part] - time.zero(stamps[0])) * time.factor
        else:
            assert rate is not None
            seconds = np.arange(part.start, part.stop) / rate
        degrees = None
        if heat is not None and temperature is not None:
            degrees = temperature.factor * heat[part] + temperature.zero
        recording = assembler.add(
            seconds,
            _vectors(profile.accel, accel[part]),
            _vectors(profile.gyro, gyro[part]),
            degrees,
        )
        if recording is not None:
            yield recording


def _vectors(triad: TriadColumns, values: Any) -> FloatArray:
    return triad.to_si(np.asarray(values, np.float64))


def _data_set(file: Any, source: Source, name: Column, dimensions: int) -> Any:
    if str(name) not in file:
        raise RecordingFormatError(
            f"{source.path} has no data set {name!r} among {', '.join(map(str, file))}"
        )
    found = file[str(name)]
    shape = getattr(found, "shape", None)
    if shape is None or len(shape) != dimensions or (dimensions == 2 and shape[1] != 3):
        expected = "(n, 3)" if dimensions == 2 else "(n,)"
        raise RecordingFormatError(f"{source.path}: {name} is {shape}, expected {expected}")
    return found


def _rate(file: Any, source: Source, attribute: str) -> float:
    rate: Any = file.attrs.get(attribute)
    if not isinstance(rate, int | float | np.number) or not 0 < float(rate) < 1e7:
        raise RecordingFormatError(
            f"{source.path}: attribute {attribute} is {rate!r}, expected the rate in Hz"
        )
    return float(rate)
