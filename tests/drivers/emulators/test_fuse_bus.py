"""The FUSE rig: unmodified smbus2, through ioctl(2), to a chip model."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calib.calibration import Calibration, Gravity
from calib.errors import DeviceBusyError, DeviceLostError, FlashError, WrongDeviceError
from calib.model import SensorModel
from drivers.driver import Driver
from drivers.emulators import emulators
from drivers.emulators.base import EmulatorOptions
from drivers.emulators.fuse_bus import FuseBus, unavailable
from drivers.emulators.i2c_bus import EmulatedBus, Message, fail_at
from drivers.emulators.i2c_chips import make_model
from drivers.flash import make_target
from drivers.flash.procedure import flash_device
from drivers.i2c_scan import scan_buses
from drivers.transports import open_driver

REASON = unavailable()
pytestmark = pytest.mark.skipif(bool(REASON), reason=f"no FUSE bus here: {REASON}")

if not REASON:
    import smbus2


@pytest.fixture
def served() -> Iterator[FuseBus]:
    models = {
        0x68: make_model("mpu6050", EmulatorOptions(seed=1)),
        0x69: make_model("mpu9250", EmulatorOptions(seed=2)),
    }
    with FuseBus(EmulatedBus(models), number=7) as bus:
        yield bus


def read_for_ever(driver: Driver) -> None:
    while True:
        driver.read(1.0)


def test_every_call_of_smbus2_that_imus_need(served: FuseBus) -> None:
    with smbus2.SMBus(str(served.path)) as bus:
        assert bus.funcs & smbus2.I2cFunc.I2C
        assert bus.read_byte_data(0x68, 0x75) == 0x68
        assert bus.read_byte_data(0x69, 0x75) == 0x71
        bus.write_byte_data(0x68, 0x19, 0xA5)
        assert bus.read_byte_data(0x68, 0x19) == 0xA5
        bus.write_i2c_block_data(0x68, 0x13, [1, 2, 3, 4, 5, 6])
        assert bus.read_i2c_block_data(0x68, 0x13, 6) == [1, 2, 3, 4, 5, 6]
        assert bus.read_word_data(0x68, 0x13) == 0x0201
        bus.write_word_data(0x68, 0x13, 0x1234)
        assert bus.read_i2c_block_data(0x68, 0x13, 2) == [0x34, 0x12]
        bus.write_byte(0x68, 0x75)
        assert bus.read_byte(0x68) == 0x68
        bus.write_quick(0x68)
        write = smbus2.i2c_msg.write(0x68, [0x00])
        read = smbus2.i2c_msg.read(0x68, 200)
        bus.i2c_rdwr(write, read)
        assert list(read)[0x13:0x15] == [0x34, 0x12]
        with pytest.raises(OSError, match="not supported") as error:
            bus.read_block_data(0x68, 0x00)
        assert error.value.errno == errno.EOPNOTSUPP
        with pytest.raises(OSError) as error:
            bus.read_byte_data(0x6A, 0x75)
        assert error.value.errno == errno.EREMOTEIO


def test_plain_read_and_write(served: FuseBus) -> None:
    import fcntl

    handle = os.open(served.path, os.O_RDWR)
    try:
        fcntl.ioctl(handle, 0x703, 0x68)
        os.write(handle, b"\x75")
        assert os.read(handle, 1) == b"\x68"
        with pytest.raises(OSError) as error:
            fcntl.ioctl(handle, 0x703, 0x80)
        assert error.value.errno == errno.EINVAL
        with pytest.raises(OSError) as error:
            fcntl.ioctl(handle, 0x12345678 & 0xFFFF, 0)
        assert error.value.errno == errno.ENOTTY
    finally:
        os.close(handle)


def test_another_process_uses_it(served: FuseBus) -> None:
    code = (
        "import smbus2, sys\n"
        "with smbus2.SMBus(sys.argv[1]) as bus:\n"
        "    print(hex(bus.read_byte_data(0x69, 0x75)))\n"
    )
    out = subprocess.run(
        [sys.executable, "-c", code, str(served.path)], capture_output=True, text=True, timeout=20
    )
    assert out.stdout.strip() == "0x71", out.stderr


@pytest.mark.parametrize("code", [errno.EIO, errno.ETIMEDOUT, errno.EREMOTEIO, errno.EAGAIN])
def test_any_errno_can_be_injected(served: FuseBus, code: int) -> None:
    served.bus.fault = fail_at(7, code)
    with smbus2.SMBus(str(served.path)) as bus:
        for _ in range(6):
            bus.read_byte_data(0x68, 0x75)
        with pytest.raises(OSError) as error:
            bus.read_byte_data(0x68, 0x75)
        assert error.value.errno == code
        assert bus.read_byte_data(0x68, 0x75) == 0x68


def test_the_driver_reads_the_fifo_at_1_khz(served: FuseBus) -> None:
    with open_driver(f"i2c://{served.path}/0x68?chip=mpu6050&rate=1000") as driver:
        got = lost = 0
        while got < 300:
            batch = driver.read(1.0)
            assert batch is not None
            got += len(batch)
            lost += batch.samples_lost
            assert batch.clock == "host"
        # Nothing is lost that is not counted; a loaded machine may well overflow.
        assert (lost > 0) == (driver.counters["fifo_overflows"] > 0)


def test_a_consumer_that_stalls_loses_nothing(served: FuseBus) -> None:
    """A slow disk holds the recorder up for longer than the FIFO lasts (0.5 s here, 0.36 s)."""
    with open_driver(f"i2c://{served.path}/0x68?chip=mpu6050&rate=200") as driver:
        first = driver.read(2.0)
        assert first is not None
        time.sleep(0.5)
        batch = driver.read(1.0)
        assert batch is not None
        assert len(batch) > 73
        assert (batch.samples_lost > 0) == (driver.counters["fifo_overflows"] > 0)


def test_wrong_device_and_lost_device(served: FuseBus) -> None:
    with pytest.raises(WrongDeviceError, match="it is an MPU-9250"):
        open_driver(f"i2c://{served.path}/0x69?chip=mpu6050")
    with open_driver(f"i2c://{served.path}/0x68?chip=auto&rate=100") as driver:
        served.bus.fault = fail_at(1, errno.EREMOTEIO, stays=True)
        served.bus.transactions = 0
        with pytest.raises(DeviceLostError, match="stopped answering"):
            read_for_ever(driver)


def test_second_user_is_told_who_has_it(served: FuseBus) -> None:
    url = f"i2c://{served.path}/0x68?rate=100"
    code = (
        "import sys\n"
        "from drivers.transports import open_driver\n"
        "from calib.errors import DriverError\n"
        "try:\n"
        "    open_driver(sys.argv[1])\n"
        "except DriverError as error:\n"
        "    print(type(error).__name__, error)\n"
    )
    with open_driver(url):
        out = subprocess.run(
            [sys.executable, "-c", code, url], capture_output=True, text=True, timeout=20
        )
    assert out.stdout.startswith("DeviceBusyError"), out.stderr
    assert f"process {os.getpid()}" in out.stdout


def test_scan_lists_what_answers(served: FuseBus) -> None:
    assert served.folder is not None
    found = scan_buses(served.folder)
    assert [(f.address, f.chip) for f in found] == [(0x68, "MPU-6050"), (0x69, "MPU-9250")]
    with open_driver(found[0].url) as driver:
        assert driver.info.chip == "MPU-6050"


def test_link_is_made_only_where_nothing_is_and_is_removed(tmp_path: Path) -> None:
    bus = EmulatedBus({0x68: make_model("mpu6050", EmulatorOptions())})
    number = next(n for n in range(40, 99) if not os.path.lexists(f"/dev/i2c-{n}"))
    with FuseBus(bus, number=number, link=True):
        with smbus2.SMBus(number) as plain:
            assert plain.read_byte_data(0x68, 0x75) == 0x68
        other = FuseBus(bus, number=number, link=True)
        with pytest.raises(DeviceBusyError, match="exists and is not replaced"):
            other.open()
        assert os.path.islink(f"/dev/i2c-{number}")
    assert not os.path.lexists(f"/dev/i2c-{number}")


def test_close_leaves_nothing_behind(served: FuseBus) -> None:
    folder = served.folder
    assert folder is not None
    served.close()
    assert not folder.exists()
    assert str(folder) not in Path("/proc/mounts").read_text(encoding="utf-8")
    served.close()


def test_the_mount_of_a_killed_server_is_swept_away() -> None:
    code = (
        "import os\n"
        "from drivers.emulators.fuse_bus import FuseBus\n"
        "from drivers.emulators.i2c_bus import EmulatedBus\n"
        "bus = FuseBus(EmulatedBus({}))\n"
        "bus.open()\n"
        "print(bus.folder, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    killed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    folder = killed.stdout.strip()
    with pytest.raises(OSError) as error:
        os.stat(folder)
    assert error.value.errno == errno.ENOTCONN
    with FuseBus(EmulatedBus({})):
        pass
    assert folder not in Path("/proc/mounts").read_text(encoding="utf-8")
    assert not os.path.lexists(folder)


def test_flashing_through_smbus2_and_a_write_that_fails(served: FuseBus, tmp_path: Path) -> None:
    model = served.bus.models[0x68].source(200.0).model
    bare = SensorModel(model.accel, model.gyro)
    names = ("gyro.bias.x", "gyro.bias.y", "gyro.bias.z")
    calibration = Calibration(bare, names, np.eye(3) * 1e-10, (), Gravity(9.80665))
    with make_target(f"i2c://{served.path}/0x68?chip=mpu6050&rate=500") as target:
        old = target.read()
        writes = 0

        def fault(number: int, messages: tuple[Message, ...]) -> int | None:
            nonlocal writes
            data = messages[0].data
            writes += len(messages) == 1 and len(data) > 1 and 0x06 <= data[0] <= 0x18
            return errno.EIO if writes == 7 else None

        def flash(name: str) -> None:
            flash_device(
                target,
                calibration,
                backup=tmp_path / name,
                persist=False,
                duration=0.5,
                report=lambda text: None,
            )

        served.bus.fault = fault
        with pytest.raises(FlashError, match="The old values are back"):
            flash("first.json")
        assert target.read() == old
        served.bus.fault = None
        flash("second.json")
        assert target.read() != old


def test_emulate_serves_until_it_is_stopped() -> None:
    stop, ready, address = threading.Event(), threading.Event(), []

    def announce(url: str) -> None:
        address.append(url)
        ready.set()

    options = EmulatorOptions(rate=200, seed=4)
    thread = threading.Thread(target=emulators()["mpu6050"].serve, args=(options, announce, stop))
    thread.start()
    try:
        assert ready.wait(10)
        with open_driver(address[0]) as driver:
            assert driver.info.rate == 200
            assert driver.read(2.0) is not None
    finally:
        stop.set()
        thread.join(10)
    assert not thread.is_alive()
