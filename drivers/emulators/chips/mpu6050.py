"""MPU-6050 from the bus's side: it wakes asleep, and tells the temperature in its own way."""

from __future__ import annotations

from typing import ClassVar

from calib.types import FloatArray
from drivers.chips import mpu6500 as r
from drivers.chips.base import Register
from drivers.emulators.chips.mpu6500 import Mpu6500Model


class Mpu6050Model(Mpu6500Model):
    """1024 bytes of FIFO, which overwrites its oldest bytes when full."""

    chip_name: ClassVar[str] = "mpu6050"

    def defaults(self) -> dict[Register, int]:
        return {r.PWR_MGMT_1: 0x40}

    def temperature_counts(self, celsius: FloatArray) -> FloatArray:
        return (celsius - 36.53) * 340


MODEL = Mpu6050Model
