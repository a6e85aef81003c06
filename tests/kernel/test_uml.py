"""The driver on a real kernel, in user-mode-linux: i2c-core with i2c-stub, and a CUSE device.

Needs Debian's user-mode-linux package (and busybox to switch the guest off); the guest sees this
file system read-only.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
KERNEL, BUSYBOX = shutil.which("linux.uml"), shutil.which("busybox")

pytestmark = [
    pytest.mark.kernel,
    pytest.mark.skipif(
        not (KERNEL and BUSYBOX and os.geteuid() == 0),
        reason="needs root and the packages user-mode-linux and busybox-static",
    ),
]

INIT = """#!/bin/sh
mount -t proc proc /proc
mount -t sysfs sys /sys
[ -e /dev/null ] || mount -t devtmpfs dev /dev
mount -t tmpfs tmp /run
modules=/usr/lib/uml/modules/$(uname -r)/kernel
{modules}
cd {root}
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={root} {python} -m tests.kernel.{guest} 2>&1
{busybox} poweroff -f
"""


STUB = """insmod $modules/drivers/i2c/i2c-core.ko
insmod $modules/drivers/i2c/i2c-dev.ko
insmod $modules/drivers/i2c/i2c-stub.ko chip_addr=0x68"""
CUSE = """insmod $modules/fs/fuse/fuse.ko
insmod $modules/fs/fuse/cuse.ko
[ -e /dev/cuse ] || mknod /dev/cuse c 10 $(grep cuse /proc/misc | cut -d' ' -f1)"""


def boot(folder: Path, guest: str, modules: str) -> dict[str, object]:
    """Run a guest's script and return what it printed."""
    init = folder / "init"
    words = {"root": ROOT, "python": sys.executable, "busybox": BUSYBOX}
    init.write_text(INIT.format(modules=modules, guest=guest, **words))
    init.chmod(0o755)
    command = [str(KERNEL), "mem=512M", "rootfstype=hostfs", "rootflags=/", "ro", f"init={init}"]
    command += ["con=null", "con0=null,fd:1", "quiet"]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT ")]
    assert lines, f"the guest said:\n{done.stdout[-3000:]}\n{done.stderr[-1000:]}"
    found: dict[str, object] = json.loads(lines[0].removeprefix("RESULT "))
    return found


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    return boot(tmp_path_factory.mktemp("uml"), "stub_guest", STUB)


def test_a_character_device_does_i2c_rdwr_and_the_fifo(tmp_path: Path) -> None:
    found = boot(tmp_path, "cuse_guest", CUSE)
    assert found["character_device"] is True
    assert found["identity"] == found["long"] == 0x68
    assert found["absent"] == "EREMOTEIO"
    assert isinstance(found["fifo"], int)
    assert found["fifo"] >= 2000
    # A guest on a busy machine may stall: then it is counted.
    assert (found["lost"] == 0) == (found["overflows"] == 0)


def test_the_adapter_has_smbus_calls_only(result: dict[str, object]) -> None:
    functions = result["functions"]
    assert isinstance(functions, int)
    assert not functions & 1  # I2C_FUNC_I2C


def test_scan_finds_the_chip(result: dict[str, object]) -> None:
    assert result["scan"] == [[0x68, "MPU-6050"]]


def test_a_burst_of_the_data_registers_becomes_a_sample(result: dict[str, object]) -> None:
    assert result["chip"] == "MPU-6050"
    assert result["accel"] == pytest.approx([1000, -2000, 8192])
    assert result["gyro"] == pytest.approx([131, -262, 393])
    assert result["temperature"] == pytest.approx(-3540 / 340 + 36.53)


def test_bias_registers_are_written_and_read_back(result: dict[str, object]) -> None:
    assert result["flash"] is True


def test_what_smbus_cannot_do_is_said(result: dict[str, object]) -> None:
    fifo = result["fifo"]
    assert isinstance(fifo, str)
    assert "fifo=off" in fifo


def test_an_empty_address_is_named(result: dict[str, object]) -> None:
    absent = result["absent"]
    assert isinstance(absent, str)
    assert "nothing answers at 0x69" in absent
