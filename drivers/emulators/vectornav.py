"""A VectorNav VN-100: streams binary frames or ASCII sentences, holds registers 25 and 84.

``output = C @ (measured - B)``, register 25 for the accelerometer (B in m/s²), 84 for the
gyroscope (rad/s).
"""

from __future__ import annotations

import numpy as np

from calib.types import FloatArray
from drivers.dialects.vectornav import binary_frames, command, layout_of
from drivers.emulators.base import EmulatedSensor
from drivers.emulators.serial_device import SerialDevice, serial_emulator

HEADER = bytes.fromhex("fa01 2105")
"""Common group: time since start-up, angular rate, acceleration, temperature."""
ACCEL_REGISTER, GYRO_REGISTER = 25, 84
IDENTITY = np.concatenate([np.eye(3).ravel(), np.zeros(3)]).astype(np.float32)
TEXT_REGISTERS = {1: "VN-100T-CR", 3: "0100012345", 4: "2.1.0.0"}
INVALID_CHECKSUM, INVALID_COMMAND, TOO_FEW, INVALID_PARAMETER, INVALID_REGISTER = 3, 4, 5, 7, 8


class VectorNavDevice(SerialDevice):
    """The registers and the stream of a VN-100."""

    def __init__(self, sensor: EmulatedSensor, *, binary: bool) -> None:
        super().__init__(sensor)
        self.binary = binary
        self.saved = {ACCEL_REGISTER: IDENTITY.copy(), GYRO_REGISTER: IDENTITY.copy()}
        self.power_cycle()

    def power_cycle(self) -> None:
        """Load what was stored with VNWNV."""
        self.registers = {number: values.copy() for number, values in self.saved.items()}
        self._buffer = b""

    def stream(self, start: int, stop: int) -> bytes:
        """Return one frame or sentence for each sample."""
        signals, temperature = self.sensor.measure(start, stop)
        accel = self._compensate(ACCEL_REGISTER, signals.accel)
        gyro = self._compensate(GYRO_REGISTER, signals.gyro)
        if self.binary:
            return self._frames(start, accel, gyro, temperature)
        rows = np.hstack([np.zeros((stop - start, 3)), accel, gyro]).tolist()
        return b"".join(
            command("VNMAR," + ",".join(f"{value:+010.6f}" for value in row)) for row in rows
        )

    def receive(self, data: bytes) -> bytes:
        """Answer ``$VN...*XX`` commands; other bytes are passed over."""
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        self._buffer = self._buffer[-512:]
        return b"".join(self._answer(line.strip()) for line in lines if b"$VN" in line)

    def _answer(self, line: bytes) -> bytes:
        body = line[line.index(b"$VN") + 1 :].decode("ascii", "replace").split("*")[0]
        if not line.endswith(b"*XX") and command(body).strip() != line[line.index(b"$VN") :]:
            return _error(INVALID_CHECKSUM)
        verb, *words = body.split(",")
        if verb == "VNRRG":
            return self._read(words)
        if verb == "VNWRG":
            return self._write(words)
        if verb == "VNWNV":
            self.saved = {number: values.copy() for number, values in self.registers.items()}
        elif verb == "VNRST":
            self.power_cycle()
        elif verb == "VNRFS":
            self.saved = {number: IDENTITY.copy() for number in self.saved}
            self.power_cycle()
        else:
            return _error(INVALID_COMMAND)
        return command(verb)

    def _read(self, words: list[str]) -> bytes:
        if not words:
            return _error(TOO_FEW)
        number = int(words[0]) if words[0].isdigit() else -1
        if number in TEXT_REGISTERS:
            return command(f"VNRRG,{words[0]},{TEXT_REGISTERS[number]}")
        if number not in self.registers:
            return _error(INVALID_REGISTER)
        return command(f"VNRRG,{words[0]},{_show(self.registers[number])}")

    def _write(self, words: list[str]) -> bytes:
        number = int(words[0]) if words and words[0].isdigit() else -1
        if number not in self.registers:
            return _error(INVALID_REGISTER)
        if len(words) < 1 + IDENTITY.size:
            return _error(TOO_FEW)
        try:
            values = np.array([float(word) for word in words[1:]], np.float32)
        except ValueError:
            return _error(INVALID_PARAMETER)
        if values.size != IDENTITY.size or not np.isfinite(values).all():
            return _error(INVALID_PARAMETER)
        self.registers[number] = values
        return command(f"VNWRG,{words[0]},{_show(values)}")

    def _compensate(self, register: int, measured: FloatArray) -> FloatArray:
        values = self.registers[register].astype(np.float64)
        return (measured - values[9:]) @ values[:9].reshape(3, 3).T

    def _frames(
        self, start: int, accel: FloatArray, gyro: FloatArray, temperature: FloatArray
    ) -> bytes:
        layout = layout_of(HEADER)
        assert layout is not None
        count = len(temperature)
        payload = np.zeros((count, layout.length - len(HEADER) - 2), np.uint8)

        def put(name: str, values: np.ndarray, kind: str) -> None:  # type: ignore[type-arg]
            raw = np.ascontiguousarray(values, kind).reshape(count, -1).view(np.uint8)
            begin = layout.places[name] - len(HEADER)
            payload[:, begin : begin + raw.shape[1]] = raw

        stamps = np.rint(np.arange(start, start + count) * (1e9 / self.sensor.rate))
        put("time_startup", stamps, "<u8")
        put("accel", accel, "<f4")
        put("gyro", gyro, "<f4")
        put("temperature", temperature, "<f4")
        return binary_frames(HEADER, payload).tobytes()


def _show(values: np.ndarray) -> str:  # type: ignore[type-arg]
    return ",".join(f"{value:+.6f}" for value in values.tolist())


def _error(code: int) -> bytes:
    return command(f"VNERR,{code:02d}")


EMULATOR = serial_emulator(
    "vectornav",
    "VectorNav VN-100, binary frames, on a serial port",
    lambda sensor: VectorNavDevice(sensor, binary=True),
    default_rate=200.0,
)
