"""What was measured: samples in SI units, and what is known of the device that made them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib.errors import EmptyRecordingError, InvalidSampleError
from calib.types import BoolArray, FloatArray, IntArray

AXES = ("x", "y", "z")
TRIADS = {"accel": "accelerometer", "gyro": "gyroscope"}
CHANNELS = tuple(f"{triad}.{axis}" for triad in TRIADS for axis in AXES)

Clock = Literal["device", "host", "nominal", "invalid"]
"""Where ``time`` comes from: the device's own clock; the host's arrival times regressed to a steady
clock; a nominal rate (sample number over rate); or a clock known to be wrong (order only)."""


@dataclass(frozen=True)
class DeviceInfo:
    """What is known of the device; None or empty where it is not known. SI units.

    ``accel_lsb`` and ``gyro_lsb`` are the size of one count in m/s² and rad/s, ``rate`` is in Hz.
    """

    chip: str = ""
    serial_number: str = ""
    accel_full_scale: float | None = None
    gyro_full_scale: float | None = None
    accel_lsb: float | None = None
    gyro_lsb: float | None = None
    rate: float | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of one device, in SI units, read-only, checked once.

    Parameters
    ----------
    time : (n,) array, s
        Strictly increasing, on the recording's own clock.
    accel : (n, 3) array, m/s²
    gyro : (n, 3) array, rad/s
    temperature : (n,) array, °C, or None
    lost : (n,) array of int, or None
        Samples known to be missing just before each sample; None means none are.
    clock : {"device", "host", "nominal", "invalid"}
        Where ``time`` comes from.
    device : DeviceInfo
    complete : bool
        False where the file was cut: its writer did not mark a clean end.
    notes : mapping of str to str
        How it was made and read (operator notes, profile, source file).

    Raises
    ------
    EmptyRecordingError
        If there is no sample.
    InvalidSampleError
        If a value is not finite or time does not increase; the message names the sample.
    ValueError
        If shapes disagree.
    """

    time: FloatArray
    accel: FloatArray
    gyro: FloatArray
    clock: Clock
    temperature: FloatArray | None = None
    lost: IntArray | None = None
    device: DeviceInfo = field(default_factory=DeviceInfo)
    complete: bool = True
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = _readonly(self.time, np.float64)
        n = time.size
        if time.ndim != 1:
            raise ValueError(f"`time` must be (n,), got {time.shape}")
        if n == 0:
            raise EmptyRecordingError("the recording holds no samples")
        object.__setattr__(self, "time", time)
        for name, shape in (("accel", (n, 3)), ("gyro", (n, 3)), ("temperature", (n,))):
            value = getattr(self, name)
            if value is None:
                continue
            value = _readonly(value, np.float64)
            if value.shape != shape:
                raise ValueError(f"`{name}` must be {shape}, got {value.shape}")
            _check_finite(name, value)
            object.__setattr__(self, name, value)
        lost = np.zeros(n, np.int64) if self.lost is None else self.lost
        lost = _readonly(lost, np.int64)
        if lost.shape != (n,):
            raise ValueError(f"`lost` must be {(n,)}, got {lost.shape}")
        if lost.min() < 0:
            raise ValueError("`lost` must not be negative")
        object.__setattr__(self, "lost", lost)
        _check_finite("time", time)
        step = np.diff(time)
        if n > 1 and step.min() <= 0:
            k = int(np.argmax(step <= 0)) + 1
            raise InvalidSampleError(
                f"time must increase: sample {k} is at {time[k]:.9g} s, the one before it at "
                f"{time[k - 1]:.9g} s"
            )
        object.__setattr__(self, "notes", MappingProxyType(dict(self.notes)))

    def __len__(self) -> int:
        return int(self.time.size)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def interval(self) -> float:
        """Median time between samples, s (0 for a single sample)."""
        return float(np.median(np.diff(self.time))) if len(self) > 1 else 0.0

    @property
    def samples_lost(self) -> int:
        """How many samples are known to be missing."""
        assert self.lost is not None
        return int(self.lost.sum())

    def slice(self, start: int, stop: int) -> Recording:
        """Return samples ``[start, stop)`` as a recording of its own."""
        assert self.lost is not None
        temperature = None if self.temperature is None else self.temperature[start:stop]
        return replace(
            self,
            time=self.time[start:stop],
            accel=self.accel[start:stop],
            gyro=self.gyro[start:stop],
            temperature=temperature,
            lost=self.lost[start:stop],
        )

    def select(self, which: BoolArray | IntArray) -> Recording:
        """Return some of the samples, by (n,) flags or by number, as a recording of their own."""
        assert self.lost is not None
        return replace(
            self,
            time=self.time[which],
            accel=self.accel[which],
            gyro=self.gyro[which],
            temperature=None if self.temperature is None else self.temperature[which],
            lost=self.lost[which],
        )

    def channel(self, name: str) -> FloatArray:
        """Return one channel, ``accel.x`` to ``gyro.z``, as an (n,) array."""
        if name not in CHANNELS:
            raise ValueError(f"`name` must be one of {', '.join(CHANNELS)}, got {name!r}")
        triad, axis = name.split(".")
        values: FloatArray = getattr(self, triad)
        return values[:, AXES.index(axis)]


def join(parts: Sequence[Recording]) -> Recording:
    """Return parts that follow each other as one recording."""
    if len(parts) == 1:
        return parts[0]
    if not parts:
        raise EmptyRecordingError("no row of the recording can be used")
    temperatures = [part.temperature for part in parts if part.temperature is not None]
    notes: dict[str, str] = {}
    for part in parts:
        notes |= part.notes
    return replace(
        parts[0],
        time=np.concatenate([part.time for part in parts]),
        accel=np.concatenate([part.accel for part in parts]),
        gyro=np.concatenate([part.gyro for part in parts]),
        temperature=np.concatenate(temperatures) if len(temperatures) == len(parts) else None,
        lost=np.concatenate([part.lost for part in parts if part.lost is not None]),
        complete=all(part.complete for part in parts),
        notes=notes,
    )


def _readonly(value: object, dtype: type[Any]) -> NDArray[Any]:
    array: NDArray[Any] = np.asarray(value, dtype=dtype)
    if array.flags.writeable:
        # Freeze a view: the caller's own array stays writable, and nothing is copied.
        array = array.view()
        array.flags.writeable = False
    return array


def _check_finite(name: str, value: FloatArray) -> None:
    # A sum is finite if all terms are, and costs no temporary array; look closer only if it is not.
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(value.sum())
    if not finite and not np.isfinite(value).all():
        row = int(np.argmax(~np.isfinite(value).reshape(value.shape[0], -1).all(axis=1)))
        raise InvalidSampleError(f"{name} is not finite at sample {row}: {value[row]}")
