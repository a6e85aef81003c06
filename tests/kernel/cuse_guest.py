"""What runs inside user-mode-linux with CUSE: a real character device, our chip behind it.

The emulated bus answers the same protocol as over FUSE, on /dev/cuse, as ``/dev/i2c-7``. Prints one
JSON document.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import struct
import sys
import threading
import time

import smbus2

from drivers.emulators.base import EmulatorOptions
from drivers.emulators.fuse_bus import IN_HEADER, OUT_HEADER, READ_SIZE, FuseBus
from drivers.emulators.i2c_bus import EmulatedBus
from drivers.emulators.i2c_chips import make_model
from drivers.transports import open_driver

CUSE_INIT = 4096
UNRESTRICTED_IOCTL = 1


class CuseBus(FuseBus):
    """Serves the bus as a character device instead of a file."""

    def open(self) -> None:
        self._descriptor = os.open("/dev/cuse", os.O_RDWR | os.O_CLOEXEC)
        request = os.read(self._descriptor, READ_SIZE)
        _, opcode, unique, *_ = IN_HEADER.unpack_from(request)
        assert opcode == CUSE_INIT
        body = struct.pack("=8I40x", 7, 31, 0, UNRESTRICTED_IOCTL, 1 << 16, 1 << 16, 0, 0)
        body += f"DEVNAME=i2c-{self.number}\0".encode()
        os.write(self._descriptor, OUT_HEADER.pack(OUT_HEADER.size + len(body), 0, unique) + body)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()


def main() -> None:
    out: dict[str, object] = {}
    bus = CuseBus(EmulatedBus({0x68: make_model("mpu6050", EmulatorOptions(seed=1))}), number=7)
    bus.open()
    path = "/dev/i2c-7"
    while not os.path.exists(path):
        time.sleep(0.01)
    out["character_device"] = stat.S_ISCHR(os.stat(path).st_mode)
    with smbus2.SMBus(7) as plain:
        out["identity"] = plain.read_byte_data(0x68, 0x75)
        write, read = smbus2.i2c_msg.write(0x68, [0x00]), smbus2.i2c_msg.read(0x68, 118)
        plain.i2c_rdwr(write, read)
        out["long"] = list(read)[0x75]
        try:
            plain.read_byte_data(0x69, 0x75)
        except OSError as error:
            out["absent"] = errno.errorcode[error.errno or 0]
    begin, got, lost = time.monotonic(), 0, 0
    with open_driver("i2c://7/0x68?chip=mpu6050&rate=1000") as driver:
        while got < 2000 and time.monotonic() - begin < 20:
            batch = driver.read(1.0)
            if batch is not None:
                got += len(batch)
                lost += batch.samples_lost
        out["fifo"] = got
        out["lost"] = lost
        out["overflows"] = driver.counters["fifo_overflows"]
    sys.stdout.write("RESULT " + json.dumps(out) + "\n")
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
