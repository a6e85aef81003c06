"""BMI160 from the bus's side."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from calib.types import FloatArray
from drivers.chips import bmi160 as r
from drivers.chips import bosch
from drivers.chips.base import Register
from drivers.emulators.chips.base import ChipModel


class Bmi160Model(ChipModel):
    """Sleeps until commanded; its FIFO drops whole frames and says how many in a skip frame."""

    chip_name: ClassVar[str] = "bmi160"
    fifo_config: ClassVar[Register] = r.FIFO_CONFIG_1
    fifo_length: ClassVar[Register] = r.FIFO_LENGTH_0
    fifo_port: ClassVar[Register] = r.FIFO_DATA
    status: ClassVar[Register] = r.STATUS
    rate_register: ClassVar[Register] = r.GYR_CONF
    _skipped = 0

    def defaults(self) -> dict[Register, int]:
        return {
            r.ACC_CONF: 0x28,
            r.ACC_RANGE: 0x03,
            r.GYR_CONF: 0x28,
            r.FIFO_DOWNS: 0x88,
            r.FIFO_CONFIG_1: 0x10,
        }

    def runs(self) -> bool:
        """Whether both triads measure."""
        return self.peek(r.ACCEL_STATUS) == self.peek(r.GYRO_STATUS) == r.NORMAL

    def rate(self) -> float:
        code = self.peek(self.rate_register) & 0x0F
        rate = next((rate for rate, value in bosch.RATES.items() if value == code), 0.0)
        return rate if self.runs() else 0.0

    def ranges(self) -> tuple[int, int]:
        return self.peek(r.ACC_RANGE) & 0x0F, self.peek(r.GYR_RANGE) & 0x07

    def temperature_counts(self, celsius: FloatArray) -> FloatArray:
        return (celsius - 23) * 512

    def fifo_runs(self) -> bool:
        return self.peek(self.fifo_config) & bosch.FIFO_ALL == bosch.FIFO_ALL

    def fifo_bytes(self, rows: NDArray[Any]) -> tuple[bytes, int]:
        frames = np.zeros(len(rows), bosch.FRAME)
        frames["head"] = bosch.HEAD_BOTH
        frames["gyro"], frames["accel"] = rows["gyro"], rows["accel"]
        return frames.tobytes(), bosch.FRAME.itemsize

    def drop_oldest(self, excess: int, size: int) -> None:
        frames = -(-excess // size)
        super().drop_oldest(frames * size, size)
        self._skipped += frames

    def fifo_overflowed(self) -> None:
        self._skipped = max(self._skipped, 1)

    def new_sample(self) -> None:
        self.poke(self.status, self.peek(self.status) | 0xC0)

    def command(self, value: int) -> None:
        """Carry out what is written to CMD."""
        if value == bosch.SOFT_RESET:
            self.power_cycle()
        elif value == bosch.FIFO_FLUSH:
            self.fifo.clear()
            self._skipped = 0
        elif value in (r.ACCEL_NORMAL, r.ACCEL_SUSPEND):
            self.poke(r.ACCEL_STATUS, value & 3)
        elif value in (r.GYRO_NORMAL, r.GYRO_SUSPEND):
            self.poke(r.GYRO_STATUS, value & 3)

    def on_write(self, address: int, value: int) -> int:
        if address == r.CMD.address:
            self.command(value)
            return 0
        return value

    def on_read(self, address: int, value: int) -> int:
        if address == self.fifo_length.address:
            return len(self.fifo) & 0xFF
        if address == self.fifo_length.address + 1:
            return len(self.fifo) >> 8
        if self.chip.data.address <= address < self.chip.data.address + 12:
            self.poke(self.status, self.peek(self.status) & ~0xC0)
        return value

    def _read_port(self, address: int, count: int) -> bytes | None:
        if address != self.fifo_port.address:
            return None
        out = b""
        if self._skipped:
            out = bytes([bosch.HEAD_SKIP, min(self._skipped, bosch.MOST_SKIPPED)])
            self._skipped = 0
        size = bosch.FRAME.itemsize
        whole = (count - len(out)) // size * size
        given = len(self.fifo[:whole])
        out += bytes(self.fifo[: count - len(out)])
        del self.fifo[:given]  # a frame that was read in part is given again
        return out.ljust(count, bytes([bosch.HEAD_EMPTY]))


MODEL = Bmi160Model
