"""InvenSense MPU-6500, MPU-9250 and MPU-9255 (and, derived from it, the MPU-6050).

Source: InvenSense "MPU-6500 Register Map and Descriptions" RM-MPU-6500A-00 and "MPU-9250 Register
Map" RM-MPU-9250A-00, whose sections are titled by the register's number, so that an address here
is also the place there. Weights of the user bias registers: as stated for XA_OFFS (±16 g in 15
bits) and XG_OFFSET (±1000 °/s in 16 bits).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.chips.base import (
    BiasField,
    Chip,
    Device,
    Register,
    Samples,
    Setup,
    sensitivities,
)

SMPLRT_DIV = Register("SMPLRT_DIV", 0x19)
CONFIG = Register("CONFIG", 0x1A)
GYRO_CONFIG = Register("GYRO_CONFIG", 0x1B)
ACCEL_CONFIG = Register("ACCEL_CONFIG", 0x1C)
ACCEL_CONFIG_2 = Register("ACCEL_CONFIG_2", 0x1D)
FIFO_EN = Register("FIFO_EN", 0x23)
INT_STATUS = Register("INT_STATUS", 0x3A)
ACCEL_XOUT_H = Register("ACCEL_XOUT_H", 0x3B)
USER_CTRL = Register("USER_CTRL", 0x6A)
PWR_MGMT_1 = Register("PWR_MGMT_1", 0x6B)
FIFO_COUNTH = Register("FIFO_COUNTH", 0x72)
FIFO_R_W = Register("FIFO_R_W", 0x74)
WHO_AM_I = Register("WHO_AM_I", 0x75)

DLPF_CFG = CONFIG.field(2, 0)
GYRO_FS_SEL = GYRO_CONFIG.field(4, 3)
ACCEL_FS_SEL = ACCEL_CONFIG.field(4, 3)
A_DLPF_CFG = ACCEL_CONFIG_2.field(2, 0)
FIFO_OVERFLOW = INT_STATUS.field(4)
DATA_READY = INT_STATUS.field(0)
FIFO_ENABLE = USER_CTRL.field(6)
FIFO_RESET = USER_CTRL.field(2)
DEVICE_RESET = PWR_MGMT_1.field(7)
SLEEP = PWR_MGMT_1.field(6)

CLOCK_PLL = 0x01  # PWR_MGMT_1: awake, on the gyroscope's PLL
FIFO_ALL = 0xF8  # FIFO_EN: temperature, gyroscope x, y, z, accelerometer


def accel_bias_fields(first: int, stride: int, bank: int | None = None) -> tuple[BiasField, ...]:
    """Return the 15-bit accelerometer fields; bit 0 of each low byte is reserved and kept."""
    out = []
    for k, axis in enumerate("xyz"):
        high = Register(f"{axis.upper()}A_OFFS_H", first + k * stride, bank)
        low = Register(f"{axis.upper()}A_OFFS_L", first + k * stride + 1, bank)
        out.append(BiasField(f"accel.bias.{axis}", (high.field(7, 0), low.field(7, 1)), 1 / 1024))
    return tuple(out)


def gyro_bias_fields(first: int, bank: int | None = None) -> tuple[BiasField, ...]:
    """Return the 16-bit gyroscope fields, 32.8 counts per °/s, which the chip adds."""
    out = []
    for k, axis in enumerate("xyz"):
        high = Register(f"{axis.upper()}G_OFFSET_H", first + 2 * k, bank)
        low = Register(f"{axis.upper()}G_OFFSET_L", first + 2 * k + 1, bank)
        out.append(BiasField(f"gyro.bias.{axis}", (high.field(7, 0), low.field(7, 0)), 1 / 32.8))
    return tuple(out)


class Mpu6500(Chip):
    """Accelerometer, temperature and gyroscope in one burst of 14 bytes; FIFO of 512 bytes."""

    name = "mpu6500"
    models: ClassVar = {0x70: "MPU-6500", 0x71: "MPU-9250", 0x73: "MPU-9255"}
    source = "RM-MPU-6500A-00, RM-MPU-9250A-00"
    identity = WHO_AM_I
    accel_ranges = sensitivities((0, 2, 16384), (1, 4, 8192), (2, 8, 4096), (3, 16, 2048))
    gyro_ranges = sensitivities((0, 250, 131), (1, 500, 65.5), (2, 1000, 32.8), (3, 2000, 16.4))
    dlpf: ClassVar = {184.0: 1, 92.0: 2, 41.0: 3, 20.0: 4, 10.0: 5, 5.0: 6}
    bandwidths = tuple(dlpf)
    data = ACCEL_XOUT_H
    frame = np.dtype([("accel", ">i2", 3), ("temperature", ">i2"), ("gyro", ">i2", 3)])
    fifo_size = 512
    fifo_frame = 14
    biases = (accel_bias_fields(0x77, 3) + gyro_bias_fields(0x13),)

    def rates(self) -> Sequence[float]:
        # With the low-pass on, the base rate is 1 kHz.
        return [1000 / (1 + divider) for divider in range(256)]

    def reset(self, device: Device) -> None:
        device.write(PWR_MGMT_1, DEVICE_RESET.mask)
        device.sleep(self.start_up)
        device.wait(DEVICE_RESET, 0, timeout=0.5, what=f"resetting {self.name}")
        device.write(PWR_MGMT_1, CLOCK_PLL)
        device.sleep(0.05)

    def configure(self, device: Device, setup: Setup) -> None:
        rate = self.nearest_rate(setup.rate)
        device.write(PWR_MGMT_1, CLOCK_PLL)
        device.write(SMPLRT_DIV, round(1000 / rate) - 1)
        code = self.dlpf[setup.bandwidth or self.bandwidths[0]]
        device.write(CONFIG, DLPF_CFG.put(0, code))
        device.write(GYRO_CONFIG, GYRO_FS_SEL.put(0, self.gyro_sensitivity(setup.gyro_range).code))
        accel = self.accel_sensitivity(setup.accel_range)
        device.write(ACCEL_CONFIG, ACCEL_FS_SEL.put(0, accel.code))
        self._configure_accel_filter(device, code)

    def _configure_accel_filter(self, device: Device, code: int) -> None:
        device.write(ACCEL_CONFIG_2, A_DLPF_CFG.put(0, code))

    def start_fifo(self, device: Device) -> None:
        device.write(FIFO_EN, 0)
        device.write(USER_CTRL, FIFO_RESET.mask)
        device.write(USER_CTRL, FIFO_ENABLE.mask)
        device.write(FIFO_EN, FIFO_ALL)
        device.read(INT_STATUS)  # the overflow bit is sticky: drop what it holds from before

    def read_fifo(self, device: Device) -> Samples:
        waiting = int.from_bytes(device.read(FIFO_COUNTH, 2), "big")
        whole = waiting - waiting % self.fifo_frame
        data = device.read(FIFO_R_W, whole) if whole else b""
        # A full FIFO drops its oldest bytes, which need not be a whole sample: nothing in it
        # can be trusted, the burst included.
        overflow = bool(device.get(FIFO_OVERFLOW)) or waiting >= self.fifo_size
        samples = self.decode(b"" if overflow else data)
        return Samples(samples.accel, samples.gyro, samples.temperature, overflow=overflow)

    def ready(self, device: Device) -> bool:
        return bool(device.get(DATA_READY))

    def celsius(self, counts: NDArray[np.int16]) -> NDArray[np.float64]:
        return (counts.astype(np.float64) + 7011) * 0.002995  # 333.87 counts per °C, 21 °C at 0

    def sleep(self, device: Device) -> None:
        device.write(PWR_MGMT_1, SLEEP.mask | CLOCK_PLL)


CHIP = Mpu6500()
