"""ICM-42688-P from the bus's side."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from calib.types import FloatArray
from drivers.chips import icm42688 as r
from drivers.chips.base import Register
from drivers.emulators.chips.base import ChipModel


class Icm42688Model(ChipModel):
    """A packet holds the low 16 bits of its time stamp, in steps of 1 or 16 µs."""

    chip_name: ClassVar[str] = "icm42688p"

    def defaults(self) -> dict[Register, int]:
        return {r.INTF_CONFIG0: 0x30, r.GYRO_CONFIG0: 0x06, r.ACCEL_CONFIG0: 0x06}

    def rate(self) -> float:
        if self.peek(r.PWR_MGMT0) & r.LOW_NOISE != r.LOW_NOISE:
            return 0.0
        code = self.peek(r.RATE_ACCEL)
        return next((rate for rate, value in r.RATES.items() if value == code), 0.0)

    def ranges(self) -> tuple[int, int]:
        return self.peek(r.FULL_SCALE_ACCEL), self.peek(r.FULL_SCALE_GYRO)

    def temperature_counts(self, celsius: FloatArray) -> FloatArray:
        return (celsius - 25) * 132.48

    def fifo_runs(self) -> bool:
        packets = self.peek(r.FIFO_CONFIG1) & r.FIFO_ALL == r.FIFO_ALL
        return packets and self.peek(r.FIFO_MODE) == r.STREAM

    def fifo_bytes(self, rows: NDArray[Any]) -> tuple[bytes, int]:
        packets = np.zeros(len(rows), r.PACKET)
        packets["header"] = 0x68
        packets["accel"], packets["gyro"] = rows["accel"], rows["gyro"]
        celsius = rows["temperature"] / 132.48
        packets["temperature"] = np.clip(np.rint(celsius * 2.07), -128, 127)
        tick = r.TICK if self.peek(r.TMST_CONFIG) & 0x08 else 1e-6
        # The last of these samples is number `_index` of the device's time.
        times = (self._index - len(rows) + 1 + np.arange(len(rows))) / self._rate
        packets["time"] = (times / tick).astype(np.int64) % 65536
        return packets.tobytes(), r.PACKET.itemsize

    def drop_oldest(self, excess: int, size: int) -> None:
        super().drop_oldest(-(-excess // size) * size, size)

    def fifo_overflowed(self) -> None:
        self.poke(r.FIFO_FULL, 1)

    def new_sample(self) -> None:
        self.poke(r.DATA_READY, 1)

    def on_write(self, address: int, value: int) -> int:
        if self.bank == 0:
            if address == r.DEVICE_CONFIG.address and value & r.SOFT_RESET.mask:
                self.power_cycle()
                return 0
            if address == r.SIGNAL_PATH_RESET.address and value & r.FIFO_FLUSH.mask:
                self.fifo.clear()
                return r.FIFO_FLUSH.put(value, 0)
        return value

    def on_read(self, address: int, value: int) -> int:
        if self.bank == 0:
            if address == r.INT_STATUS.address:
                self.poke(r.INT_STATUS, 0)
            elif address == r.FIFO_COUNTH.address:
                return len(self.fifo) >> 8
            elif address == r.FIFO_COUNTH.address + 1:
                return len(self.fifo) & 0xFF
        return value

    def _read_port(self, address: int, count: int) -> bytes | None:
        if self.bank != 0 or address != r.FIFO_DATA.address:
            return None
        out = bytes(self.fifo[:count])
        del self.fifo[:count]
        return out.ljust(count, b"\xff")


MODEL = Icm42688Model
