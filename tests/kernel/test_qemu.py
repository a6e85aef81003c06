"""The kernel's own inv_mpu6050 driver reads our chip model: an independent check of the model.

Needs QEMU, busybox-static, cpio, kmod and a Debian kernel package; IMU_CAL_KERNEL names the folder
that it was unpacked to (dpkg -x linux-image-*.deb FOLDER), with boot/ and lib/modules/ in it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from usbredir import TinyUsb

from drivers.emulators.base import EmulatorOptions
from drivers.emulators.i2c_bus import EmulatedBus
from drivers.emulators.i2c_chips import make_model

TOOLS = ("qemu-system-x86_64", "busybox", "cpio", "depmod", "modprobe")
FOLDER = Path(os.environ.get("IMU_CAL_KERNEL", "/"))
KERNELS = sorted(FOLDER.glob("boot/vmlinuz-*"))
MISSING = [tool for tool in TOOLS if shutil.which(tool) is None]
REASON = (
    f"missing: {', '.join(MISSING)}"
    if MISSING
    else ("" if KERNELS else "no kernel: unpack a linux-image package and set IMU_CAL_KERNEL")
)

pytestmark = [pytest.mark.kernel, pytest.mark.skipif(bool(REASON), reason=REASON)]

MODULES = ("uhci-hcd", "i2c-tiny-usb", "inv-mpu6050-i2c")
INIT = """#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t proc proc /proc; mount -t sysfs sys /sys
for module in $(cat /modules); do insmod $module || echo "insmod $module failed"; done
n=0; while [ $n -lt 100 ] && ! grep -qs tiny /sys/bus/i2c/devices/i2c-*/name; do
  sleep 0.1; n=$((n + 1)); done
bus=$(dirname $(grep -ls tiny /sys/bus/i2c/devices/i2c-*/name))
echo mpu6050 0x68 > $bus/new_device
cd /sys/bus/iio/devices/iio:device0 || { dmesg | tail -30; poweroff -f; }
for k in 1 2 3 4 5 6 7 8 9 10; do
  for f in in_accel_x_raw in_accel_y_raw in_accel_z_raw in_anglvel_x_raw in_anglvel_y_raw \
           in_anglvel_z_raw in_temp_raw; do echo "VALUE $f $(cat $f)"; done
done
for f in name in_accel_scale in_anglvel_scale in_temp_scale in_temp_offset in_accel_x_calibbias \
         in_anglvel_x_calibbias; do echo "VALUE $f $(cat $f)"; done
echo 1000 > in_anglvel_x_calibbias
for k in 1 2 3 4 5 6 7 8 9 10; do echo "VALUE biased $(cat in_anglvel_x_raw)"; done
poweroff -f
"""


def build_initrd(folder: Path, kernel: Path) -> Path:
    """Return an initial file system with busybox, the modules and our init."""
    version = kernel.name.removeprefix("vmlinuz-")
    root = folder / "root"
    for name in ("bin", "proc", "sys", "lib"):
        (root / name).mkdir(parents=True)
    shutil.copy(str(shutil.which("busybox")), root / "bin/busybox")
    tree = folder / "tree/lib/modules"
    tree.mkdir(parents=True)
    shutil.copytree(FOLDER / "lib/modules" / version, tree / version, symlinks=True)
    subprocess.run(["depmod", "-b", str(folder / "tree"), version], check=True)
    listed: list[str] = []
    for module in MODULES:
        command = ["modprobe", "-d", str(folder / "tree"), "-S", version, "--show-depends", module]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        paths = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("insmod")]
        listed += [path for path in paths if path not in listed]
    names = []
    for path in listed:
        shutil.copy(path, root / "lib")
        names.append(f"/lib/{Path(path).name}")
    (root / "modules").write_text("\n".join(names))
    (root / "init").write_text(INIT)
    (root / "init").chmod(0o755)
    image = folder / "initrd"
    files = "\n".join(str(p.relative_to(root)) for p in [root, *root.rglob("*")])
    with image.open("wb") as out:
        subprocess.run(
            ["cpio", "-o", "-H", "newc", "--quiet"],
            input=files.encode(),
            stdout=out,
            cwd=root,
            check=True,
        )
    return image


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    folder = tmp_path_factory.mktemp("qemu")
    kernel = KERNELS[-1]
    initrd = build_initrd(folder, kernel)
    model = make_model("mpu6050", EmulatorOptions(seed=6))
    usb = TinyUsb(EmulatedBus({0x68: model}), folder / "usb.sock")
    command = ["qemu-system-x86_64", "-accel", "tcg", "-m", "256", "-nographic", "-no-reboot"]
    command += ["-kernel", str(kernel), "-initrd", str(initrd)]
    command += ["-append", "console=ttyS0 quiet panic=-1"]
    command += [
        "-device",
        "piix3-usb-uhci",
        "-chardev",
        f"socket,id=usb,path={folder / 'usb.sock'}",
    ]
    command += ["-device", "usb-redir,chardev=usb"]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=200
    )
    usb.close()
    out: dict[str, list[str]] = {}
    for line in done.stdout.splitlines():
        words = line.strip().split()
        if words[:1] == ["VALUE"]:
            out.setdefault(words[1], []).append(" ".join(words[2:]))
    assert "in_accel_x_raw" in out, f"{done.stdout[-3000:]}\n{done.stderr[-1000:]}"
    return out


def mean(seen: dict[str, list[str]], name: str) -> float:
    return float(np.mean([float(value) for value in seen[name]]))


def test_the_driver_binds(seen: dict[str, list[str]]) -> None:
    assert seen["name"] == ["mpu6050"]


def test_it_reads_what_the_sensor_measures(seen: dict[str, list[str]]) -> None:
    source = make_model("mpu6050", EmulatorOptions(seed=6)).source(50.0)
    true = source.model.distort(source.state)
    for triad, values, sigma in (
        ("in_accel", true.accel[0], source._sigma[0]),
        ("in_anglvel", true.gyro[0], source._sigma[3]),
    ):
        scale = float(seen[f"{triad}_scale"][0])
        for k, axis in enumerate("xyz"):
            got = mean(seen, f"{triad}_{axis}_raw") * scale
            # Rates may differ from 50 Hz, so allow ten times its noise, and a count.
            assert got == pytest.approx(values[k], abs=10 * sigma + scale)


def test_it_reads_the_temperature(seen: dict[str, list[str]]) -> None:
    offset, scale = float(seen["in_temp_offset"][0]), float(seen["in_temp_scale"][0])
    assert (mean(seen, "in_temp_raw") + offset) * scale / 1000 == pytest.approx(25, abs=0.2)


def test_its_bias_register_shifts_our_output(seen: dict[str, list[str]]) -> None:
    """1000 counts of 1/32.8 °/s, seen at ±2000 °/s (16.4 counts per °/s)."""
    shift = mean(seen, "biased") - mean(seen, "in_anglvel_x_raw")
    assert shift == pytest.approx(1000 / 32.8 * 16.4, abs=10)
