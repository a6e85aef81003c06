"""InvenSense ICM-20948: four banks of registers, the MPU-6500's bias registers in other places.

Source: InvenSense "ICM-20948" datasheet DS-000189, chapters 7 to 11 (one per bank, registers by
address) and its 333.87 counts per °C about 21 °C. The weight of the gyroscope's bias registers,
1/32.8 °/s, is not in it: it is the MPU-6500's, and what WickedLukas/ICM20948 works with.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.chips.base import (
    Chip,
    Device,
    Register,
    Samples,
    Setup,
    sensitivities,
)
from drivers.chips.mpu6500 import accel_bias_fields, gyro_bias_fields

WHO_AM_I = Register("WHO_AM_I", 0x00, 0)
USER_CTRL = Register("USER_CTRL", 0x03, 0)
PWR_MGMT_1 = Register("PWR_MGMT_1", 0x06, 0)
PWR_MGMT_2 = Register("PWR_MGMT_2", 0x07, 0)
INT_STATUS_1 = Register("INT_STATUS_1", 0x1A, 0)
INT_STATUS_2 = Register("INT_STATUS_2", 0x1B, 0)
ACCEL_XOUT_H = Register("ACCEL_XOUT_H", 0x2D, 0)
FIFO_EN_2 = Register("FIFO_EN_2", 0x67, 0)
FIFO_RST = Register("FIFO_RST", 0x68, 0)
FIFO_COUNTH = Register("FIFO_COUNTH", 0x70, 0)
FIFO_R_W = Register("FIFO_R_W", 0x72, 0)
REG_BANK_SEL = Register("REG_BANK_SEL", 0x7F)

GYRO_SMPLRT_DIV = Register("GYRO_SMPLRT_DIV", 0x00, 2)
GYRO_CONFIG_1 = Register("GYRO_CONFIG_1", 0x01, 2)
ACCEL_SMPLRT_DIV_1 = Register("ACCEL_SMPLRT_DIV_1", 0x10, 2)
ACCEL_CONFIG = Register("ACCEL_CONFIG", 0x14, 2)

GYRO_FS_SEL = GYRO_CONFIG_1.field(2, 1)
GYRO_DLPF = GYRO_CONFIG_1.field(5, 3)
GYRO_FCHOICE = GYRO_CONFIG_1.field(0)
ACCEL_FS_SEL = ACCEL_CONFIG.field(2, 1)
ACCEL_DLPF = ACCEL_CONFIG.field(5, 3)
ACCEL_FCHOICE = ACCEL_CONFIG.field(0)
FIFO_ENABLE = USER_CTRL.field(6)
DEVICE_RESET = PWR_MGMT_1.field(7)
SLEEP = PWR_MGMT_1.field(6)
FIFO_OVERFLOW = INT_STATUS_2.field(4, 0)
DATA_READY = INT_STATUS_1.field(0)

CLOCK_AUTO = 0x01
FIFO_ALL = 0x1F  # FIFO_EN_2: accelerometer, gyroscope z, y, x, temperature


class Icm20948(Chip):
    """Accelerometer, gyroscope and temperature in one burst of 14 bytes; FIFO of 512 bytes."""

    name = "icm20948"
    models: ClassVar = {0xEA: "ICM-20948"}
    source = "DS-000189"
    identity = WHO_AM_I
    bank_select = REG_BANK_SEL.field(5, 4)
    accel_ranges = sensitivities((0, 2, 16384), (1, 4, 8192), (2, 8, 4096), (3, 16, 2048))
    gyro_ranges = sensitivities((0, 250, 131), (1, 500, 65.5), (2, 1000, 32.8), (3, 2000, 16.4))
    # 3 dB bandwidths of the accelerometer; the gyroscope's of the same code are close by.
    dlpf: ClassVar = {246.0: 1, 111.4: 2, 50.4: 3, 23.9: 4, 11.5: 5, 5.7: 6}
    bandwidths = tuple(dlpf)
    data = ACCEL_XOUT_H
    frame = np.dtype([("accel", ">i2", 3), ("gyro", ">i2", 3), ("temperature", ">i2")])
    fifo_size = 512
    fifo_frame = 14
    biases = (accel_bias_fields(0x14, 3, bank=1) + gyro_bias_fields(0x03, bank=2),)

    def rates(self) -> Sequence[float]:
        return [1125 / (1 + divider) for divider in range(256)]

    def reset(self, device: Device) -> None:
        device.write(PWR_MGMT_1, DEVICE_RESET.mask)
        device.forget_bank()
        device.sleep(self.start_up)
        device.wait(DEVICE_RESET, 0, timeout=0.5, what=f"resetting {self.name}")
        device.write(PWR_MGMT_1, CLOCK_AUTO)
        device.sleep(0.05)

    def configure(self, device: Device, setup: Setup) -> None:
        divider = round(1125 / self.nearest_rate(setup.rate)) - 1
        code = self.dlpf[setup.bandwidth or self.bandwidths[0]]
        device.write(PWR_MGMT_1, CLOCK_AUTO)
        device.write(PWR_MGMT_2, 0)  # all six axes on
        device.write(GYRO_SMPLRT_DIV, divider)
        gyro = GYRO_FS_SEL.put(0, self.gyro_sensitivity(setup.gyro_range).code)
        device.write(GYRO_CONFIG_1, GYRO_DLPF.put(GYRO_FCHOICE.put(gyro, 1), code))
        device.write(ACCEL_SMPLRT_DIV_1, 0, divider)
        accel = ACCEL_FS_SEL.put(0, self.accel_sensitivity(setup.accel_range).code)
        device.write(ACCEL_CONFIG, ACCEL_DLPF.put(ACCEL_FCHOICE.put(accel, 1), code))

    def start_fifo(self, device: Device) -> None:
        device.write(FIFO_EN_2, 0)
        device.write(FIFO_RST, 0x1F)
        device.write(FIFO_RST, 0)
        device.write(USER_CTRL, FIFO_ENABLE.mask)
        device.write(FIFO_EN_2, FIFO_ALL)
        device.read(INT_STATUS_2)  # the overflow bit is sticky: drop what it holds from before

    def read_fifo(self, device: Device) -> Samples:
        waiting = int.from_bytes(device.read(FIFO_COUNTH, 2), "big") & 0x1FFF
        whole = waiting - waiting % self.fifo_frame
        data = device.read(FIFO_R_W, whole) if whole else b""
        # As in the MPU-6500: what a full FIFO drops need not be a whole sample.
        overflow = bool(device.get(FIFO_OVERFLOW)) or waiting >= self.fifo_size
        samples = self.decode(b"" if overflow else data)
        return Samples(samples.accel, samples.gyro, samples.temperature, overflow=overflow)

    def ready(self, device: Device) -> bool:
        return bool(device.get(DATA_READY))

    def celsius(self, counts: NDArray[np.int16]) -> NDArray[np.float64]:
        return (counts.astype(np.float64) - 21) / 333.87 + 21

    def sleep(self, device: Device) -> None:
        device.write(PWR_MGMT_1, SLEEP.mask | CLOCK_AUTO)


CHIP = Icm20948()
