"""InvenSense (TDK) ICM-42688-P: one packet of 16 bytes per sample in the FIFO.

Source: TDK "ICM-42688-P" datasheet DS-000347, chapter 14 (bank 0) and 18 (bank 4), registers by
address; FIFO packet and temperature (132.48 counts per °C about 25 °C) as in the kernel's
inv_icm42600 driver too. The temperature in a FIFO packet is 8 bits, 2.07 counts per °C.
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

DEVICE_CONFIG = Register("DEVICE_CONFIG", 0x11, 0)
FIFO_CONFIG = Register("FIFO_CONFIG", 0x16, 0)
TEMP_DATA1 = Register("TEMP_DATA1", 0x1D, 0)
INT_STATUS = Register("INT_STATUS", 0x2D, 0)
FIFO_COUNTH = Register("FIFO_COUNTH", 0x2E, 0)
FIFO_DATA = Register("FIFO_DATA", 0x30, 0)
SIGNAL_PATH_RESET = Register("SIGNAL_PATH_RESET", 0x4B, 0)
INTF_CONFIG0 = Register("INTF_CONFIG0", 0x4C, 0)
PWR_MGMT0 = Register("PWR_MGMT0", 0x4E, 0)
GYRO_CONFIG0 = Register("GYRO_CONFIG0", 0x4F, 0)
ACCEL_CONFIG0 = Register("ACCEL_CONFIG0", 0x50, 0)
GYRO_ACCEL_CONFIG0 = Register("GYRO_ACCEL_CONFIG0", 0x52, 0)
TMST_CONFIG = Register("TMST_CONFIG", 0x54, 0)
FIFO_CONFIG1 = Register("FIFO_CONFIG1", 0x5F, 0)
WHO_AM_I = Register("WHO_AM_I", 0x75, 0)
REG_BANK_SEL = Register("REG_BANK_SEL", 0x76)
OFFSET_USER = tuple(Register(f"OFFSET_USER{k}", 0x77 + k, 4) for k in range(9))

SOFT_RESET = DEVICE_CONFIG.field(0)
FIFO_MODE = FIFO_CONFIG.field(7, 6)
FIFO_FULL = INT_STATUS.field(1)
DATA_READY = INT_STATUS.field(3)
FIFO_FLUSH = SIGNAL_PATH_RESET.field(1)
FULL_SCALE_GYRO = GYRO_CONFIG0.field(7, 5)
FULL_SCALE_ACCEL = ACCEL_CONFIG0.field(7, 5)
RATE_ACCEL = ACCEL_CONFIG0.field(3, 0)

STREAM = 1  # FIFO_MODE
LOW_NOISE = 0x0F  # PWR_MGMT0: gyroscope and accelerometer in low-noise mode, temperature on
BIG_ENDIAN = 0x30  # INTF_CONFIG0: FIFO count in bytes, everything high byte first
FIFO_ALL = 0x07  # FIFO_CONFIG1: temperature, gyroscope, accelerometer
HEADER_BOTH = 0x60  # accelerometer and gyroscope in the packet
HEADER_MASK = 0xE0  # with the "FIFO is empty" bit
INVALID = -32768
TIME_STAMPS = 0x29  # TMST_CONFIG: on, absolute, 16 µs; bit 5 is reserved and set
TICK = 16e-6
PACKET = np.dtype(
    [
        ("header", "u1"),
        ("accel", ">i2", 3),
        ("gyro", ">i2", 3),
        ("temperature", "i1"),
        ("time", ">u2"),
    ]
)
RATES = {
    8000.0: 3,
    4000.0: 4,
    2000.0: 5,
    1000.0: 6,
    500.0: 15,
    200.0: 7,
    100.0: 8,
    50.0: 9,
    25.0: 10,
    12.5: 11,
}


def _bias(parameter: str, high: tuple[int, int, int], low: int, weight: float) -> BiasField:
    register, top, bottom = high
    return BiasField(
        parameter,
        (OFFSET_USER[register].field(top, bottom), OFFSET_USER[low].field(7, 0)),
        weight,
    )


class Icm42688(Chip):
    """Temperature, accelerometer and gyroscope in one burst of 14 bytes; FIFO of 2048 bytes."""

    name = "icm42688p"
    models: ClassVar = {0x47: "ICM-42688-P"}
    source = "DS-000347"
    identity = WHO_AM_I
    bank_select = REG_BANK_SEL.field(2, 0)
    accel_ranges = sensitivities((3, 2, 16384), (2, 4, 8192), (1, 8, 4096), (0, 16, 2048))
    gyro_ranges = sensitivities(
        (7, 15.625, 2097.2),
        (6, 31.25, 1048.6),
        (5, 62.5, 524.3),
        (4, 125, 262),
        (3, 250, 131),
        (2, 500, 65.5),
        (1, 1000, 32.8),
        (0, 2000, 16.4),
    )
    data = TEMP_DATA1
    frame = np.dtype([("temperature", ">i2"), ("accel", ">i2", 3), ("gyro", ">i2", 3)])
    fifo_size = 2048
    fifo_frame = PACKET.itemsize
    clock_period = 65536 * TICK
    biases = (
        (
            _bias("accel.bias.x", (4, 7, 4), 5, 0.0005),
            _bias("accel.bias.y", (7, 3, 0), 6, 0.0005),
            _bias("accel.bias.z", (7, 7, 4), 8, 0.0005),
            _bias("gyro.bias.x", (1, 3, 0), 0, 1 / 32),
            _bias("gyro.bias.y", (1, 7, 4), 2, 1 / 32),
            _bias("gyro.bias.z", (4, 3, 0), 3, 1 / 32),
        ),
    )

    def rates(self) -> Sequence[float]:
        return list(RATES)

    def reset(self, device: Device) -> None:
        device.write(DEVICE_CONFIG, SOFT_RESET.mask)
        device.forget_bank()
        device.sleep(self.start_up)
        device.wait(SOFT_RESET, 0, timeout=0.5, what=f"resetting {self.name}")

    def configure(self, device: Device, setup: Setup) -> None:
        rate = RATES[self.nearest_rate(setup.rate)]
        device.write(INTF_CONFIG0, BIG_ENDIAN)
        gyro = FULL_SCALE_GYRO.put(rate, self.gyro_sensitivity(setup.gyro_range).code)
        accel = FULL_SCALE_ACCEL.put(rate, self.accel_sensitivity(setup.accel_range).code)
        device.write(GYRO_CONFIG0, gyro, accel)
        device.write(GYRO_ACCEL_CONFIG0, 0)
        device.write(TMST_CONFIG, TIME_STAMPS)
        device.write(PWR_MGMT0, LOW_NOISE)

    def start_fifo(self, device: Device) -> None:
        device.write(FIFO_CONFIG, FIFO_MODE.put(0, 0))
        device.write(SIGNAL_PATH_RESET, FIFO_FLUSH.mask)
        device.write(FIFO_CONFIG1, FIFO_ALL)
        device.write(FIFO_CONFIG, FIFO_MODE.put(0, STREAM))
        device.read(FIFO_COUNTH, 2)  # the first count after a flush is always 0
        device.read(INT_STATUS)  # FIFO_FULL is sticky: drop what it holds from before

    def read_fifo(self, device: Device) -> Samples:
        waiting = int.from_bytes(device.read(FIFO_COUNTH, 2), "big")
        whole = waiting - waiting % self.fifo_frame
        data = device.read(FIFO_DATA, whole) if whole else b""
        overflow = bool(device.get(FIFO_FULL)) or waiting > self.fifo_size - self.fifo_frame
        rows = np.frombuffer(b"" if overflow else data, PACKET)
        good = (rows["header"] & HEADER_MASK) == HEADER_BOTH
        good &= (rows["accel"] != INVALID).all(axis=1) & (rows["gyro"] != INVALID).all(axis=1)
        kept = rows[good]
        temperature = kept["temperature"].astype(np.float64) / 2.07 + 25
        return Samples(
            kept["accel"].astype(np.int16),
            kept["gyro"].astype(np.int16),
            temperature,
            lost=len(rows) - len(kept),
            overflow=overflow,
            ticks=kept["time"] * TICK,
        )

    def ready(self, device: Device) -> bool:
        return bool(device.get(DATA_READY))

    def celsius(self, counts: NDArray[np.int16]) -> NDArray[np.float64]:
        return counts.astype(np.float64) / 132.48 + 25

    def sleep(self, device: Device) -> None:
        device.write(PWR_MGMT0, 0)


CHIP = Icm42688()
