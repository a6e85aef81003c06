"""A WitMotion WT901: streams 51 and 52, subtracts its registers, remembers what was saved."""

from __future__ import annotations

import struct

import numpy as np

from calib.gravity import STANDARD_GRAVITY
from drivers.dialects.witmotion import (
    ACCEL,
    ACCEL_LSB,
    GYRO,
    GYRO_LSB,
    REGISTER,
    TEMPERATURE_LSB,
    frame,
)
from drivers.emulators.base import DEGREE, EmulatedSensor
from drivers.emulators.serial_device import SerialDevice, serial_emulator

SAVE_REGISTER, READ_REGISTER, KEY_REGISTER = 0x00, 0x27, 0x69
UNLOCKED = 0xB588
ACCEL_BIAS = (0x05, 0x06, 0x07)
ACCEL_BIAS_LSB = STANDARD_GRAVITY / 10000
GYRO_BIAS = (0x08, 0x09, 0x0A)
GYRO_BIAS_LSB = DEGREE / 10000
"""As the maker's protocol text for AXOFFSET to HZOFFSET states, like the accelerometer's."""


class WitMotionDevice(SerialDevice):
    """The registers and the stream of a WT901."""

    def __init__(self, sensor: EmulatedSensor) -> None:
        super().__init__(sensor)
        self.saved: dict[int, int] = {}
        self.power_cycle()

    def power_cycle(self) -> None:
        """Load the saved registers; locked again."""
        self.registers = dict(self.saved)
        self.unlocked = False
        self._buffer = b""

    def stream(self, start: int, stop: int) -> bytes:
        """Return a 51 and a 52 frame for each sample."""
        signals, temperature = self.sensor.measure(start, stop)
        accel = signals.accel - self._values(ACCEL_BIAS) * ACCEL_BIAS_LSB
        gyro = signals.gyro - self._values(GYRO_BIAS) * GYRO_BIAS_LSB
        heat = temperature[:, None] / TEMPERATURE_LSB
        first = frame(ACCEL, np.hstack([accel / ACCEL_LSB, heat]))
        second = frame(GYRO, np.hstack([gyro / GYRO_LSB, heat]))
        return np.hstack([first, second]).tobytes()

    def receive(self, data: bytes) -> bytes:
        """Obey the five-byte commands ``FF AA register low high``."""
        self._buffer += data
        answer = b""
        while (at := self._buffer.find(b"\xff\xaa")) >= 0 and len(self._buffer) >= at + 5:
            register, value = struct.unpack("<BH", self._buffer[at + 2 : at + 5])
            self._buffer = self._buffer[at + 5 :]
            answer += self._command(register, value)
        self._buffer = self._buffer[-5:]
        return answer

    def _command(self, register: int, value: int) -> bytes:
        if register == KEY_REGISTER:
            self.unlocked = value == UNLOCKED
        elif register == READ_REGISTER:
            words = [self.registers.get(value + k, 0) for k in range(4)]
            signed = np.array([words], np.uint16).view(np.int16).astype(np.float64)
            return frame(REGISTER, signed).tobytes()
        elif not self.unlocked:
            pass  # a locked device ignores every write
        elif register == SAVE_REGISTER:
            if value == 0:
                self.saved = dict(self.registers)
            elif value == 0xFF:
                self.power_cycle()
        else:
            self.registers[register] = value
        return b""

    def _values(self, registers: tuple[int, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        words = np.array([self.registers.get(r, 0) for r in registers], np.uint16)
        return words.view(np.int16).astype(np.float64)


EMULATOR = serial_emulator(
    "witmotion",
    "WitMotion WT901 on a serial port",
    WitMotionDevice,
    default_rate=200.0,
)
