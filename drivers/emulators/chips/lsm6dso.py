"""LSM6DSO, LSM6DSOX and ISM330DHCX from the bus's side."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.chips import lsm6dso as r
from drivers.chips.lsm6ds3 import CONTINUOUS
from drivers.emulators.chips.lsm6ds3 import Lsm6ds3Model


class Lsm6dsoModel(Lsm6ds3Model):
    """Each time slot puts a gyroscope word and an accelerometer word into the FIFO."""

    chip_name: ClassVar[str] = "lsm6dso"
    _slot = 0
    _latched = False

    def fifo_runs(self) -> bool:
        return self.peek(r.FIFO_MODE) == CONTINUOUS and self.peek(r.FIFO_CTRL3) != 0

    def fifo_bytes(self, rows: NDArray[Any]) -> tuple[bytes, int]:
        words = np.zeros((len(rows), 2), r.WORD)
        slots = (self._slot + np.arange(len(rows))) & 3
        self._slot += len(rows)
        for column, tag, triad in ((0, r.TAG_GYRO, "gyro"), (1, r.TAG_ACCEL, "accel")):
            words["data"][:, column] = rows[triad]
            content = tag << 3 | slots << 1
            odd = sum((content >> bit) & 1 for bit in range(8)) & 1
            words["tag"][:, column] = content | odd
        return words.tobytes(), 2 * r.WORD.itemsize

    def fifo_overflowed(self) -> None:
        super().fifo_overflowed()
        self._latched = True

    def on_write(self, address: int, value: int) -> int:
        if address == r.FIFO_CTRL4.address:  # where the LSM6DS3 has its FIFO_CTRL5
            if not r.FIFO_MODE.get(value):
                self.fifo.clear()
                self._overrun = False
            return value
        return super().on_write(address, value)

    def on_read(self, address: int, value: int) -> int:
        words = len(self.fifo) // r.WORD.itemsize
        if address == r.FIFO_STATUS1.address:
            return words & 0xFF
        if address == r.FIFO_STATUS2.address:
            flags = r.OVERRUN.put(words >> 8, int(self._overrun))
            flags = r.OVERRUN_LATCHED.put(flags, int(self._latched))
            self._latched = False
            return flags
        return super().on_read(address, value)

    def _read_port(self, address: int, count: int) -> bytes | None:
        if address != r.FIFO_DATA_OUT_TAG.address:
            return None
        out = bytes(self.fifo[:count])
        del self.fifo[:count]
        self._overrun = False
        return out.ljust(count, b"\0")


MODEL = Lsm6dsoModel
