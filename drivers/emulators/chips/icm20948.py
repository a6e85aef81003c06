"""ICM-20948 from the bus's side."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from calib.types import FloatArray
from drivers.chips import icm20948 as r
from drivers.chips.base import Register
from drivers.emulators.chips.base import ChipModel


class Icm20948Model(ChipModel):
    """Bank 0 holds data and FIFO, bank 2 ranges and rates, banks 1 and 2 the bias registers."""

    chip_name: ClassVar[str] = "icm20948"
    trim_range: ClassVar[int] = 3000

    def defaults(self) -> dict[Register, int]:
        return {r.PWR_MGMT_1: 0x41, r.GYRO_CONFIG_1: 1, r.ACCEL_CONFIG: 1}

    def rate(self) -> float:
        if self.peek(r.SLEEP):
            return 0.0
        return 1125.0 / (1 + self.peek(r.GYRO_SMPLRT_DIV))

    def ranges(self) -> tuple[int, int]:
        return self.peek(r.ACCEL_FS_SEL), self.peek(r.GYRO_FS_SEL)

    def temperature_counts(self, celsius: FloatArray) -> FloatArray:
        return (celsius - 21) * 333.87 + 21

    def fifo_runs(self) -> bool:
        return bool(self.peek(r.FIFO_ENABLE) and self.peek(r.FIFO_EN_2) & r.FIFO_ALL)

    def fifo_bytes(self, rows: NDArray[Any]) -> tuple[bytes, int]:
        enable = self.peek(r.FIFO_EN_2)
        words = rows.view(">i2").reshape(-1, 7)
        # In the order of the data registers: accelerometer, gyroscope x, y, z, temperature.
        columns = [enable & 0x10] * 3 + [enable & bit for bit in (0x02, 0x04, 0x08, 0x01)]
        taken = words[:, np.flatnonzero(columns)]
        return taken.tobytes(), 2 * taken.shape[1]

    def fifo_overflowed(self) -> None:
        if self.peek(r.FIFO_ENABLE):
            self.poke(r.FIFO_OVERFLOW, 1)

    def new_sample(self) -> None:
        self.poke(r.DATA_READY, 1)

    def on_write(self, address: int, value: int) -> int:
        if self.bank == 0:
            if address == r.PWR_MGMT_1.address and value & r.DEVICE_RESET.mask:
                self.power_cycle()
                return self.peek(r.PWR_MGMT_1)
            if address == r.FIFO_RST.address and value & 0x1F:
                self.fifo.clear()
        return value

    def on_read(self, address: int, value: int) -> int:
        if self.bank == 0:
            if address == r.INT_STATUS_1.address:
                self.poke(r.INT_STATUS_1, 0)
            elif address == r.INT_STATUS_2.address:
                self.poke(r.INT_STATUS_2, 0)
            elif address == r.FIFO_COUNTH.address:
                return len(self.fifo) >> 8
            elif address == r.FIFO_COUNTH.address + 1:
                return len(self.fifo) & 0xFF
        return value

    def _read_port(self, address: int, count: int) -> bytes | None:
        if self.bank != 0 or address != r.FIFO_R_W.address:
            return None
        out = bytes(self.fifo[:count])
        del self.fifo[:count]
        return out.ljust(count, b"\xff")


MODEL = Icm20948Model
