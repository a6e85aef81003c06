"""What Bosch's BMI160 and BMI270 share: a FIFO of headed frames, bias registers, rates.

Frame headers: Bosch "BMI160" datasheet BST-BMI160-DS000, section 2.5 (FIFO), and "BMI270"
BST-BMI270-DS000, section 4.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.chips.base import BiasField, BiasSet, Field, Register

HEAD_SKIP, HEAD_TIME, HEAD_CONFIG, HEAD_EMPTY = 0x40, 0x44, 0x48, 0x80
HEAD_ACCEL, HEAD_GYRO, HEAD_BOTH = 0x84, 0x88, 0x8C
FRAME = np.dtype([("head", "u1"), ("gyro", "<i2", 3), ("accel", "<i2", 3)])
MOST_SKIPPED = 255  # the skip frame's byte counts no further
FIFO_ALL = 0xD0  # gyroscope, accelerometer, with headers
FIFO_FLUSH, SOFT_RESET = 0xB0, 0xB6

RATES = {25.0: 6, 50.0: 7, 100.0: 8, 200.0: 9, 400.0: 10, 800.0: 11, 1600.0: 12}
"""Rates that both triads have, Hz: 100 / 2^(8 - code)."""


@dataclass(frozen=True)
class Frames:
    """What a burst held: samples, how many the chip skipped before, and whether it made sense."""

    accel: NDArray[np.int16]
    gyro: NDArray[np.int16]
    skipped: int
    damaged: bool


def parse_frames(data: bytes, *, config_length: int) -> Frames:
    """Take a burst of the FIFO apart; runs of samples at once, other frames one by one.

    ``config_length`` is how many bytes follow the header of a frame that marks a change of
    configuration. A frame cut by the end of the burst is left: the chip repeats it.
    """
    raw = np.frombuffer(data, np.uint8)
    parts = []
    position, skipped, damaged = 0, 0, False
    while position < raw.size:
        head = int(raw[position])
        if head == HEAD_BOTH:
            whole = (raw.size - position) // FRAME.itemsize
            rows = np.frombuffer(data, FRAME, whole, position)
            other = np.flatnonzero(rows["head"] != HEAD_BOTH)
            rows = rows[: other[0]] if other.size else rows
            if not rows.size:
                break
            parts.append(rows)
            position += rows.size * FRAME.itemsize
        elif head == HEAD_SKIP and position + 1 < raw.size:
            skipped += int(raw[position + 1])
            position += 2
        elif head == HEAD_TIME:
            position += 4
        elif head == HEAD_CONFIG:
            position += 1 + config_length
        elif head in (HEAD_ACCEL, HEAD_GYRO):
            skipped += 1  # half a sample, while the other triad was still starting
            position += 7
        else:
            damaged = head not in (HEAD_EMPTY, HEAD_SKIP)
            break
    rows = np.concatenate(parts) if parts else np.empty(0, FRAME)
    return Frames(rows["accel"].astype(np.int16), rows["gyro"].astype(np.int16), skipped, damaged)


def bias_fields(accel_enable: Field, gyro_enable: Field) -> BiasSet:
    """Return the bias registers 71 to 77: 8 bits of 3.9 mg, 10 bits of 0.061 °/s."""
    high = Register("OFFSET_6", 0x77)
    accel = tuple(
        BiasField(
            f"accel.bias.{axis}",
            (Register(f"OFFSET_{k}", 0x71 + k).field(7, 0),),
            0.0039,
            enable=((accel_enable, 1),),
        )
        for k, axis in enumerate("xyz")
    )
    gyro = tuple(
        BiasField(
            f"gyro.bias.{axis}",
            (high.field(2 * k + 1, 2 * k), Register(f"OFFSET_{3 + k}", 0x74 + k).field(7, 0)),
            0.061,
            enable=((gyro_enable, 1),),
        )
        for k, axis in enumerate("xyz")
    )
    return accel + gyro


def celsius(counts: NDArray[np.int16]) -> NDArray[np.float64]:
    """Return °C: 512 counts per °C about 23 °C."""
    return counts.astype(np.float64) / 512 + 23
