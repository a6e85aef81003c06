"""MPU-6500, MPU-9250 and MPU-9255 (and, derived from it, the MPU-6050) from the bus's side."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from calib.types import FloatArray
from drivers.chips import mpu6500 as r
from drivers.chips.base import Register
from drivers.emulators.chips.base import ChipModel


class Mpu6500Model(ChipModel):
    """Wakes asleep or awake as the part does; the FIFO takes what FIFO_EN says."""

    chip_name: ClassVar[str] = "mpu6500"
    trim_range: ClassVar[int] = 3000

    def defaults(self) -> dict[Register, int]:
        return {r.PWR_MGMT_1: 0x01}

    def rate(self) -> float:
        if self.peek(r.SLEEP):
            return 0.0
        # The FIFO and the data registers follow the gyroscope; its base rate is 8 kHz without
        # low-pass.
        base = 8000.0 if self.peek(r.DLPF_CFG) in (0, 7) else 1000.0
        return base / (1 + self.peek(r.SMPLRT_DIV))

    def ranges(self) -> tuple[int, int]:
        return self.peek(r.ACCEL_FS_SEL), self.peek(r.GYRO_FS_SEL)

    def temperature_counts(self, celsius: FloatArray) -> FloatArray:
        return (celsius - 21) * 333.87

    def fifo_runs(self) -> bool:
        return bool(self.peek(r.FIFO_ENABLE) and self.peek(r.FIFO_EN) & r.FIFO_ALL)

    def fifo_bytes(self, rows: NDArray[Any]) -> tuple[bytes, int]:
        enable = self.peek(r.FIFO_EN)
        words = rows.view(">i2").reshape(-1, 7)
        # In the order of the data registers: accelerometer, temperature, gyroscope x, y, z.
        columns = [enable & 0x08] * 3 + [enable & bit for bit in (0x80, 0x40, 0x20, 0x10)]
        taken = words[:, np.flatnonzero(columns)]
        return taken.tobytes(), 2 * taken.shape[1]

    def fifo_overflowed(self) -> None:
        if self.peek(r.FIFO_ENABLE):
            self.poke(r.FIFO_OVERFLOW, 1)

    def new_sample(self) -> None:
        self.poke(r.DATA_READY, 1)

    def on_write(self, address: int, value: int) -> int:
        if address == r.PWR_MGMT_1.address and value & r.DEVICE_RESET.mask:
            self.power_cycle()
            return self.peek(r.PWR_MGMT_1)
        if address == r.USER_CTRL.address and value & r.FIFO_RESET.mask:
            self.fifo.clear()
            return r.FIFO_RESET.put(value, 0)
        return value

    def on_read(self, address: int, value: int) -> int:
        if address == r.INT_STATUS.address:
            self.poke(r.INT_STATUS, 0)
        elif address == r.FIFO_COUNTH.address:
            return len(self.fifo) >> 8
        elif address == r.FIFO_COUNTH.address + 1:
            return len(self.fifo) & 0xFF
        return value

    def _read_port(self, address: int, count: int) -> bytes | None:
        if address != r.FIFO_R_W.address:
            return None
        out = bytes(self.fifo[:count])
        del self.fifo[:count]
        return out.ljust(count, b"\xff")


MODEL = Mpu6500Model
