"""``serial:///dev/ttyUSB0?dialect=witmotion&baud=115200``: a serial port, read by its own thread.

A kernel's buffer holds a few kilobytes (a pty 4 to 20), so the thread does nothing but read.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial
from serial.tools import list_ports

from calib.errors import (
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    DevicePermissionError,
    DriverError,
    WrongDeviceError,
)
from drivers.address import Address
from drivers.driver import Driver
from drivers.stream import ByteSource, StreamDriver, choose_dialect
from drivers.transports.base import Transport

try:
    from termios import error as TermiosError  # noqa: N812 - a class with a lower-case name
except ImportError:  # Windows has no termios, and cannot raise its error

    class TermiosError(Exception):  # type: ignore[no-redef]
        """Never raised."""


LOST = (serial.SerialException, OSError, TermiosError)
"""What a vanished port raises, depending on the call: SerialException, a plain OSError 5, or
termios.error, which is no OSError."""
NAP = 0.002
"""s between reads while little arrives: a kernel buffer of 4 kB lasts longer at any usual baud."""
BUSY = 2048
"""Bytes in one read above which the next read follows at once."""
GATHER = 0.02
"""s that the consumer lets bytes gather, so that parsing goes in large pieces."""


@dataclass(frozen=True)
class SerialPort:
    """A serial port as the operating system lists it; ``vid`` and ``pid`` are None if not USB."""

    path: str
    description: str
    vid: int | None
    pid: int | None
    serial_number: str | None

    @property
    def identity(self) -> tuple[int, int, str | None] | None:
        """What stays the same when the device comes back under another name."""
        if self.vid is None or self.pid is None:
            return None
        return self.vid, self.pid, self.serial_number

    @property
    def url(self) -> str:
        """The address to record from."""
        return f"serial://{self.path}"

    @property
    def problem(self) -> str:
        """Why it cannot be opened by this user; empty if it can."""
        if os.name != "posix" or os.access(self.path, os.R_OK | os.W_OK):
            return ""
        return f"no permission. {_owner(self.path)}"


def list_serial_ports() -> list[SerialPort]:
    """Return the serial ports that exist, by path."""
    ports = [
        SerialPort(p.device, p.description or "", p.vid, p.pid, p.serial_number)
        for p in list_ports.comports()
    ]
    return sorted(ports, key=lambda port: port.path)


class SerialSource(ByteSource):
    """A serial port. It is locked while open, and found again by its USB identity."""

    def __init__(self, path: str, *, baud: int) -> None:
        self.path = path
        self.baud = baud
        self._identity: tuple[int, int, str | None] | None = None
        self._port: Any = None
        self._chunks: deque[tuple[bytes, float]] = deque()
        self._arrived = threading.Event()
        self._stop = threading.Event()
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Open and lock the port, discard what it held, and start reading."""
        path = self._find()
        try:
            port = serial.Serial(path, self.baud, timeout=0.1, write_timeout=2.0, exclusive=True)
        except (*LOST, ValueError) as error:
            raise _explain(path, error) from error
        self._identity = next((p.identity for p in list_serial_ports() if p.path == path), None)
        self._port, self._failure = port, None
        try:
            port.reset_input_buffer()
            port.reset_output_buffer()
        except LOST as error:
            self.close()
            raise DeviceLostError(f"{path} went away while it was opened: {error}") from error
        self._chunks.clear()
        self._arrived.clear()
        self._stop.clear()
        self._thread = threading.Thread(target=self._pump, name=f"read {path}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading and unlock the port."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None
        if self._port is not None:
            port, self._port = self._port, None
            try:
                port.close()
            except LOST:
                return  # it is gone, and so closed

    def read(self, timeout: float) -> tuple[bytes, float | None]:
        """Return what the thread has read."""
        if not self._chunks:
            self._arrived.wait(timeout)
        if not self._chunks:
            if self._failure is not None:
                raise DeviceLostError(
                    f"{self.path} went away ({self._failure}): unplugged, or without power"
                ) from self._failure
            return b"", None
        if self._failure is None:
            time.sleep(GATHER)
        self._arrived.clear()
        parts, arrival = [], 0.0
        while self._chunks:
            data, arrival = self._chunks.popleft()
            parts.append(data)
        return b"".join(parts), arrival

    def write(self, data: bytes) -> None:
        """Send bytes and wait until they are out."""
        try:
            self._port.write(data)
            self._port.flush()
        except LOST as error:
            raise DeviceLostError(f"{self.path} went away while writing: {error}") from error

    def _find(self) -> str:
        """Return where the device is now: a replugged one may have another name."""
        if self._identity is not None:
            for port in list_serial_ports():
                if port.identity == self._identity:
                    self.path = port.path
                    return port.path
        return self.path

    def _pump(self) -> None:
        read = self._reader()
        while not self._stop.is_set():
            try:
                data = read()
            except LOST as error:
                self._failure = error
                self._arrived.set()
                return
            if data:
                self._chunks.append((data, time.monotonic()))
                if not self._arrived.is_set():
                    self._arrived.set()
            if len(data) < BUSY:
                time.sleep(NAP)

    def _reader(self) -> Any:
        port = self._port
        if os.name != "posix":
            return lambda: port.read(max(port.in_waiting, 1))
        import select

        number = port.fileno()
        poll = select.poll()
        poll.register(number, select.POLLIN)

        def read() -> bytes:
            if not poll.poll(100):
                return b""
            data = os.read(number, 1 << 16)
            if not data:
                raise OSError(errno.EIO, "the device hung up")
            return data

        return read


def _explain(path: str, error: BaseException) -> DriverError:
    """Return the driver error that says why a port could not be opened, and what to do."""
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFound" in str(error):
        ports = [f"{p.path} ({p.description})" for p in list_serial_ports()]
        there = ", ".join(ports) if ports else "none; is it plugged in, and the cable a data cable?"
        return DeviceNotFoundError(f"no serial port {path}. Ports that exist: {there}")
    if number in (errno.EACCES, errno.EPERM) or "PermissionError" in str(error):
        return DevicePermissionError(
            f"not allowed to open {path}. {_owner(path)}; or another program has it open"
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in str(error):
        return DeviceBusyError(
            f"{path} is in use by {_users(path) or 'another program'}; end it first"
        )
    return WrongDeviceError(f"{path} cannot be used as a serial port: {error}")


def _owner(path: str) -> str:
    try:
        import grp

        group = grp.getgrgid(os.stat(path).st_gid).gr_name
    except (ImportError, KeyError, OSError):
        return "Look at its permissions"
    return f"It belongs to group {group}: sudo usermod -aG {group} $USER, then log out and in again"


def _users(path: str) -> str:
    """Return ``pid 123 (command)`` of the processes that have a port open, as far as visible."""
    real = os.path.realpath(path)
    found: list[str] = []
    for entry in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.readlink(entry) != real:
                continue
            pid = entry.parts[2]
            command = Path("/proc", pid, "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except (OSError, UnicodeDecodeError):
            continue  # ended meanwhile, or someone else's
        if int(pid) != os.getpid() or not found:
            found.append(f"pid {pid} ({command.strip()[:80]})")
    return ", ".join(dict.fromkeys(found))


def _make(address: Address) -> Driver:
    dialect, options = choose_dialect(address, "baud")
    baud = address.integer("baud", dialect.default_baud if dialect else 115200, minimum=1)
    source = SerialSource(address.target, baud=baud)
    return StreamDriver(address.text, source, dialect, options)


TRANSPORT = Transport("serial", "serial:///dev/ttyUSB0?dialect=auto&baud=115200", _make)
