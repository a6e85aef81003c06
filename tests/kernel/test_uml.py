"""The driver on a real kernel's i2c-core, i2c-dev and i2c-stub, in user-mode-linux.

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
modules=/usr/lib/uml/modules/$(uname -r)/kernel/drivers/i2c
insmod $modules/i2c-core.ko
insmod $modules/i2c-dev.ko
insmod $modules/i2c-stub.ko chip_addr=0x68
cd {root}
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={root} {python} -m tests.kernel.uml_guest 2>&1
{busybox} poweroff -f
"""


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    init = tmp_path_factory.mktemp("uml") / "init"
    init.write_text(INIT.format(root=ROOT, python=sys.executable, busybox=BUSYBOX))
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
