"""An i2c-tiny-usb adapter with an emulated bus behind it, plugged into QEMU by usbredir.

The kernel's ``i2c-tiny-usb`` driver sends vendor control requests: 1 what it can do, 2 set the
delay, 3 the last status, 4 to 7 one message (bit 0 begins, bit 1 ends a transaction), with the
message's flags in wValue and its address in wIndex. usbredir: usbredirproto.h, without any of its
capabilities, so that headers are 12 bytes.
"""

from __future__ import annotations

import socket
import struct
import threading
from pathlib import Path
from typing import BinaryIO

from drivers.emulators.i2c_bus import EmulatedBus, Message

HEADER = struct.Struct("<III")  # type, length, id
CONTROL = struct.Struct("<BBBBHHH")  # endpoint, request, kind, status, value, index, length
HELLO, CONNECT, INTERFACES, ENDPOINTS = 0, 1, 4, 5
SET_CONFIGURATION, GET_CONFIGURATION, CONFIGURATION = 6, 7, 8
SET_ALTERNATE, GET_ALTERNATE, ALTERNATE = 9, 10, 11
CONTROL_PACKET = 100
STALL = 3  # usb_redir_stall

FUNCTIONS = 0x0EFF0001  # plain I2C, and SMBus made from it
ACKNOWLEDGED, NOT_ACKNOWLEDGED = 1, 2
VENDOR, PRODUCT = 0x0403, 0xC631
DEVICE = struct.pack(
    "<BBHBBBBHHHBBBB", 18, 1, 0x0110, 0xFF, 0, 0, 8, VENDOR, PRODUCT, 0x205, 1, 2, 0, 1
)
CONFIGURATION_9 = struct.pack("<BBHBBBBB", 9, 2, 18, 1, 1, 0, 0x80, 50)
INTERFACE_9 = struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 0, 0xFF, 0, 0, 0)
STRINGS = {0: b"\x09\x04", 1: "imu-cal".encode("utf-16-le"), 2: "i2c-tiny-usb".encode("utf-16-le")}


class TinyUsb:
    """Listens on a socket for one QEMU."""

    def __init__(self, bus: EmulatedBus, path: Path) -> None:
        self.bus = bus
        self._status = ACKNOWLEDGED
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(str(path))
        self._server.listen(1)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening; QEMU has ended, and so has the thread."""
        self._server.close()
        self._thread.join(5)

    def _serve(self) -> None:
        try:
            link, _ = self._server.accept()
        except OSError:
            return
        with link, link.makefile("rb") as stream:
            self._talk(link, stream)

    def _talk(self, link: socket.socket, stream: BinaryIO) -> None:
        def send(kind: int, number: int, data: bytes) -> None:
            link.sendall(HEADER.pack(kind, len(data), number) + data)

        send(HELLO, 0, b"imu-cal".ljust(64, b"\0") + bytes(4))
        while head := stream.read(HEADER.size):
            kind, length, number = HEADER.unpack(head)
            data = stream.read(length)
            if kind == HELLO:
                classes = b"\xff".ljust(32, b"\0")
                send(INTERFACES, 0, struct.pack("<I", 1) + bytes(32) + classes + bytes(64))
                kinds = bytes([0] + [255] * 15) * 2  # only the control endpoints exist
                send(ENDPOINTS, 0, kinds + bytes(64))
                send(CONNECT, 0, struct.pack("<BBBBHH", 1, 0xFF, 0, 0, VENDOR, PRODUCT))
            elif kind in (SET_CONFIGURATION, GET_CONFIGURATION):
                send(CONFIGURATION, number, bytes([0, 1]))
            elif kind in (SET_ALTERNATE, GET_ALTERNATE):
                send(ALTERNATE, number, bytes([0, data[0], 0]))
            elif kind == CONTROL_PACKET:
                send(CONTROL_PACKET, number, self._control(data))

    def _control(self, packet: bytes) -> bytes:
        endpoint, request, kind, _, value, index, length = CONTROL.unpack_from(packet)
        data = packet[CONTROL.size :]
        answer, status = b"", 0
        if kind & 0x60 == 0x40:
            answer = self._vendor(request, value, index, length, data, reads=bool(kind & 0x80))
        elif request == 6:
            found = self._descriptor(value >> 8, value & 0xFF)
            answer, status = (found[:length], 0) if found else (b"", STALL)
        elif request == 0:
            answer = bytes(2)
        size = len(answer) if kind & 0x80 else length
        return CONTROL.pack(endpoint, request, kind, status, value, index, size) + answer

    def _descriptor(self, kind: int, index: int) -> bytes:
        if kind == 1:
            return DEVICE
        if kind == 2:
            return CONFIGURATION_9 + INTERFACE_9
        if kind == 3 and index in STRINGS:
            return bytes([2 + len(STRINGS[index]), 3]) + STRINGS[index]
        return b""

    def _vendor(
        self, request: int, value: int, index: int, length: int, data: bytes, *, reads: bool
    ) -> bytes:
        if request == 1:
            return struct.pack("<I", FUNCTIONS)
        if request == 3:
            return bytes([self._status])
        if 4 <= request <= 7:
            message = Message(index, count=length) if reads else Message(index, data)
            try:
                (answer,) = self.bus.transfer(message)
                self._status = ACKNOWLEDGED
            except OSError:
                self._status, answer = NOT_ACKNOWLEDGED, bytes(length)
            return answer if reads else b""
        return bytes(length) if reads else b""
