"""ST LSM6DS3 and LSM6DS3TR-C: a FIFO of 16-bit words, gyroscope first.

Source: ST "LSM6DS3" datasheet DocID026899, chapters 8 and 9 (registers by address), and
"LSM6DS3TR-C" DocID030071. The TR-C has half the FIFO (4096 bytes); no more is relied on. Neither
is known to us to have user bias registers that act on the output: none are flashed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.chips.base import Chip, Device, Register, Samples, Setup, sensitivities

FIFO_CTRL3 = Register("FIFO_CTRL3", 0x08)
FIFO_CTRL5 = Register("FIFO_CTRL5", 0x0A)
WHO_AM_I = Register("WHO_AM_I", 0x0F)
CTRL1_XL = Register("CTRL1_XL", 0x10)
CTRL2_G = Register("CTRL2_G", 0x11)
CTRL3_C = Register("CTRL3_C", 0x12)
STATUS_REG = Register("STATUS_REG", 0x1E)
OUT_TEMP_L = Register("OUT_TEMP_L", 0x20)
FIFO_STATUS1 = Register("FIFO_STATUS1", 0x3A)
FIFO_STATUS2 = Register("FIFO_STATUS2", 0x3B)
FIFO_STATUS3 = Register("FIFO_STATUS3", 0x3C)
FIFO_DATA_OUT_L = Register("FIFO_DATA_OUT_L", 0x3E)

ODR_XL = CTRL1_XL.field(7, 4)
FS_XL = CTRL1_XL.field(3, 2)
ODR_G = CTRL2_G.field(7, 4)
FS_G = CTRL2_G.field(3, 1)  # with FS_125 as the lowest bit
SW_RESET = CTRL3_C.field(0)
FIFO_ODR = FIFO_CTRL5.field(6, 3)
FIFO_MODE = FIFO_CTRL5.field(2, 0)
FIFO_OVERRUN = FIFO_STATUS2.field(6)
GYRO_READY = STATUS_REG.field(1)
ACCEL_READY = STATUS_REG.field(0)

BDU_IF_INC = 0x44  # CTRL3_C: no torn words, addresses advance in a burst
CONTINUOUS = 6
NO_DECIMATION = 0x09  # FIFO_CTRL3: every gyroscope and accelerometer sample
ACCEL_RANGES = sensitivities(
    (0, 2, 1000 / 0.061), (2, 4, 1000 / 0.122), (3, 8, 1000 / 0.244), (1, 16, 1000 / 0.488)
)
GYRO_RANGES = sensitivities(
    (1, 125, 1000 / 4.375),
    (0, 250, 1000 / 8.75),
    (2, 500, 1000 / 17.5),
    (4, 1000, 1000 / 35),
    (6, 2000, 1000 / 70),
)
RATES = {12.5: 1, 26.0: 2, 52.0: 3, 104.0: 4, 208.0: 5, 416.0: 6, 833.0: 7, 1666.0: 8}
FRAME = np.dtype([("temperature", "<i2"), ("gyro", "<i2", 3), ("accel", "<i2", 3)])
SET = np.dtype([("gyro", "<i2", 3), ("accel", "<i2", 3)])


class Lsm6ds3(Chip):
    """Temperature, gyroscope and accelerometer in one burst of 14 bytes."""

    name = "lsm6ds3"
    models: ClassVar = {0x69: "LSM6DS3", 0x6A: "LSM6DS3TR-C"}
    source = "DocID026899, DocID030071"
    identity = WHO_AM_I
    addresses = (0x6A, 0x6B)
    accel_ranges = ACCEL_RANGES
    gyro_ranges = GYRO_RANGES
    default_rate = 104.0
    data = OUT_TEMP_L
    frame = FRAME
    fifo_size = 4096
    fifo_frame = SET.itemsize
    counts_per_celsius: ClassVar[float] = 16.0
    rate_codes: ClassVar = RATES

    def rates(self) -> Sequence[float]:
        return list(self.rate_codes)

    def reset(self, device: Device) -> None:
        device.write(CTRL3_C, SW_RESET.mask)
        device.sleep(self.start_up)
        device.wait(SW_RESET, 0, timeout=0.5, what=f"resetting {self.name}")

    def configure(self, device: Device, setup: Setup) -> None:
        code = self.rate_codes[self.nearest_rate(setup.rate)]
        device.write(CTRL3_C, BDU_IF_INC)
        accel = FS_XL.put(0, self.accel_sensitivity(setup.accel_range).code)
        gyro = FS_G.put(0, self.gyro_sensitivity(setup.gyro_range).code)
        device.write(CTRL1_XL, ODR_XL.put(accel, code), ODR_G.put(gyro, code))

    def start_fifo(self, device: Device) -> None:
        code = ODR_G.get(device.read(CTRL2_G)[0])
        device.write(FIFO_CTRL5, 0)  # bypass empties it
        device.write(FIFO_CTRL3, NO_DECIMATION)
        device.write(FIFO_CTRL5, FIFO_MODE.put(FIFO_ODR.put(0, code), CONTINUOUS))

    def read_fifo(self, device: Device) -> Samples:
        low, high, pattern_low, pattern_high = device.read(FIFO_STATUS1, 4)
        words = (high & 0x0F) << 8 | low
        pattern = (pattern_high & 0x03) << 8 | pattern_low
        whole = words // 6
        # The pattern says which word comes next: 0 is the gyroscope's x, where a set begins.
        overflow = bool(FIFO_OVERRUN.get(high)) or (words > 0 and pattern % 6 != 0)
        count = 0 if overflow else whole * SET.itemsize
        rows = np.frombuffer(device.read(FIFO_DATA_OUT_L, count) if count else b"", SET)
        return Samples(
            rows["accel"].astype(np.int16),
            rows["gyro"].astype(np.int16),
            self.temperature(device, len(rows)),
            overflow=overflow,
        )

    def temperature(self, device: Device, count: int) -> NDArray[np.float64]:
        """Return the temperature of now for `count` samples: the FIFO does not hold it."""
        if not count:
            return np.empty(0)
        raw = np.frombuffer(device.read(OUT_TEMP_L, 2), "<i2").astype(np.int16)
        return np.repeat(self.celsius(raw), count)

    def ready(self, device: Device) -> bool:
        status = device.read(STATUS_REG)[0]
        return bool(GYRO_READY.get(status) and ACCEL_READY.get(status))

    def celsius(self, counts: NDArray[np.int16]) -> NDArray[np.float64]:
        return counts.astype(np.float64) / self.counts_per_celsius + 25

    def sleep(self, device: Device) -> None:
        device.write(CTRL1_XL, 0, 0)


CHIP = Lsm6ds3()
