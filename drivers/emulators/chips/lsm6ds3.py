"""LSM6DS3 and LSM6DS3TR-C from the bus's side."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import NDArray

from calib.types import FloatArray
from drivers.chips import lsm6ds3 as r
from drivers.chips.base import Register
from drivers.emulators.chips.base import ChipModel


class Lsm6ds3Model(ChipModel):
    """The FIFO port's two addresses roll over in a burst, and each read says what comes next."""

    chip_name: ClassVar[str] = "lsm6ds3"
    _overrun = False

    @property
    def family(self) -> r.Lsm6ds3:
        """The chip's tables."""
        assert isinstance(self.chip, r.Lsm6ds3)
        return self.chip

    def defaults(self) -> dict[Register, int]:
        return {r.CTRL3_C: 0x04}

    def rate(self) -> float:
        codes = self.family.rate_codes
        code = self.peek(r.ODR_G)
        if code != self.peek(r.ODR_XL):
            return 0.0  # only one of the triads runs: our drivers never do that
        return next((rate for rate, value in codes.items() if value == code), 0.0)

    def ranges(self) -> tuple[int, int]:
        return self.peek(r.FS_XL), self.peek(r.FS_G)

    def temperature_counts(self, celsius: FloatArray) -> FloatArray:
        return (celsius - 25) * self.family.counts_per_celsius

    def fifo_runs(self) -> bool:
        return self.peek(r.FIFO_MODE) == r.CONTINUOUS

    def fifo_bytes(self, rows: NDArray[Any]) -> tuple[bytes, int]:
        return rows[["gyro", "accel"]].astype(r.SET).tobytes(), r.SET.itemsize

    def drop_oldest(self, excess: int, size: int) -> None:
        super().drop_oldest(-(-excess // size) * size, size)

    def fifo_overflowed(self) -> None:
        self._overrun = True

    def new_sample(self) -> None:
        self.poke(r.GYRO_READY, 1)
        self.poke(r.ACCEL_READY, 1)

    def on_write(self, address: int, value: int) -> int:
        if address == r.CTRL3_C.address and value & r.SW_RESET.mask:
            self.power_cycle()
            return self.peek(r.CTRL3_C)
        if address == r.FIFO_CTRL5.address and not r.FIFO_MODE.get(value):
            self.fifo.clear()
            self._overrun = False
        return value

    def on_read(self, address: int, value: int) -> int:
        words = len(self.fifo) // 2
        if address == r.FIFO_STATUS1.address:
            return words & 0xFF
        if address == r.FIFO_STATUS2.address:
            empty = 0 if words else 0x10
            return r.FIFO_OVERRUN.put(empty | (words >> 8) & 0x0F, int(self._overrun))
        if address == r.FIFO_STATUS3.address:
            return -words % 6  # sets enter whole, so what is left of one says where we are
        if r.OUT_TEMP_L.address + 2 <= address < r.OUT_TEMP_L.address + 14:
            self.poke(r.STATUS_REG, 0)
        return value

    def _read_port(self, address: int, count: int) -> bytes | None:
        if address != r.FIFO_DATA_OUT_L.address:
            return None
        out = bytes(self.fifo[:count])
        del self.fifo[:count]
        self._overrun = False
        return out.ljust(count, b"\0")


MODEL = Lsm6ds3Model
