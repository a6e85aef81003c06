"""Bosch BMI160.

Source: Bosch "BMI160" datasheet BST-BMI160-DS000, section 2.11 (registers by address). Offset
weights 3.9 mg and 0.061 °/s: there, and in Zephyr's driver (which cites page 79). Temperature:
23 °C at 0, 1/512 °C.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.chips import bosch
from drivers.chips.base import (
    Chip,
    Device,
    Register,
    Samples,
    Setup,
    sensitivities,
)

CHIP_ID = Register("CHIP_ID", 0x00)
PMU_STATUS = Register("PMU_STATUS", 0x03)
DATA_8 = Register("DATA_8", 0x0C)
STATUS = Register("STATUS", 0x1B)
TEMPERATURE_0 = Register("TEMPERATURE_0", 0x20)
FIFO_LENGTH_0 = Register("FIFO_LENGTH_0", 0x22)
FIFO_DATA = Register("FIFO_DATA", 0x24)
ACC_CONF = Register("ACC_CONF", 0x40)
ACC_RANGE = Register("ACC_RANGE", 0x41)
GYR_CONF = Register("GYR_CONF", 0x42)
GYR_RANGE = Register("GYR_RANGE", 0x43)
FIFO_DOWNS = Register("FIFO_DOWNS", 0x45)
FIFO_CONFIG_1 = Register("FIFO_CONFIG_1", 0x47)
OFFSET_6 = Register("OFFSET_6", 0x77)
CMD = Register("CMD", 0x7E)

ACCEL_STATUS = PMU_STATUS.field(5, 4)
GYRO_STATUS = PMU_STATUS.field(3, 2)
ACCEL_READY = STATUS.field(7)
GYRO_READY = STATUS.field(6)

NORMAL = 1
ACCEL_NORMAL, GYRO_NORMAL, ACCEL_SUSPEND, GYRO_SUSPEND = 0x11, 0x15, 0x10, 0x14
NORMAL_BANDWIDTH = 0x20  # ACC_CONF and GYR_CONF: no oversampling
UNDIVIDED = 0x88  # FIFO_DOWNS: filtered data, every sample
CONFIG_LENGTH = 1


class Bmi160(Chip):
    """Gyroscope, accelerometer and temperature in one burst of 22 bytes; FIFO of 1024 bytes."""

    name = "bmi160"
    models: ClassVar = {0xD1: "BMI160"}
    source = "BST-BMI160-DS000"
    identity = CHIP_ID
    accel_ranges = sensitivities((3, 2, 16384), (5, 4, 8192), (8, 8, 4096), (12, 16, 2048))
    gyro_ranges = sensitivities(
        (4, 125, 262.4), (3, 250, 131.2), (2, 500, 65.6), (1, 1000, 32.8), (0, 2000, 16.4)
    )
    data = DATA_8
    frame = np.dtype(
        {
            "names": ["gyro", "accel", "temperature"],
            "formats": ["(3,)<i2", "(3,)<i2", "<i2"],
            "offsets": [0, 6, 20],
            "itemsize": 22,
        }
    )
    fifo_size = 1024
    fifo_frame = bosch.FRAME.itemsize
    biases = (bosch.bias_fields(OFFSET_6.field(6), OFFSET_6.field(7)),)

    def rates(self) -> Sequence[float]:
        return list(bosch.RATES)

    def reset(self, device: Device) -> None:
        device.write(CMD, bosch.SOFT_RESET)
        device.sleep(self.start_up)

    def configure(self, device: Device, setup: Setup) -> None:
        code = bosch.RATES[self.nearest_rate(setup.rate)]
        # A command needs the last one to be done: 4 ms and 80 ms to wake.
        for command, field in ((ACCEL_NORMAL, ACCEL_STATUS), (GYRO_NORMAL, GYRO_STATUS)):
            device.write(CMD, command)
            device.sleep(0.005)
            device.wait(field, NORMAL, timeout=0.3, what=f"waking {self.name}")
        accel = self.accel_sensitivity(setup.accel_range).code
        gyro = self.gyro_sensitivity(setup.gyro_range).code
        device.write(ACC_CONF, NORMAL_BANDWIDTH | code)
        device.write(ACC_RANGE, accel)
        device.write(GYR_CONF, NORMAL_BANDWIDTH | code)
        device.write(GYR_RANGE, gyro)

    def start_fifo(self, device: Device) -> None:
        device.write(FIFO_DOWNS, UNDIVIDED)
        device.write(FIFO_CONFIG_1, bosch.FIFO_ALL)
        device.write(CMD, bosch.FIFO_FLUSH)

    def read_fifo(self, device: Device) -> Samples:
        waiting = int.from_bytes(device.read(FIFO_LENGTH_0, 2), "little") & 0x07FF
        data = device.read(FIFO_DATA, waiting) if waiting else b""
        return self._unframe(device, data, TEMPERATURE_0, CONFIG_LENGTH)

    def _unframe(
        self, device: Device, data: bytes, temperature: Register, config_length: int
    ) -> Samples:
        frames = bosch.parse_frames(data, config_length=config_length)
        overflow = frames.damaged or frames.skipped >= bosch.MOST_SKIPPED
        count = 0 if overflow else len(frames.accel)
        celsius = np.empty(0)
        if count:  # the FIFO does not hold it
            raw = np.frombuffer(device.read(temperature, 2), "<i2").astype(np.int16)
            celsius = np.repeat(self.celsius(raw), count)
        lost = 0 if overflow else frames.skipped
        return Samples(frames.accel[:count], frames.gyro[:count], celsius, lost, overflow)

    def ready(self, device: Device) -> bool:
        status = device.read(STATUS)[0]
        return bool(ACCEL_READY.get(status) and GYRO_READY.get(status))

    def celsius(self, counts: NDArray[np.int16]) -> NDArray[np.float64]:
        return bosch.celsius(counts)

    def sleep(self, device: Device) -> None:
        device.write(CMD, GYRO_SUSPEND)
        device.sleep(0.001)
        device.write(CMD, ACCEL_SUSPEND)


CHIP = Bmi160()
