r"""Import profiles: how to read someone else's recording, in a small TOML file.

::

    description = "MPU-6050 logger, raw counts"
    format = "text"                       # or "hdf5", "mimu4444"; text if left out
    rate = 100.0                          # Hz, where there is no time column
    rate_pattern = '^Fs,(\d+)'            # or: found in the lines above the samples
    rate_attribute = "sampling_rate"      # or: an attribute of an HDF5 file

    [text]
    skip_lines = 4                        # lines above the column names
    header = true                         # column names stand above the samples
    delimiter = ","                       # "," ";" "\t" " " ; found from the file if left out
    decimal = "."
    files = "one"                         # "accel,gyro": two files, one for each

    [recognise]
    pattern = '^Fs,\d+\n'                 # in the start of the file: then --profile is not needed

    [time]                                # left out: samples are 1/rate apart
    column = "timestamp"                  # a name, or a number counted from 1
    unit = "us"                           # s ms us ns iso8601, or a number: ticks per second
    wraps = 4294967296                    # where the counter starts again at 0
    clock = "device"                      # device host nominal invalid

    [accel]
    columns = ["ax", "ay", "az"]
    unit = "LSB"                          # m/s^2 g mg LSB
    sensitivity = 16384                   # counts per g; one number, or one for each axis
    full_scale = 2                        # g
    axes = ["x", "y", "z"]                # what is the sensor's x, y, z: ["-y", "x", "z"] turns it

    [gyro]
    columns = ["gx", "gy", "gz"]
    unit = "LSB"                          # rad/s deg/s mdeg/s LSB
    sensitivity = 131                     # counts per deg/s
    full_scale = 250                      # deg/s

    [temperature]
    column = "temp"
    unit = "LSB"                          # degC degF K LSB
    sensitivity = 340                     # counts per kelvin
    zero = 36.53                          # degC at count 0

    [device]
    chip = "MPU-6050"
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np

from calib.errors import RecordingFormatError
from calib.gravity import STANDARD_GRAVITY as G
from calib.recording import AXES, Clock, DeviceInfo
from calib.types import FloatArray

SHIPPED = Path(__file__).parent / "profiles"

ACCEL_UNITS = {"m/s^2": 1.0, "m/s²": 1.0, "g": G, "mg": G / 1000, "LSB": G}
GYRO_UNITS = {
    "rad/s": 1.0,
    "deg/s": np.pi / 180,
    "dps": np.pi / 180,
    "mdeg/s": np.pi / 180e3,
    "mdps": np.pi / 180e3,
    "LSB": np.pi / 180,
}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
TEMPERATURE_UNITS = {"degC": (1.0, 0.0), "°C": (1.0, 0.0), "K": (1.0, -273.15)}
TEMPERATURE_UNITS["degF"] = (5 / 9, -32 * 5 / 9)
Column = str | int
EPOCH = 1e8
"""s, three years: stamps beyond it count from some epoch, not since something was switched on."""


@dataclass(frozen=True, eq=False)
class TriadColumns:
    """Three columns and how they become a vector in SI: ``vector = axes @ (factor * values)``."""

    columns: tuple[Column, ...]
    factor: FloatArray
    axes: FloatArray
    full_scale: float | None = None
    lsb: float | None = None

    def to_si(self, values: FloatArray) -> FloatArray:
        """Convert (n, 3) values of the file; m/s² or rad/s."""
        if np.array_equal(self.axes, np.eye(3)):
            return values if (self.factor == 1.0).all() else values * self.factor
        return np.ascontiguousarray((values * self.factor) @ self.axes.T)


@dataclass(frozen=True)
class TimeColumn:
    """``seconds = (stamp - zero) * factor``; None stands for a date and time of day."""

    column: Column | None
    factor: float | None
    wraps: int | None = None

    def zero(self, first: Any) -> Any:
        """Return the stamp that is 0 s, the first one given: that of dates, and since an epoch.

        Others are told as the file has them, so that what is said of a time is found there.
        """
        dated = self.factor is None or abs(first) * self.factor > EPOCH
        return first if dated else 0


@dataclass(frozen=True)
class TemperatureColumn:
    """``degC = factor * value + zero``."""

    column: Column
    factor: float
    zero: float


@dataclass(frozen=True, eq=False)
class Profile:
    """An import profile, checked."""

    name: str
    description: str
    format: str
    clock: Clock
    device: DeviceInfo
    accel: TriadColumns | None
    gyro: TriadColumns | None
    time: TimeColumn | None = None
    temperature: TemperatureColumn | None = None
    rate: float | None = None
    rate_pattern: re.Pattern[str] | None = None
    rate_attribute: str = ""
    skip_lines: int = 0
    header: bool = False
    delimiter: str | None = None
    decimal: str = "."
    separate_files: bool = False
    pattern: re.Pattern[str] | None = None
    notes: Mapping[str, str] = field(default_factory=dict)

    def recognises(self, text: str) -> bool:
        """Return whether the start of a file shows that this profile is meant for it."""
        return self.pattern is not None and self.pattern.search(text) is not None

    def for_file(self, text: str) -> Profile:
        """Return the profile with the rate that the lines above the samples name."""
        if self.rate_pattern is None:
            return self
        match = self.rate_pattern.search(text)
        if match is None:
            if self.rate is None:
                raise RecordingFormatError(
                    f"profile {self.name}: no rate in the file; expected a line like "
                    f"{self.rate_pattern.pattern!r}"
                )
            return self
        rate = float(match[1])
        if not 0 < rate < 1e7:
            raise RecordingFormatError(f"profile {self.name}: the file names a rate of {rate} Hz")
        return replace(self, rate=rate, device=replace(self.device, rate=rate))


def get_profile(name: str) -> Profile:
    """Return a shipped profile by name, or read one from a TOML file.

    Raises
    ------
    RecordingFormatError
        If there is none, or something in it is wrong; the message names the key.
    """
    path = Path(name)
    if path.suffix == ".toml" or path.is_file():
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise RecordingFormatError(f"import profile {name} cannot be read: {error}") from error
        return parse_profile(text, name=str(path))
    shipped = shipped_profiles()
    if name not in shipped:
        raise RecordingFormatError(
            f"no import profile {name!r}; shipped are {', '.join(shipped)}, or give the path of a "
            ".toml file"
        )
    return shipped[name]


@cache
def shipped_profiles() -> dict[str, Profile]:
    """Return the profiles that come with imu-cal, by name."""
    return {
        path.stem: parse_profile(path.read_text(encoding="utf-8"), name=path.stem)
        for path in sorted(SHIPPED.glob("*.toml"))
    }


def parse_profile(text: str, *, name: str) -> Profile:
    """Check a profile's TOML and return it.

    Raises
    ------
    RecordingFormatError
        If it is no TOML, a key is unknown, missing or has a wrong value.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RecordingFormatError(f"import profile {name} is no TOML: {error}") from error
    return make_profile(values, name=name)


def make_profile(values: Mapping[str, Any], *, name: str) -> Profile:
    """Check what a profile's TOML says and return the profile.

    Raises
    ------
    RecordingFormatError
        If a key is unknown, missing or has a wrong value.
    """
    top = _Table(values, f"import profile {name}")
    layout, device, recognise = top.table("text"), top.table("device"), top.table("recognise")
    accel = _triad(top.table("accel"), ACCEL_UNITS)
    gyro = _triad(top.table("gyro"), GYRO_UNITS)
    if accel is None and gyro is None:
        raise RecordingFormatError(f"import profile {name}: neither [accel] nor [gyro]")
    rate = top.number("rate")
    time, clock = _time(top.table("time"))
    files = layout.choice("files", ("one", "accel,gyro"), "one")
    profile = Profile(
        name=name,
        description=top.text("description"),
        format=top.choice("format", ("text", "hdf5", "mimu4444"), "text"),
        clock=clock,
        device=DeviceInfo(
            chip=device.text("chip"),
            serial_number=device.text("serial_number"),
            accel_full_scale=None if accel is None else accel.full_scale,
            gyro_full_scale=None if gyro is None else gyro.full_scale,
            accel_lsb=None if accel is None else accel.lsb,
            gyro_lsb=None if gyro is None else gyro.lsb,
            rate=rate,
        ),
        accel=accel,
        gyro=gyro,
        time=time,
        temperature=_temperature(top.table("temperature")),
        rate=rate,
        rate_pattern=top.pattern("rate_pattern"),
        rate_attribute=top.text("rate_attribute"),
        skip_lines=int(layout.number("skip_lines") or 0),
        header=layout.flag("header"),
        delimiter=layout.text("delimiter") or None,
        decimal=layout.text("decimal") or ".",
        separate_files=files == "accel,gyro",
        pattern=recognise.pattern("pattern"),
        notes={key: str(value) for key, value in top.take("notes", {}).items()},
    )
    for table in (layout, device, recognise, top):
        table.finish()
    if profile.format == "text" and time is None and rate is None and profile.rate_pattern is None:
        raise RecordingFormatError(
            f"import profile {name}: no [time] and no rate; give one, nothing can be assumed"
        )
    return profile


class _Table:
    """One table of a profile, from which keys are taken; what is left over is unknown."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self._values = dict(values)
        self.where = where

    def __bool__(self) -> bool:
        return bool(self._values)

    def error(self, key: str, expected: str, value: object) -> RecordingFormatError:
        return RecordingFormatError(f"{self.where}: {key} must be {expected}, got {value!r}")

    def has(self, key: str) -> bool:
        return key in self._values

    def take(self, key: str, default: Any = None) -> Any:
        return self._values.pop(key, default)

    def table(self, key: str) -> _Table:
        value = self.take(key, {})
        if not isinstance(value, Mapping):
            raise self.error(key, "a table", value)
        return _Table(value, f"{self.where} [{key}]")

    def number(self, key: str) -> float | None:
        value = self.take(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
            raise self.error(key, "a number that is not negative", value)
        return float(value)

    def text(self, key: str) -> str:
        value = self.take(key, "")
        if not isinstance(value, str):
            raise self.error(key, "text", value)
        return value

    def flag(self, key: str) -> bool:
        value = self.take(key, False)
        if not isinstance(value, bool):
            raise self.error(key, "true or false", value)
        return value

    def choice(self, key: str, choices: tuple[str, ...], default: str) -> str:
        value = self.take(key, default)
        if value not in choices:
            raise self.error(key, f"one of {', '.join(choices)}", value)
        return str(value)

    def pattern(self, key: str) -> re.Pattern[str] | None:
        value = self.text(key)
        if not value:
            return None
        try:
            return re.compile(value, re.MULTILINE)
        except re.error as error:
            raise self.error(key, f"a regular expression ({error})", value) from error

    def column(self, key: str) -> Column:
        return self._checked_column(key, self.take(key))

    def columns(self, key: str) -> tuple[Column, ...]:
        value = self.take(key)
        if isinstance(value, str):  # one data set with three columns
            return (value,)
        if not isinstance(value, list) or len(value) != 3:
            raise self.error(key, "three column names or numbers", value)
        return tuple(self._checked_column(key, item) for item in value)

    def _checked_column(self, key: str, value: object) -> Column:
        if isinstance(value, str) and value:
            return value
        if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
            return value
        raise self.error(key, "a column's name, or its number from 1", value)

    def finish(self) -> None:
        if self._values:
            raise RecordingFormatError(
                f"{self.where}: unknown key {', '.join(map(repr, self._values))}"
            )


def _triad(table: _Table, units: Mapping[str, float]) -> TriadColumns | None:
    if not table:
        return None
    columns = table.columns("columns")
    unit = table.choice("unit", tuple(units), "")
    sensitivity = table.take("sensitivity")
    lsb: float | None = None
    factor = np.full(3, units[unit])
    if unit == "LSB":
        counts = np.asarray(sensitivity if sensitivity is not None else np.nan, np.float64)
        if counts.shape not in ((), (3,)) or not (counts > 0).all():
            raise table.error("sensitivity", "the counts per g or per deg/s", sensitivity)
        factor = factor / counts
        lsb = float(factor.mean())
    elif sensitivity is not None:
        raise table.error("sensitivity", f"left out where the unit is {unit}", sensitivity)
    full_scale = table.number("full_scale")
    resolution = table.number("resolution")
    names = table.take("axes", list(AXES))
    axes = np.zeros((3, 3))
    spelled = [str(name).lstrip("+-") for name in names] if isinstance(names, list) else []
    if sorted(spelled) != list(AXES):
        raise table.error(
            "axes", 'x, y and z in some order, with signs, as ["-y", "x", "z"]', names
        )
    for row, name in enumerate(names):
        axes[row, AXES.index(spelled[row])] = -1.0 if name.startswith("-") else 1.0
    table.finish()
    return TriadColumns(
        columns,
        factor,
        axes,
        None if full_scale is None else full_scale * units["LSB"],
        lsb if resolution is None else resolution * units[unit],
    )


def _time(table: _Table) -> tuple[TimeColumn | None, Clock]:
    if not table:
        return None, "nominal"
    column = table.column("column") if table.has("column") else None
    unit = table.take("unit", "s")
    if isinstance(unit, int | float) and not isinstance(unit, bool) and unit > 0:
        factor: float | None = 1.0 / unit
    elif unit == "iso8601":
        factor = None
    elif unit in TIME_UNITS:
        factor = TIME_UNITS[unit]
    else:
        expected = f"one of {', '.join(TIME_UNITS)}, iso8601, or a number of ticks per second"
        raise table.error("unit", expected, unit)
    wraps = table.number("wraps")
    clock = table.choice("clock", get_args(Clock), "device")
    table.finish()
    return TimeColumn(column, factor, None if wraps is None else int(wraps)), clock  # type: ignore[return-value]


def _temperature(table: _Table) -> TemperatureColumn | None:
    if not table:
        return None
    column = table.column("column")
    unit = table.choice("unit", (*TEMPERATURE_UNITS, "LSB"), "degC")
    sensitivity, zero = table.number("sensitivity"), table.take("zero", 0.0)
    if unit == "LSB":
        if not sensitivity:
            raise table.error("sensitivity", "the counts per kelvin", sensitivity)
        factor, shift = 1.0 / sensitivity, float(zero)
    else:
        factor, shift = TEMPERATURE_UNITS[unit]
    table.finish()
    return TemperatureColumn(column, factor, shift)
