"""What an emulated chip is: registers, a FIFO and bias registers around a source of true signals.

A model is the chip seen from the bus. It makes its samples when somebody looks: on every
transaction it catches up with its clock, so that it needs no thread, may run on a simulated clock,
and drops samples exactly when a real FIFO would.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from calib.gravity import STANDARD_GRAVITY
from calib.types import FloatArray
from drivers.chips import get_chip
from drivers.chips.base import BiasField, Field, Register
from drivers.emulators.base import EmulatedSensor

MOST_AT_ONCE = 8192
"""Samples made in one go; after a longer pause the ones before them would be lost anyway."""


Source = Callable[[float], EmulatedSensor]
"""From a rate (Hz) to the sensing elements sampled at it: what they give, errors and noise
included, before any user register. Sample k is at k / rate on the device's own time."""


class ChipModel(ABC):
    """One chip on an emulated bus.

    Parameters
    ----------
    source : Source
        Its signals, on the device's own time, which starts at 0 when the model is made.
    part : str
        Which of the family's parts answers at the identity register ('' for the first).
    seed : int
        Of the factory trim.
    clock : callable
        Host time in s; the device's own clock follows it.
    """

    chip_name: ClassVar[str]
    trim_range: ClassVar[int] = 0
    """Factory trim in the bias registers: whole counts between plus and minus this."""

    def __init__(
        self,
        source: Source,
        *,
        part: str = "",
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.chip = get_chip(self.chip_name)
        self.part = part or next(iter(self.chip.models.values()))
        self.source = source
        self.dropped = 0
        self.bank = 0
        self.pointer = 0
        self.fifo = bytearray()
        self._clock = clock
        self._origin = clock()
        self._rate = 0.0
        self._index = 0
        self._unseen = False
        self._memory: dict[int, bytearray] = {}
        self._sensor: EmulatedSensor | None = None
        rng = np.random.default_rng([seed, 0x7213])
        self._trim_bytes = self._make_trim(rng)
        self.power_cycle()

    # ---- the bus's side ----

    def write(self, data: bytes) -> None:
        """Take one write transaction: a register's address, then bytes from there on."""
        self._catch_up(observed=False)
        if not data:
            return
        self.pointer = data[0]
        for value in data[1:]:
            self._write_byte(self.pointer, value)
            self.pointer = self._next(self.pointer)
        self._follow_rate()

    def read(self, count: int) -> bytes:
        """Answer one read transaction from the register that was addressed last."""
        self._catch_up(observed=True)
        port = self._read_port(self.pointer, count)
        if port is not None:
            return port
        out = bytearray()
        for _ in range(count):
            out.append(self._read_byte(self.pointer))
            self.pointer = self._next(self.pointer)
        return bytes(out)

    def power_cycle(self) -> None:
        """Lose everything volatile, as at power-on."""
        self._memory = {}
        self.bank = 0
        self.fifo.clear()
        for register, value in self.defaults().items():
            self.poke(register, value)
        for register, value in self._trim_bytes.items():
            self.poke(register, value)
        identity = next(k for k, part in self.chip.models.items() if part == self.part)
        self.poke(self.chip.identity, identity)
        self._follow_rate()

    # ---- what a model says about its chip ----

    def defaults(self) -> dict[Register, int]:
        """Return the registers that are not zero after a reset."""
        return {}

    @abstractmethod
    def rate(self) -> float:
        """Return the sample rate that the registers ask for, Hz; 0 while it sleeps."""

    @abstractmethod
    def ranges(self) -> tuple[int, int]:
        """Return the codes of the accelerometer's and the gyroscope's full scale."""

    @abstractmethod
    def temperature_counts(self, celsius: FloatArray) -> FloatArray:
        """Return what the temperature registers hold, before rounding."""

    @abstractmethod
    def fifo_runs(self) -> bool:
        """Whether samples go into the FIFO."""

    @abstractmethod
    def fifo_bytes(self, rows: NDArray[Any]) -> tuple[bytes, int]:
        """Return samples as the FIFO frames them, and the size of one."""

    def fifo_overflowed(self) -> None:  # noqa: B027 - some chips say nothing
        """Raise the chip's overflow flag."""

    def new_sample(self) -> None:  # noqa: B027 - some chips have no such bit in use
        """Raise the chip's data-ready flag."""

    def on_write(self, address: int, value: int) -> int:
        """Return what is stored when `value` is written; side effects happen here."""
        return value

    def on_read(self, address: int, value: int) -> int:
        """Return what is read where `value` is stored; side effects happen here."""
        return value

    def _read_port(self, address: int, count: int) -> bytes | None:
        """Answer a read that does not walk along the registers (a FIFO port), or None."""
        return None

    def _next(self, address: int) -> int:
        return (address + 1) & 0xFF

    # ---- memory ----

    def peek(self, item: Register | Field) -> int:
        """Return what a register or a field holds, without side effects."""
        if isinstance(item, Field):
            return item.get(self.peek(item.register))
        return self._page(item.bank)[item.address]

    def poke(self, item: Register | Field, value: int) -> None:
        """Set a register or a field, without side effects."""
        if isinstance(item, Field):
            self.poke(item.register, item.put(self.peek(item.register), value))
        else:
            self._page(item.bank)[item.address] = value

    def _page(self, bank: int | None) -> bytearray:
        return self._memory.setdefault(bank or 0, bytearray(256))

    def _write_byte(self, address: int, value: int) -> None:
        select = self.chip.bank_select
        if select is not None and address == select.register.address:
            self.bank = select.get(value)
            return
        if address == self.chip.identity.address and self.bank == (self.chip.identity.bank or 0):
            return
        self._page(self.bank)[address] = self.on_write(address, value) & 0xFF

    def _read_byte(self, address: int) -> int:
        select = self.chip.bank_select
        if select is not None and address == select.register.address:
            return select.put(0, self.bank)
        return self.on_read(address, self._page(self.bank)[address])

    # ---- samples ----

    def now(self) -> float:
        """Return the device's own time, s."""
        return self._clock() - self._origin

    def _catch_up(self, *, observed: bool) -> None:
        """Make the samples that are due; skip their making where nobody can see them."""
        index = int(self.now() * self._rate)
        first, self._index = self._index, index
        if not self.fifo_runs():
            self._unseen |= index > first
            if observed and self._unseen:
                self._unseen = False
                self._emit(index - 1, index)
            return
        if index <= first:
            return
        if index - first > MOST_AT_ONCE:
            self.dropped += index - first - MOST_AT_ONCE
            self.fifo_overflowed()
            first = index - MOST_AT_ONCE
        self._unseen = False
        self._emit(first, index)

    def _follow_rate(self) -> None:
        # Every write caught up at the old rate first; what follows is at the new one.
        rate = self.rate()
        if rate != self._rate:
            self._rate, self._index = rate, int(self.now() * rate)

    def _emit(self, first: int, last: int) -> None:
        rows = self._rows(first, last)
        data = self.chip.data
        page = self._page(data.bank)
        for name, (_, offset, *_) in (rows.dtype.fields or {}).items():
            value = rows[-1:][name].tobytes()  # other registers may lie between the words
            page[data.address + offset : data.address + offset + len(value)] = value
        self.new_sample()
        if not self.fifo_runs():
            return
        framed, size = self.fifo_bytes(rows)
        self.fifo += framed
        excess = len(self.fifo) - self.chip.fifo_size
        if excess > 0:
            self.drop_oldest(excess, size)
            self.fifo_overflowed()

    def drop_oldest(self, excess: int, size: int) -> None:
        """Make room in a full FIFO; this one drops bytes, whole sample or not."""
        self.dropped += -(-excess // size)
        del self.fifo[:excess]

    def _rows(self, first: int, last: int) -> NDArray[Any]:
        if self._sensor is None or self._sensor.rate != self._rate:
            self._sensor = self.source(self._rate)
        (accel, gyro), temperature = self._sensor.measure(first, last)
        accel_row, gyro_row = self._sensitivities()
        shift = self.bias_shift()
        accel = (accel + shift[:3]) * (accel_row / STANDARD_GRAVITY)
        gyro = (gyro + shift[3:]) * (gyro_row * 180 / np.pi)
        rows = np.zeros(last - first, self.chip.frame)
        rows["accel"] = _to_counts(accel)
        rows["gyro"] = _to_counts(gyro)
        if "temperature" in (rows.dtype.names or ()):
            rows["temperature"] = _to_counts(self.temperature_counts(temperature))
        return rows

    def _sensitivities(self) -> tuple[float, float]:
        accel, gyro = self.ranges()
        return (
            next(row.counts for row in self.chip.accel_ranges if row.code == accel),
            next(row.counts for row in self.chip.gyro_ranges if row.code == gyro),
        )

    # ---- bias registers ----

    def bias_shift(self) -> FloatArray:
        """Return what the user registers add to the output: accel xyz m/s², gyro xyz rad/s.

        The factory trim already belongs to what `source` gives, so only the change from it counts.
        """
        shift = np.zeros(6)
        for field in (field for biases in self.chip.biases for field in biases):
            values = {register: self.peek(register) for register in field.registers}
            trim = {register: self._trim_bytes.get(register, 0) for register in field.registers}
            shift[_channel(field)] += field.shift(values)
            if not field.enable:
                shift[_channel(field)] -= field.shift(trim)
        return shift

    def _make_trim(self, rng: np.random.Generator) -> dict[Register, int]:
        out: dict[Register, int] = {}
        for field in self.chip.biases[0] if self.chip.biases and self.trim_range else ():
            if field.parameter.startswith("accel"):
                # The reserved bits hold something too, which a careful writer keeps.
                blank = {f.register: int(rng.integers(256)) for f in field.fields}
                value = int(rng.integers(-self.trim_range, self.trim_range + 1))
                out |= field.encode(value, blank)
        return out


def _channel(field: BiasField) -> int:
    triad, _, axis = field.parameter.split(".")
    return "xyz".index(axis) + (3 if triad == "gyro" else 0)


def _to_counts(values: FloatArray) -> NDArray[np.int16]:
    return np.clip(np.rint(values), -32768, 32767).astype(np.int16)
