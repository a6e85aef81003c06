"""InvenSense MPU-6050 (and MPU-6000): the MPU-6500's map, with an older temperature and biases.

Source: InvenSense "MPU-6000 and MPU-6050 Register Map and Descriptions" RM-MPU-6000A-00, whose
sections are titled by the register's number. The bias registers 06 to 0B and 13 to 18 are not in
that document: they are as in the maker's driver and in jrowberg/i2cdevlib.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.chips.base import Device
from drivers.chips.mpu6500 import Mpu6500, accel_bias_fields, gyro_bias_fields


class Mpu6050(Mpu6500):
    """Accelerometer, temperature and gyroscope in one burst of 14 bytes; FIFO of 1024 bytes."""

    name = "mpu6050"
    models: ClassVar = {0x68: "MPU-6050"}
    source = "RM-MPU-6000A-00"
    dlpf: ClassVar = {188.0: 1, 98.0: 2, 42.0: 3, 20.0: 4, 10.0: 5, 5.0: 6}
    bandwidths = tuple(dlpf)
    fifo_size = 1024
    biases = (accel_bias_fields(0x06, 2) + gyro_bias_fields(0x13),)

    def _configure_accel_filter(self, device: Device, code: int) -> None:
        pass  # one low-pass serves both triads

    def celsius(self, counts: NDArray[np.int16]) -> NDArray[np.float64]:
        return counts.astype(np.float64) / 340 + 36.53


CHIP = Mpu6050()
