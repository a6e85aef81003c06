"""A Linux I2C adapter, through smbus2."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

from calib.errors import DeviceBusyError, DeviceNotFoundError, DevicePermissionError, DriverError


class SmbusBus:
    """A Linux I2C adapter through smbus2.

    Plain I2C transactions where the adapter does them (``i2c_rdwr`` has no limit of 32 bytes);
    SMBus block calls where it does not.
    """

    def __init__(self, path: str) -> None:
        if not sys.platform.startswith("linux"):
            raise DeviceNotFoundError(
                f"{path}: I2C buses are reached on Linux only (this is {sys.platform}); record on "
                "a Linux board, or use a serial device"
            )
        import smbus2

        try:
            self._bus = smbus2.SMBus(path)
        except FileNotFoundError as error:
            raise DeviceNotFoundError(
                f"{path}: there is no such I2C bus; load the i2c-dev module and switch I2C on for "
                "this board, and see `ls /dev/i2c-*`"
            ) from error
        except PermissionError as error:
            raise DevicePermissionError(
                f"{path}: permission denied; join the i2c group (sudo usermod -aG i2c $USER, then "
                "log in again)"
            ) from error
        except OSError as error:
            raise DriverError(f"{path}: cannot open it as an I2C bus: {error.strerror}") from error
        self._message = smbus2.i2c_msg
        self._plain = bool(self._bus.funcs & smbus2.I2cFunc.I2C)

    def read(self, address: int, register: int, count: int) -> bytes:
        """Read registers after a repeated start."""
        if not self._plain:
            return self._read_blocks(address, register, count)
        write = self._message.write(address, [register])
        read = self._message.read(address, count)
        self._bus.i2c_rdwr(write, read)
        return bytes(read.buf[0:count])

    def _read_blocks(self, address: int, register: int, count: int) -> bytes:
        if count > 32:
            raise DriverError(
                f"this adapter has SMBus calls only, which read at most 32 bytes at once, not "
                f"{count} from a FIFO; add fifo=off to the address"
            )
        return bytes(self._bus.read_i2c_block_data(address, register, count))

    def write(self, address: int, register: int, data: bytes) -> None:
        """Write registers."""
        if self._plain:
            self._bus.i2c_rdwr(self._message.write(address, [register, *data]))
        else:
            self._bus.write_i2c_block_data(address, register, list(data))

    def lock(self, address: int) -> None:
        """Take one chip for this process, until the bus is closed.

        Raises
        ------
        DeviceBusyError
            If another process has it; the message names it.
        """
        import fcntl
        import os
        import struct

        assert self._bus.fd is not None
        request = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, address, 1, 0)
        try:
            fcntl.fcntl(self._bus.fd, fcntl.F_SETLK, request)
        except (BlockingIOError, PermissionError) as error:
            holder = struct.unpack("hhqqi4x", fcntl.fcntl(self._bus.fd, fcntl.F_GETLK, request))[4]
            raise DeviceBusyError(
                f"the chip at 0x{address:02X} is in use by process {holder}{_name(holder)}; end "
                "that first"
            ) from error

    def close(self) -> None:
        """Let go of the bus; it may be gone already."""
        with suppress(OSError):
            self._bus.close()


def _name(pid: int) -> str:
    try:
        return f" ({Path(f'/proc/{pid}/comm').read_text(encoding='utf-8').strip()})"
    except OSError:
        return ""
