"""Bosch BMI270: as the BMI160, after its maker's configuration has been uploaded.

Source: Bosch "BMI270" datasheet BST-BMI270-DS000, section 5 (registers by address) and 4.4
(initialisation). The configuration file is the maker's: take ``bmi270_config_file`` as raw bytes
from Bosch's BMI270_SensorAPI. The gyroscope's cross-axis factor (GYR_CAS) is not applied: a
calibration finds it as misalignment.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.errors import DriverError
from drivers.chips import bosch
from drivers.chips.base import Device, Register, Samples, Setup, sensitivities
from drivers.chips.bmi160 import CHIP_ID, CMD, NORMAL_BANDWIDTH, UNDIVIDED, Bmi160

STATUS = Register("STATUS", 0x03)
DATA_8 = Register("DATA_8", 0x0C)
INTERNAL_STATUS = Register("INTERNAL_STATUS", 0x21)
TEMPERATURE_0 = Register("TEMPERATURE_0", 0x22)
FIFO_LENGTH_0 = Register("FIFO_LENGTH_0", 0x24)
FIFO_DATA = Register("FIFO_DATA", 0x26)
ACC_CONF = Register("ACC_CONF", 0x40)
ACC_RANGE = Register("ACC_RANGE", 0x41)
GYR_CONF = Register("GYR_CONF", 0x42)
GYR_RANGE = Register("GYR_RANGE", 0x43)
FIFO_DOWNS = Register("FIFO_DOWNS", 0x45)
FIFO_CONFIG_0 = Register("FIFO_CONFIG_0", 0x48)
FIFO_CONFIG_1 = Register("FIFO_CONFIG_1", 0x49)
INIT_CTRL = Register("INIT_CTRL", 0x59)
INIT_ADDR_0 = Register("INIT_ADDR_0", 0x5B)
INIT_DATA = Register("INIT_DATA", 0x5E)
NV_CONF = Register("NV_CONF", 0x70)
OFFSET_6 = Register("OFFSET_6", 0x77)
PWR_CONF = Register("PWR_CONF", 0x7C)
PWR_CTRL = Register("PWR_CTRL", 0x7D)

MESSAGE = INTERNAL_STATUS.field(3, 0)
ACCEL_READY = STATUS.field(7)
GYRO_READY = STATUS.field(6)
ACC_OFF_EN = NV_CONF.field(3)
GYR_OFF_EN = OFFSET_6.field(6)

INITIALISED = 1
ALL_ON = 0x0E  # PWR_CTRL: temperature, accelerometer, gyroscope
PERFORMANCE_ACCEL = 0x80
PERFORMANCE_GYRO = 0xC0  # filter and noise
CHUNK = 32  # bytes of configuration per transaction, so that SMBus adapters can do it
CONFIG_LENGTH = 4


class Bmi270(Bmi160):
    """Accelerometer, gyroscope and temperature in one burst of 24 bytes; FIFO of 2048 bytes."""

    name = "bmi270"
    models: ClassVar = {0x24: "BMI270"}
    source = "BST-BMI270-DS000"
    identity = CHIP_ID
    accel_ranges = sensitivities((0, 2, 16384), (1, 4, 8192), (2, 8, 4096), (3, 16, 2048))
    gyro_ranges = sensitivities(
        (4, 125, 262.144),
        (3, 250, 131.072),
        (2, 500, 65.536),
        (1, 1000, 32.768),
        (0, 2000, 16.384),
    )
    data = DATA_8
    frame = np.dtype(
        {
            "names": ["accel", "gyro", "temperature"],
            "formats": ["(3,)<i2", "(3,)<i2", "<i2"],
            "offsets": [0, 6, 22],
            "itemsize": 24,
        }
    )
    fifo_size = 2048
    biases = (bosch.bias_fields(ACC_OFF_EN, GYR_OFF_EN),)

    def configure(self, device: Device, setup: Setup) -> None:
        device.write(PWR_CONF, 0)  # no advanced power save: registers answer at once
        device.sleep(0.001)
        if device.get(MESSAGE) != INITIALISED:
            self._upload(device, setup.firmware)
        code = bosch.RATES[self.nearest_rate(setup.rate)]
        accel = self.accel_sensitivity(setup.accel_range).code
        gyro = self.gyro_sensitivity(setup.gyro_range).code
        device.write(PWR_CTRL, ALL_ON)
        device.write(ACC_CONF, PERFORMANCE_ACCEL | NORMAL_BANDWIDTH | code)
        device.write(ACC_RANGE, accel)
        device.write(GYR_CONF, PERFORMANCE_GYRO | NORMAL_BANDWIDTH | code)
        device.write(GYR_RANGE, gyro)

    def _upload(self, device: Device, firmware: bytes | None) -> None:
        if firmware is None:
            raise DriverError(
                "this BMI270 was powered on since its configuration was uploaded, and does not "
                "measure without it; add config_file=PATH to the address (the 8192 bytes of "
                "bmi270_config_file from Bosch's BMI270_SensorAPI, as a binary file)"
            )
        if not firmware or len(firmware) % 2:
            raise DriverError(f"config_file has {len(firmware)} bytes, expected whole words")
        device.write(INIT_CTRL, 0)
        for start in range(0, len(firmware), CHUNK):
            word = start // 2
            device.write(INIT_ADDR_0, word & 0x0F, word >> 4)
            device.write(INIT_DATA, *firmware[start : start + CHUNK])
        device.write(INIT_CTRL, 1)
        device.sleep(0.02)
        device.wait(MESSAGE, INITIALISED, timeout=0.2, what="starting bmi270 on its config_file")

    def start_fifo(self, device: Device) -> None:
        device.write(FIFO_DOWNS, UNDIVIDED)
        device.write(FIFO_CONFIG_0, 0, bosch.FIFO_ALL)  # overwrite the oldest; no time frames
        device.write(CMD, bosch.FIFO_FLUSH)

    def read_fifo(self, device: Device) -> Samples:
        waiting = int.from_bytes(device.read(FIFO_LENGTH_0, 2), "little") & 0x3FFF
        data = device.read(FIFO_DATA, waiting) if waiting else b""
        return self._unframe(device, data, TEMPERATURE_0, CONFIG_LENGTH)

    def ready(self, device: Device) -> bool:
        status = device.read(STATUS)[0]
        return bool(ACCEL_READY.get(status) and GYRO_READY.get(status))

    def sleep(self, device: Device) -> None:
        device.write(PWR_CTRL, 0)


CHIP = Bmi270()
