"""A MAVLink autopilot: streams an IMU message, answers parameter requests.

``output = (measured - offset) * scale`` with the parameters of PX4 (CAL_ACC0_XOFF, CAL_ACC0_XSCALE,
CAL_GYRO0_XOFF) or ArduPilot (INS_ACCOFFS_X, INS_ACCSCAL_X, INS_GYROFFS_X), m/s² and rad/s.
Parameters are stored as they are set, as on the real ones.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from calib.types import FloatArray
from drivers.dialects.mavlink import (
    ARDUPILOT,
    BY_NAME,
    FULL,
    HIGHRES_DTYPE,
    MESSAGES,
    MILLI_G,
    PX4,
    RAW_DTYPE,
    V1,
    V2,
    Message,
    frames,
)
from drivers.emulators.base import EmulatedSensor
from drivers.emulators.serial_device import SerialDevice

REAL32, INT32 = 9, 6
"""MAV_PARAM_TYPE."""
REBOOT = 246
"""MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN."""
AXES = "XYZ"


@dataclass(frozen=True)
class Firmware:
    """What differs between autopilots: who they are, what they send, what their parameters are."""

    autopilot: int
    message: str
    accel_offset: str
    accel_scale: str
    gyro_offset: str
    ids: tuple[str, str]


PX4_FIRMWARE = Firmware(
    PX4,
    "HIGHRES_IMU",
    "CAL_ACC0_{}OFF",
    "CAL_ACC0_{}SCALE",
    "CAL_GYRO0_{}OFF",
    ("CAL_ACC0_ID", "CAL_GYRO0_ID"),
)
ARDUPILOT_FIRMWARE = Firmware(
    ARDUPILOT,
    "RAW_IMU",
    "INS_ACCOFFS_{}",
    "INS_ACCSCAL_{}",
    "INS_GYROFFS_{}",
    ("INS_ACC_ID", "INS_GYR_ID"),
)


class Autopilot(SerialDevice):
    """The parameters and the stream of an autopilot."""

    def __init__(self, sensor: EmulatedSensor, *, firmware: Firmware) -> None:
        super().__init__(sensor)
        self.firmware = firmware
        # Name to (four bytes on the wire, type); they outlive a power cycle.
        self.parameters: dict[str, tuple[bytes, int]] = {}
        for axis in AXES:
            for form, value in (
                (firmware.accel_offset, 0.0),
                (firmware.accel_scale, 1.0),
                (firmware.gyro_offset, 0.0),
            ):
                self.parameters[form.format(axis)] = (struct.pack("<f", value), REAL32)
        for name, number in zip(firmware.ids, (1310988, 2359564), strict=True):
            by_bytes = firmware.autopilot == PX4  # ArduPilot casts integers to float instead
            raw = struct.pack("<i", number) if by_bytes else struct.pack("<f", float(number))
            self.parameters[name] = (raw, INT32)
        self._sequence = 0
        self.power_cycle()

    def power_cycle(self) -> None:
        """Restart; parameters stay."""
        self._buffer = b""

    def stream(self, start: int, stop: int) -> bytes:
        """Return a message for each sample, and a heartbeat each second."""
        signals, temperature = self.sensor.measure(start, stop)
        accel = (signals.accel - self._vector(self.firmware.accel_offset)) * self._vector(
            self.firmware.accel_scale
        )
        gyro = signals.gyro - self._vector(self.firmware.gyro_offset)
        index = np.arange(start, stop)
        message = BY_NAME[self.firmware.message]
        payload = _payload(message, index / self.sensor.rate, accel, gyro, temperature)
        beats = index % max(round(self.sensor.rate), 1) == 0
        sequence = self._sequence + np.arange(len(index)) + np.cumsum(beats)
        self._sequence = int(sequence[-1]) + 1
        sent = frames(message, payload, sequence)
        for k in np.flatnonzero(beats):
            sent[k] = self._heartbeat(int(sequence[k]) - 1) + sent[k]
        return b"".join(sent)

    def receive(self, data: bytes) -> bytes:
        """Answer PARAM_SET, PARAM_REQUEST_READ and a reboot command."""
        self._buffer += data
        answer = b""
        while (frame := self._next_frame()) is not None:
            number, payload = frame
            name = MESSAGES[number].name if number in MESSAGES else ""
            if name == "PARAM_SET":
                raw, _, _, text, kind = struct.unpack("<4sBB16sB", payload[:23])
                answer += self._set(_name(text), raw, kind)
            elif name == "PARAM_REQUEST_READ":
                _, _, _, text = struct.unpack("<hBB16s", payload[:20])
                answer += self._value(_name(text))
            elif name == "COMMAND_LONG":
                (command,) = struct.unpack_from("<H", payload, 28)
                if command == REBOOT:
                    self.power_cycle()
                answer += self._send("COMMAND_ACK", struct.pack("<HB", command, 0).ljust(10, b"\0"))
        return answer

    def _set(self, name: str, raw: bytes, kind: int) -> bytes:
        if name in self.parameters and self.parameters[name][1] == kind:
            self.parameters[name] = (raw, kind)
        return self._value(name)

    def _value(self, name: str) -> bytes:
        if name not in self.parameters:
            return b""  # an autopilot is silent about what it does not know
        raw, kind = self.parameters[name]
        index = list(self.parameters).index(name)
        payload = struct.pack(
            "<4sHH16sB", raw, len(self.parameters), index, name.encode("ascii"), kind
        )
        return self._send("PARAM_VALUE", payload)

    def _send(self, name: str, payload: bytes) -> bytes:
        row = np.frombuffer(payload, np.uint8)[None]
        self._sequence += 1
        return frames(BY_NAME[name], row, np.array([self._sequence - 1]))[0]

    def _heartbeat(self, sequence: int) -> bytes:
        payload = struct.pack("<IBBBBB", 0, 2, self.firmware.autopilot, 0, 3, 3)
        row = np.frombuffer(payload, np.uint8)[None]
        return frames(BY_NAME["HEARTBEAT"], row, np.array([sequence]))[0]

    def _next_frame(self) -> tuple[int, bytes] | None:
        """Take the next frame from the host; its checksum must be good."""
        while self._buffer:
            two = self._buffer[0] == V2
            head = 10 if two else 6
            if self._buffer[0] not in (V1, V2):
                self._buffer = self._buffer[1:]
                continue
            if len(self._buffer) < head:
                return None
            size = self._buffer[1]
            if len(self._buffer) < head + size + 2:
                return None
            number = self._buffer[7] if two else self._buffer[5]
            payload = self._buffer[head : head + size].ljust(FULL, b"\0")
            frame, self._buffer = self._buffer[: head + size + 2], self._buffer[1:]
            if number in MESSAGES and _is_good(frame, MESSAGES[number]):
                self._buffer = self._buffer[len(frame) - 1 :]
                return number, payload
        return None

    def _vector(self, form: str) -> FloatArray:
        raw = b"".join(self.parameters[form.format(axis)][0] for axis in AXES)
        return np.frombuffer(raw, "<f4").astype(np.float64)


def _payload(
    message: Message,
    time: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    temperature: FloatArray,
) -> np.ndarray:  # type: ignore[type-arg]
    highres = message.name == "HIGHRES_IMU"
    rows = np.zeros(len(time), HIGHRES_DTYPE if highres else RAW_DTYPE)
    rows["time"] = np.rint(time * 1e6)
    if highres:
        rows["accel"], rows["gyro"], rows["temperature"] = accel, gyro, temperature
        rows["updated"] = 0x3F | 1 << 12
    else:
        rows["accel"] = np.clip(np.rint(accel / MILLI_G), -32768, 32767)
        rows["gyro"] = np.clip(np.rint(gyro / 1e-3), -32768, 32767)
        rows["temperature"] = np.rint(temperature * 100)
    return rows.view(np.uint8).reshape(len(time), -1)


def _is_good(frame: bytes, message: Message) -> bool:
    from drivers.dialects.framing import as_bytes, crc16_mcrf4xx

    body = as_bytes(frame[1:-2] + bytes([message.crc_extra]))[None]
    return int(crc16_mcrf4xx(body)[0]) == int.from_bytes(frame[-2:], "little")


def _name(text: bytes) -> str:
    return text.split(b"\0")[0].decode("ascii", "replace")
