"""ST LSM6DSO, LSM6DSOX and ISM330DHCX: the LSM6DS3's map, with a tagged FIFO and user offsets.

Source: ST "LSM6DSO" datasheet DS12140, chapters 9 and 10 (registers by address). X_OFS_USR there:
the value is subtracted from the measured acceleration. LSM6DSO and LSM6DSOX answer alike.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from drivers.chips.base import BiasField, BiasSet, Device, Register, Samples
from drivers.chips.lsm6ds3 import (
    CONTINUOUS,
    CTRL2_G,
    ODR_G,
    RATES,
    Lsm6ds3,
)

FIFO_CTRL3 = Register("FIFO_CTRL3", 0x09)
FIFO_CTRL4 = Register("FIFO_CTRL4", 0x0A)
CTRL6_C = Register("CTRL6_C", 0x15)
CTRL7_G = Register("CTRL7_G", 0x16)
FIFO_STATUS1 = Register("FIFO_STATUS1", 0x3A)
FIFO_STATUS2 = Register("FIFO_STATUS2", 0x3B)
FIFO_DATA_OUT_TAG = Register("FIFO_DATA_OUT_TAG", 0x78)
OFS_USR = tuple(Register(f"{axis}_OFS_USR", 0x73 + k) for k, axis in enumerate("XYZ"))

USR_OFF_W = CTRL6_C.field(3)
USR_OFF_ON_OUT = CTRL7_G.field(1)
BDR_GY = FIFO_CTRL3.field(7, 4)
BDR_XL = FIFO_CTRL3.field(3, 0)
FIFO_MODE = FIFO_CTRL4.field(2, 0)
OVERRUN = FIFO_STATUS2.field(6)
OVERRUN_LATCHED = FIFO_STATUS2.field(3)

TAG_GYRO, TAG_ACCEL = 1, 2
WORD = np.dtype([("tag", "u1"), ("data", "<i2", 3)])


def _biases(weight: float, code: int) -> BiasSet:
    return tuple(
        BiasField(
            f"accel.bias.{axis}",
            (register.field(7, 0),),
            weight,
            sign=-1,
            enable=((USR_OFF_W, code), (USR_OFF_ON_OUT, 1)),
        )
        for axis, register in zip("xyz", OFS_USR, strict=True)
    )


class Lsm6dso(Lsm6ds3):
    """A FIFO of 512 words of 7 bytes: a tag, then one triad."""

    name = "lsm6dso"
    models: ClassVar = {0x6C: "LSM6DSO", 0x6B: "ISM330DHCX"}
    aliases = ("LSM6DSOX",)
    source = "DS12140"
    fifo_size = 512 * WORD.itemsize
    fifo_frame = 2 * WORD.itemsize
    counts_per_celsius: ClassVar[float] = 256.0
    rate_codes: ClassVar = RATES | {3332.0: 9, 6667.0: 10}
    biases = (_biases(2**-10, 0), _biases(2**-6, 1))

    def start_fifo(self, device: Device) -> None:
        code = ODR_G.get(device.read(CTRL2_G)[0])
        device.write(FIFO_CTRL4, 0)  # bypass empties it
        device.write(FIFO_CTRL3, BDR_GY.put(BDR_XL.put(0, code), code))
        device.write(FIFO_CTRL4, FIFO_MODE.put(0, CONTINUOUS))
        device.read(FIFO_STATUS2)  # the overrun latch: drop what it holds from before

    def read_fifo(self, device: Device) -> Samples:
        low, high = device.read(FIFO_STATUS1, 2)
        words = (high & 0x03) << 8 | low
        overflow = bool(OVERRUN.get(high) or OVERRUN_LATCHED.get(high))
        count = 0 if overflow else words // 2 * self.fifo_frame
        rows = np.frombuffer(device.read(FIFO_DATA_OUT_TAG, count) if count else b"", WORD)
        # Two neighbours make a sample if one is of each triad and both of one time slot.
        tag, slot = rows["tag"] >> 3, (rows["tag"] >> 1) & 3
        pair = (tag[:-1] + tag[1:] == TAG_GYRO + TAG_ACCEL) & (slot[:-1] == slot[1:])
        first = np.flatnonzero(pair & (tag[:-1] != 0) & (tag[1:] != 0))
        swapped = tag[first] == TAG_ACCEL
        gyro, accel = rows["data"][first + swapped], rows["data"][first + 1 - swapped]
        return Samples(
            accel.astype(np.int16),
            gyro.astype(np.int16),
            self.temperature(device, len(first)),
            lost=len(rows) - 2 * len(first),
            overflow=overflow,
        )


CHIP = Lsm6dso()
