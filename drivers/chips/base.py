"""Registers, fields and what a chip is: the vocabulary in which a chip's file is written.

A chip's file declares its registers as its register map lists them, and overrides the few hooks in
which chips really differ (how to start, how its FIFO is framed). Degrees, g and counts live here,
at the edge: everything that leaves `Chip` is SI or named as counts.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from calib.errors import DriverTimeoutError
from calib.gravity import STANDARD_GRAVITY

"""m/s² in 1 g: the definition that every accelerometer's sensitivity is stated in."""

Counts = NDArray[np.int16]


class Bus(Protocol):
    """An I2C bus: whole transactions only. Every failure is an OSError with its errno."""

    def read(self, address: int, register: int, count: int) -> bytes:
        """Write the register's address and read `count` bytes after a repeated start."""

    def write(self, address: int, register: int, data: bytes) -> None:
        """Write `data` from the register on, in one transaction."""

    def close(self) -> None:
        """Let go of the bus."""


@dataclass(frozen=True)
class Register:
    """One byte of a register map. ``bank`` is None where it is seen from every bank."""

    name: str
    address: int
    bank: int | None = None

    def field(self, high: int, low: int | None = None) -> Field:
        """Return bits ``high:low`` of it (or the one bit `high`)."""
        return Field(self, high, high if low is None else low)


@dataclass(frozen=True)
class Field:
    """Bits ``high`` to ``low`` (both included) of a register."""

    register: Register
    high: int
    low: int

    @property
    def width(self) -> int:
        """Number of bits."""
        return self.high - self.low + 1

    @property
    def mask(self) -> int:
        """The bits of the register that belong to it."""
        return ((1 << self.width) - 1) << self.low

    def get(self, byte: int) -> int:
        """Return its value in a register's `byte`."""
        return (byte & self.mask) >> self.low

    def put(self, byte: int, value: int) -> int:
        """Return `byte` with the field set to `value` and every other bit kept."""
        if not 0 <= value < 1 << self.width:
            raise ValueError(f"`value` {value} does not fit {self.width} bits of {self.register}")
        return (byte & ~self.mask) | (value << self.low)


@dataclass(frozen=True)
class Sensitivity:
    """A full-scale setting: its code, its range, and its counts per g or per degree/s."""

    code: int
    full_scale: float
    counts: float


def sensitivities(*rows: tuple[int, float, float]) -> tuple[Sensitivity, ...]:
    """Return a full-scale table from rows of (code, full scale, counts per unit)."""
    return tuple(Sensitivity(*row) for row in rows)


@dataclass(frozen=True)
class BiasField:
    """A user register that the chip adds to (or subtracts from) its output.

    The value is a two's complement number spread over ``fields``, most significant first; bits of
    those registers outside the fields are reserved and must be kept. ``weight`` is its LSB in g or
    degree/s, ``sign`` is +1 where the chip adds the value and -1 where it subtracts it, and
    ``enable`` are the bits that must be so for it to act.
    """

    parameter: str
    fields: tuple[Field, ...]
    weight: float
    sign: int = 1
    enable: tuple[tuple[Field, int], ...] = ()

    @property
    def width(self) -> int:
        """Number of bits of the value."""
        return sum(field.width for field in self.fields)

    @property
    def unit(self) -> float:
        """SI value of one count: m/s² or rad/s."""
        accel = self.parameter.startswith("accel")
        return self.weight * (STANDARD_GRAVITY if accel else math.pi / 180)

    def decode(self, values: Mapping[Register, int]) -> int:
        """Return the signed value from its registers' bytes."""
        raw = 0
        for field in self.fields:
            raw = (raw << field.width) | field.get(values[field.register])
        return raw - (1 << self.width) if raw >> (self.width - 1) else raw

    def encode(self, value: int, values: Mapping[Register, int]) -> dict[Register, int]:
        """Return the registers' bytes for a value, their reserved bits as in `values`."""
        if not self.minimum <= value <= self.maximum:
            raise ValueError(f"`value` {value} is outside {self.minimum} to {self.maximum}")
        raw = value & ((1 << self.width) - 1)
        out = dict(values)
        for field in reversed(self.fields):
            out[field.register] = field.put(out[field.register], raw & ((1 << field.width) - 1))
            raw >>= field.width
        return {field.register: out[field.register] for field in self.fields}

    def acts(self, values: Mapping[Register, int]) -> bool:
        """Whether it is switched on."""
        return all(field.get(values[field.register]) == value for field, value in self.enable)

    def shift(self, values: Mapping[Register, int]) -> float:
        """Return what it adds to the output, m/s² or rad/s."""
        return self.sign * self.decode(values) * self.unit if self.acts(values) else 0.0

    @property
    def registers(self) -> tuple[Register, ...]:
        """Every register that it is spread over or switched on in."""
        return tuple(f.register for f in self.fields) + tuple(f.register for f, _ in self.enable)

    @property
    def minimum(self) -> int:
        """Least value it holds; one above the two's complement limit, which some chips reserve."""
        return 1 - (1 << (self.width - 1))

    @property
    def maximum(self) -> int:
        """Greatest value it holds."""
        return (1 << (self.width - 1)) - 1


BiasSet = tuple[BiasField, ...]
"""The user bias registers of a chip, one field a parameter, all of one weight and switching."""


class Device:
    """One chip on a bus: reads and writes registers, selecting banks as needed."""

    def __init__(
        self,
        bus: Bus,
        address: int,
        *,
        bank_select: Field | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.bus = bus
        self.address = address
        self.sleep = sleep
        self._bank_select = bank_select
        self._bank: int | None = None

    def read(self, register: Register, count: int = 1) -> bytes:
        """Read `count` bytes from a register on, in one transaction."""
        self._select(register)
        return self.bus.read(self.address, register.address, count)

    def write(self, register: Register, *values: int) -> None:
        """Write bytes from a register on, in one transaction."""
        self._select(register)
        self.bus.write(self.address, register.address, bytes(values))

    def get(self, field: Field) -> int:
        """Read one field."""
        return field.get(self.read(field.register)[0])

    def set(self, field: Field, value: int) -> None:
        """Change one field and keep the register's other bits."""
        self.write(field.register, field.put(self.read(field.register)[0], value))

    def wait(self, field: Field, value: int, *, timeout: float, what: str) -> None:
        """Poll a field until it has a value.

        Raises
        ------
        DriverTimeoutError
            If it does not within `timeout` seconds.
        """
        step = 0.001
        for _ in range(max(1, round(timeout / step))):
            if self.get(field) == value:
                return
            self.sleep(step)
        raise DriverTimeoutError(
            f"{what}: {field.register.name} (0x{field.register.address:02X}) did not become "
            f"{value} in {timeout:g} s; power the chip off and on, and check the wiring"
        )

    def forget_bank(self) -> None:
        """Take no bank for granted: after a reset, or when somebody else used the chip."""
        self._bank = None

    def _select(self, register: Register) -> None:
        if self._bank_select is None or register.bank in (None, self._bank):
            return
        assert register.bank is not None
        select = self._bank_select
        value = select.put(0, register.bank)
        self.bus.write(self.address, select.register.address, bytes([value]))
        self._bank = register.bank


@dataclass(frozen=True)
class Setup:
    """How a chip is to run: full scales in g and degree/s, rate in Hz, low-pass in Hz (or None).

    ``firmware`` is what a BMI270 needs uploaded; its maker's file, which the user supplies.
    """

    accel_range: float
    gyro_range: float
    rate: float
    bandwidth: float | None = None
    firmware: bytes | None = None


@dataclass(frozen=True)
class Samples:
    """Raw samples of one read: counts, °C, and what went wrong on the way.

    ``lost`` is the number that the chip itself says it dropped before the first of them;
    ``overflow`` says that samples were dropped and their number is not known.
    """

    accel: Counts
    gyro: Counts
    temperature: NDArray[np.float64] | None
    lost: int = 0
    overflow: bool = False
    ticks: NDArray[np.float64] | None = None
    """s on the chip's own clock, from 0 to the chip's `clock_period`, where its FIFO tells them."""

    def __len__(self) -> int:
        return len(self.accel)


NO_SAMPLES = Samples(np.empty((0, 3), np.int16), np.empty((0, 3), np.int16), None)


class Chip(ABC):
    """A family of chips that share a register map.

    The class attributes are the datasheet's tables. ``frame`` is one burst of the data registers
    as a numpy dtype with fields ``accel``, ``gyro`` and, where it is among them, ``temperature``.
    """

    name: ClassVar[str]
    models: ClassVar[Mapping[int, str]]
    """Identity register's value -> the part it stands for; the first is the family's own."""
    aliases: ClassVar[tuple[str, ...]] = ()
    """Other parts that answer with the first one's identity: they cannot be told apart."""
    source: ClassVar[str]
    """The document that the table was taken from."""
    identity: ClassVar[Register]
    addresses: ClassVar[tuple[int, ...]] = (0x68, 0x69)
    bank_select: ClassVar[Field | None] = None
    accel_ranges: ClassVar[tuple[Sensitivity, ...]]
    gyro_ranges: ClassVar[tuple[Sensitivity, ...]]
    default_ranges: ClassVar[tuple[float, float]] = (4.0, 500.0)
    default_rate: ClassVar[float] = 100.0
    bandwidths: ClassVar[tuple[float, ...]] = ()
    """What ``filter=`` may be, Hz; empty where the low-pass follows the rate."""
    data: ClassVar[Register]
    frame: ClassVar[np.dtype[Any]]
    fifo_size: ClassVar[int]
    """Bytes that the FIFO holds; 0 if the chip has none that we use."""
    fifo_frame: ClassVar[int]
    """Bytes of one sample in the FIFO."""
    biases: ClassVar[tuple[BiasSet, ...]] = ()
    """Sets of bias registers; several where the chip offers several weights, the finest first."""
    clock_period: ClassVar[float] = 0.0
    """When the clock in the FIFO wraps around, s; 0 where there is none."""
    start_up: ClassVar[float] = 0.1
    """Seconds from power-on to valid data."""

    @abstractmethod
    def rates(self) -> Sequence[float]:
        """Return the rates that it can run at, Hz."""

    @abstractmethod
    def reset(self, device: Device) -> None:
        """Bring it to its power-on state, and wait until it answers again."""

    @abstractmethod
    def configure(self, device: Device, setup: Setup) -> None:
        """Wake it and set ranges, rate and filter; `setup` has passed `check`."""

    @abstractmethod
    def start_fifo(self, device: Device) -> None:
        """Empty the FIFO, clear a stale overflow, and let it run."""

    @abstractmethod
    def read_fifo(self, device: Device) -> Samples:
        """Read every whole sample that waits, in one burst."""

    @abstractmethod
    def ready(self, device: Device) -> bool:
        """Whether the data registers hold a sample that was not read yet."""

    @abstractmethod
    def celsius(self, counts: NDArray[np.int16]) -> NDArray[np.float64]:
        """Return the temperature from the data registers' counts."""

    def sample(self, device: Device) -> Samples:
        """Read the latest sample from the data registers in one burst."""
        return self.decode(device.read(self.data, self.frame.itemsize))

    def decode(self, data: bytes) -> Samples:
        """Take bursts of the data registers apart."""
        rows = np.frombuffer(data, self.frame)
        measured = "temperature" in (self.frame.names or ())
        temperature = self.celsius(rows["temperature"]) if measured else None
        return Samples(rows["accel"].astype(np.int16), rows["gyro"].astype(np.int16), temperature)

    def sleep(self, device: Device) -> None:  # noqa: B027 - most chips need nothing
        """Stop measuring, where the chip can; called when the driver closes."""

    def accel_sensitivity(self, full_scale: float) -> Sensitivity:
        """Return a row of the accelerometer's table; ValueError names them all if there is none."""
        return _row(self.accel_ranges, full_scale, "g", self.name)

    def gyro_sensitivity(self, full_scale: float) -> Sensitivity:
        """Return a row of the gyroscope's table; ValueError names them all if there is none."""
        return _row(self.gyro_ranges, full_scale, "°/s", self.name)

    def nearest_rate(self, rate: float) -> float:
        """Return the rate that the chip has for a wish, at most 5 % away.

        Raises
        ------
        ValueError
            If it has none so near; the message names the next below and above.
        """
        rates = sorted(self.rates())
        best = min(rates, key=lambda r: abs(r - rate))
        if abs(best - rate) <= 0.05 * rate:
            return best
        near = [r for r in rates if r < rate][-1:] + [r for r in rates if r > rate][:1]
        names = " or ".join(f"{r:.6g}" for r in near)
        raise ValueError(f"`rate` {rate:g} Hz is not one of {self.name}'s; the nearest: {names} Hz")

    def check(self, setup: Setup) -> None:
        """Refuse a range, rate or filter that the chip does not have (ValueError)."""
        self.accel_sensitivity(setup.accel_range)
        self.gyro_sensitivity(setup.gyro_range)
        self.nearest_rate(setup.rate)
        if setup.bandwidth is not None and not self.bandwidths:
            raise ValueError(f"`filter` cannot be set: {self.name}'s low-pass follows its rate")
        if setup.bandwidth is not None and setup.bandwidth not in self.bandwidths:
            names = ", ".join(f"{b:g}" for b in self.bandwidths)
            raise ValueError(
                f"`filter` {setup.bandwidth:g} Hz is not one of {self.name}'s: {names}"
            )


def _row(table: tuple[Sensitivity, ...], full_scale: float, unit: str, chip: str) -> Sensitivity:
    for row in table:
        if math.isclose(row.full_scale, full_scale, rel_tol=1e-3):
            return row
    names = ", ".join(f"{row.full_scale:g}" for row in table)
    raise ValueError(f"`range` ±{full_scale:g} {unit} is not one of {chip}'s: {names} {unit}")
