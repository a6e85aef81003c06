"""An emulated I2C bus as a file that any program can use: ``MOUNT/i2c-N``, through ioctl(2).

A FUSE file system with one file, served over /dev/fuse without any package. The kernel passes us
each ioctl's number and its argument, which is an address in the *caller's* memory: I2C ioctls do
not encode a size, so their structs are fetched and stored with process_vm_readv and
process_vm_writev. Needs root (or CAP_SYS_ADMIN and CAP_SYS_PTRACE) and /dev/fuse; Linux only.

Protocol: linux/fuse.h, version 7.31; I2C ioctls: linux/i2c-dev.h and linux/i2c.h.
"""

from __future__ import annotations

import ctypes
import errno
import os
import stat
import struct
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Self

from calib.errors import DeviceBusyError, DevicePermissionError, DriverError
from drivers.emulators.i2c_bus import EmulatedBus, Message

IN_HEADER = struct.Struct("=IIQQIIII")  # length, opcode, unique, node, uid, gid, pid, padding
OUT_HEADER = struct.Struct("=IiQ")  # length, error, unique
ATTRIBUTES = struct.Struct("=QQQQQQIIIIIIIIII")  # inode ... block size, flags
DIRECTORY_ENTRY = struct.Struct("=QQII")  # inode, next offset, name length, type

LOOKUP, FORGET, GETATTR, OPEN, READ, WRITE, STATFS, RELEASE = 1, 2, 3, 14, 15, 16, 17, 18
FLUSH, INIT, OPENDIR, READDIR, RELEASEDIR, ACCESS = 25, 26, 27, 28, 29, 34
INTERRUPT, DESTROY, IOCTL, BATCH_FORGET = 36, 38, 39, 42
ROOT, FILE = 1, 2
DIRECT_IO = 1  # FOPEN_DIRECT_IO: every read and write comes here

I2C_RETRIES, I2C_TIMEOUT, I2C_SLAVE, I2C_TENBIT = 0x701, 0x702, 0x703, 0x704
I2C_FUNCS, I2C_SLAVE_FORCE, I2C_RDWR, I2C_PEC, I2C_SMBUS = 0x705, 0x706, 0x707, 0x708, 0x720
FUNCTIONS = 0x0EFF0001 & ~0x1800000  # plain I2C, and the SMBus calls that _smbus does
I2C_M_RD = 1
RDWR = struct.Struct("@PI")
I2C_MESSAGE = struct.Struct("@HHHP")
SMBUS = struct.Struct("@BBIP")
QUICK, BYTE, BYTE_DATA, WORD_DATA, I2C_BLOCK_DATA = 0, 1, 2, 3, 8
MOST_MESSAGES = 42  # I2C_RDWR_IOCTL_MAX_MSGS
LONGEST_MESSAGE = 8192

READ_SIZE = 1 << 17
PREFIX = "imu-cal-i2c-"
NOSUID_NODEV_NOEXEC = 2 | 4 | 8
DETACH = 2


class FuseBus:
    """Serves an `EmulatedBus` as ``folder/i2c-N`` from a thread, until it is closed.

    Parameters
    ----------
    bus : EmulatedBus
    number : int
        N in the file's name.
    link : bool
        Also make ``/dev/i2c-N`` point to it, if nothing of that name exists; never replaces one.
    """

    def __init__(self, bus: EmulatedBus, *, number: int = 1, link: bool = False) -> None:
        self.bus = bus
        self.number = number
        self.link = Path(f"/dev/i2c-{number}") if link else None
        self.folder: Path | None = None
        self._linked = False
        self._descriptor = -1
        self._thread: threading.Thread | None = None
        self._places: dict[int, int] = {}
        self._next_handle = 1
        self._handlers: dict[int, Callable[[int, bytes, int], bytes]] = {
            LOOKUP: self._lookup,
            GETATTR: self._getattr,
            OPEN: self._open_file,
            OPENDIR: lambda node, body, pid: struct.pack("=QII", 0, 0, 0),
            READDIR: self._readdir,
            READ: self._read_file,
            WRITE: self._write_file,
            IOCTL: self._ioctl,
            RELEASE: self._release,
            RELEASEDIR: lambda node, body, pid: b"",
            FLUSH: lambda node, body, pid: b"",
            ACCESS: lambda node, body, pid: b"",
            STATFS: lambda node, body, pid: bytes(80),
            INIT: self._init,
        }

    @property
    def path(self) -> Path:
        """The bus file."""
        assert self.folder is not None
        return self.folder / f"i2c-{self.number}"

    def open(self) -> None:
        """Mount it and start serving.

        Raises
        ------
        DevicePermissionError
            If /dev/fuse is missing or may not be used; see `unavailable`.
        DeviceBusyError
            If a link was asked for and something of its name exists.
        """
        reason = unavailable()
        if reason:
            raise DevicePermissionError(f"cannot make an emulated I2C bus: {reason}")
        if self.link is not None and os.path.lexists(self.link):
            raise DeviceBusyError(f"{self.link} exists and is not replaced; choose another number")
        _sweep()
        self.folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        self._descriptor = os.open("/dev/fuse", os.O_RDWR | os.O_CLOEXEC)
        options = f"fd={self._descriptor},rootmode=40755,user_id=0,group_id=0,allow_other"
        try:
            _libc_call(
                "mount",
                b"imu-cal",
                os.fsencode(self.folder),
                b"fuse.imu-cal",
                ctypes.c_ulong(NOSUID_NODEV_NOEXEC),
                options.encode(),
            )
        except OSError as error:
            os.close(self._descriptor)
            self.folder.rmdir()
            raise DriverError(f"cannot mount an emulated I2C bus: {error.strerror}") from error
        self._thread = threading.Thread(target=self._serve, name="fuse-i2c", daemon=True)
        self._thread.start()
        if self.link is not None:
            self.link.symlink_to(self.path)
            self._linked = True

    def close(self) -> None:
        """Unmount it and remove what was made. Closing twice is harmless."""
        if self._linked and self.link is not None and self.link.is_symlink():
            self.link.unlink()
        self._linked = False
        if self.folder is None:
            return
        try:
            _libc_call("umount2", os.fsencode(self.folder), DETACH)
        except OSError as error:
            raise DriverError(f"cannot unmount {self.folder}: {error.strerror}") from error
        if self._thread is not None:
            self._thread.join(timeout=5)
        os.close(self._descriptor)
        self.folder.rmdir()
        self.folder = None

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # ---- the FUSE protocol ----

    def _serve(self) -> None:
        while True:
            try:
                request = os.read(self._descriptor, READ_SIZE)
            except OSError as error:
                if error.errno in (errno.EINTR, errno.EAGAIN, errno.ENOENT):
                    continue  # ENOENT: the request was interrupted before we read it
                return  # ENODEV: unmounted
            length, opcode, unique, node, _, _, pid, _ = IN_HEADER.unpack_from(request)
            body = request[IN_HEADER.size : length]
            if opcode in (FORGET, BATCH_FORGET, INTERRUPT):
                continue  # these take no answer
            handler = self._handlers.get(opcode)
            try:
                if handler is None:
                    raise OSError(errno.ENOSYS, "not served")
                answer, code = handler(node, body, pid), 0
            except OSError as error:
                answer, code = b"", -(error.errno or errno.EIO)
            header = OUT_HEADER.pack(OUT_HEADER.size + len(answer), code, unique)
            try:
                os.write(self._descriptor, header + answer)
            except OSError as error:
                if error.errno == errno.ENODEV:
                    return
                # ENOENT: the caller was killed meanwhile, and waits no more.
            if opcode == DESTROY:
                return

    def _init(self, node: int, body: bytes, pid: int) -> bytes:
        _, minor, readahead, _ = struct.unpack_from("=IIII", body)
        reply = struct.pack(
            "=IIIIHHIIHHI28x", 7, min(minor, 31), readahead, 0, 12, 9, READ_SIZE // 2, 1, 0, 0, 0
        )
        return reply

    def _attributes(self, node: int) -> bytes:
        mode = stat.S_IFDIR | 0o755 if node == ROOT else stat.S_IFREG | 0o666
        times = (0,) * 3 + (0,) * 3
        return ATTRIBUTES.pack(node, 0, 0, *times[:3], *times[3:], mode, 1, 0, 0, 0, 512, 0)

    def _lookup(self, node: int, body: bytes, pid: int) -> bytes:
        if node != ROOT or body.rstrip(b"\0") != f"i2c-{self.number}".encode():
            raise OSError(errno.ENOENT, "no such file")
        return struct.pack("=QQQQII", FILE, 0, 1, 1, 0, 0) + self._attributes(FILE)

    def _getattr(self, node: int, body: bytes, pid: int) -> bytes:
        return struct.pack("=QII", 1, 0, 0) + self._attributes(node)

    def _open_file(self, node: int, body: bytes, pid: int) -> bytes:
        handle = self._next_handle
        self._next_handle += 1
        self._places[handle] = 0
        return struct.pack("=QII", handle, DIRECT_IO, 0)

    def _release(self, node: int, body: bytes, pid: int) -> bytes:
        self._places.pop(struct.unpack_from("=Q", body)[0], None)
        return b""

    def _readdir(self, node: int, body: bytes, pid: int) -> bytes:
        offset = struct.unpack_from("=QQ", body)[1]
        names = [(ROOT, b"."), (ROOT, b".."), (FILE, f"i2c-{self.number}".encode())]
        out = b""
        for k, (inode, name) in list(enumerate(names))[offset:]:
            kind = (stat.S_IFREG if inode == FILE else stat.S_IFDIR) >> 12
            entry = DIRECTORY_ENTRY.pack(inode, k + 1, len(name), kind) + name
            out += entry + bytes(-len(entry) % 8)
        return out

    def _read_file(self, node: int, body: bytes, pid: int) -> bytes:
        handle, _, size = struct.unpack_from("=QQI", body)
        return self.bus.transfer(Message(self._places[handle], count=size))[0]

    def _write_file(self, node: int, body: bytes, pid: int) -> bytes:
        handle, _, size = struct.unpack_from("=QQI", body)
        self.bus.transfer(Message(self._places[handle], body[40 : 40 + size]))
        return struct.pack("=II", size, 0)

    # ---- the I2C ioctls ----

    def _ioctl(self, node: int, body: bytes, pid: int) -> bytes:
        handle, _, command, argument = struct.unpack_from("=QIIQ", body)
        result = 0
        if command in (I2C_SLAVE, I2C_SLAVE_FORCE):
            if argument > 0x7F:
                raise OSError(errno.EINVAL, "not a 7-bit address")
            self._places[handle] = argument
        elif command == I2C_FUNCS:
            _store(pid, argument, struct.pack("@L", FUNCTIONS))
        elif command == I2C_RDWR:
            result = self._rdwr(pid, argument)
        elif command == I2C_SMBUS:
            self._smbus(pid, argument, self._places[handle])
        elif command not in (I2C_RETRIES, I2C_TIMEOUT) and not (
            command in (I2C_TENBIT, I2C_PEC) and argument == 0
        ):
            raise OSError(errno.ENOTTY, "not served")
        return struct.pack("=iIII", result, 0, 0, 0)

    def _rdwr(self, pid: int, argument: int) -> int:
        array, count = RDWR.unpack(_fetch(pid, argument, RDWR.size))
        if not 0 < count <= MOST_MESSAGES:
            raise OSError(errno.EINVAL, "number of messages")
        raw = _fetch(pid, array, count * I2C_MESSAGE.size)
        messages, buffers = [], []
        for address, flags, length, buffer in I2C_MESSAGE.iter_unpack(raw):
            if length > LONGEST_MESSAGE or flags & ~I2C_M_RD:
                raise OSError(errno.EINVAL, "message")
            if flags & I2C_M_RD:
                messages.append(Message(address, count=length))
            else:
                messages.append(Message(address, _fetch(pid, buffer, length)))
            buffers.append(buffer)
        for buffer, data in zip(buffers, self.bus.transfer(*messages), strict=True):
            if data:
                _store(pid, buffer, data)
        return int(count)

    def _smbus(self, pid: int, argument: int, place: int) -> None:
        reads, command, size, data = SMBUS.unpack(_fetch(pid, argument, SMBUS.size))
        register = bytes([command])
        if size == QUICK:
            self.bus.transfer(Message(place, b""))
        elif size == BYTE and not reads:
            self.bus.transfer(Message(place, register))
        elif size == BYTE:
            _store(pid, data, self.bus.transfer(Message(place, count=1))[0])
        elif size in (BYTE_DATA, WORD_DATA):
            length = 1 if size == BYTE_DATA else 2
            if reads:
                _store(pid, data, self.bus.read(place, command, length))
            else:
                self.bus.write(place, command, _fetch(pid, data, length))
        elif size == I2C_BLOCK_DATA:
            length = _fetch(pid, data, 1)[0]
            if not 0 < length <= 32:
                raise OSError(errno.EINVAL, "block length")
            if reads:
                _store(pid, data + 1, self.bus.read(place, command, length))
            else:
                self.bus.write(place, command, _fetch(pid, data + 1, length))
        else:
            raise OSError(errno.EOPNOTSUPP, "this SMBus call is not served")


def unavailable() -> str:
    """Return why the rig cannot run here, or '' if it can."""
    if not sys.platform.startswith("linux"):
        return f"it needs Linux, this is {sys.platform}"
    if not os.path.exists("/dev/fuse"):
        return "/dev/fuse is missing (load the fuse module; in a container, pass the device in)"
    if os.geteuid() != 0:
        return "it needs root, to mount and to reach into the caller's memory"
    return ""


def _sweep() -> None:
    """Remove the mounts of servers that were killed: they answer with ENOTCONN."""
    for line in Path("/proc/mounts").read_text(encoding="utf-8").splitlines():
        source, folder, kind, *_ = line.split()
        if (source, kind) != ("imu-cal", "fuse.imu-cal"):
            continue
        try:
            os.stat(folder)
        except OSError as error:
            if error.errno == errno.ENOTCONN:
                _libc_call("umount2", os.fsencode(folder), DETACH)
                os.rmdir(folder)


# ---- the C library, and the caller's memory ----


class _IoVector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


@cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _libc_call(name: str, *arguments: object) -> int:
    result = int(getattr(_libc(), name)(*arguments))
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return result


def _fetch(pid: int, address: int, count: int) -> bytes:
    buffer = ctypes.create_string_buffer(count)
    _copy("process_vm_readv", pid, buffer, address, count)
    return buffer.raw


def _store(pid: int, address: int, data: bytes) -> None:
    buffer = ctypes.create_string_buffer(data, len(data))
    _copy("process_vm_writev", pid, buffer, address, len(data))


def _copy(call: str, pid: int, buffer: ctypes.Array[ctypes.c_char], address: int, n: int) -> None:
    if n == 0:
        return
    local = _IoVector(ctypes.addressof(buffer), n)
    remote = _IoVector(address, n)
    one, none = ctypes.c_ulong(1), ctypes.c_ulong(0)
    done = _libc_call(call, pid, ctypes.byref(local), one, ctypes.byref(remote), one, none)
    if done != n:
        raise OSError(errno.EFAULT, os.strerror(errno.EFAULT))
