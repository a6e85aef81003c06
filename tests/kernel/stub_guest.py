"""What runs inside the user-mode-linux guest: our driver on the kernel's own i2c-core.

``i2c-stub`` is an SMBus adapter that remembers registers: it is loaded with those of the chip model
while it holds a sample. Prints one JSON document.
"""

from __future__ import annotations

import json
import struct
import sys

import smbus2

from calib.errors import DriverError
from drivers.emulators.base import EmulatorOptions
from drivers.emulators.i2c_chips import make_model
from drivers.flash import make_target
from drivers.flash.i2c import I2CTarget
from drivers.i2c_scan import scan_buses
from drivers.transports import open_driver

SAMPLE = (1000, -2000, 8192, -3540, 131, -262, 393)
URL = "i2c://0/0x68?chip=mpu6050&rate=100&fifo=off"


def main() -> None:
    model = make_model("mpu6050", EmulatorOptions(seed=1))
    image = bytearray(model._page(0))
    image[0x3B:0x49] = struct.pack(">7h", *SAMPLE)
    image[0x3A] = 0x01  # INT_STATUS: data ready, for ever
    image[0x72:0x74] = 0, 112  # FIFO_COUNT: eight samples, for ever
    out: dict[str, object] = {}
    with smbus2.SMBus(0) as bus:
        out["functions"] = bus.funcs
        for register, value in enumerate(image):
            bus.write_byte_data(0x68, register, value)
    out["scan"] = [(found.address, found.chip) for found in scan_buses()]
    with open_driver(URL) as driver:
        batch = driver.read(2.0)
        assert batch is not None
        info = driver.info
        out["chip"] = info.chip
        out["accel"] = (batch.accel[0] / info.accel_lsb).tolist()
        out["gyro"] = (batch.gyro[0] / info.gyro_lsb).tolist()
        out["temperature"] = float(batch.temperature[0])  # type: ignore[index]
    target = make_target(URL)
    assert isinstance(target, I2CTarget)
    with target:
        old = target.read()
        new = dict(old) | {"XG_OFFSET_H": 0x12, "XG_OFFSET_L": 0x34}
        target.write(new)
        out["flash"] = target.read() == new
        target.write(old)
    try:
        open_driver("i2c://0/0x68?chip=mpu6050&rate=100").read(1.0)
        out["fifo"] = ""
    except DriverError as error:
        out["fifo"] = str(error)
    try:
        open_driver("i2c://0/0x69?chip=mpu6050")
        out["absent"] = ""
    except DriverError as error:
        out["absent"] = str(error)
    sys.stdout.write("RESULT " + json.dumps(out) + "\n")


if __name__ == "__main__":
    main()
