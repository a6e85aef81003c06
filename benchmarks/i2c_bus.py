"""The emulated I2C bus: transactions per second, and FIFO reading at 1 kHz with no overflow.

The chip is served by a process of its own, as ``imu-cal emulate`` does it; this one reads it
through ioctl(2) with unmodified smbus2. Needs root and /dev/fuse; says so and ends where they are
missing. Exits 1 if a sample was lost.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

from drivers.chips import get_chip
from drivers.emulators.fuse_bus import unavailable
from drivers.transports import open_driver


@contextlib.contextmanager
def emulated(chip: str, rate: float) -> Iterator[str]:
    command = [sys.executable, "-m", "imu_cli", "emulate", chip, "--rate", f"{rate:g}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(10)


def cpu() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def per_second(call, seconds: float) -> float:  # type: ignore[no-untyped-def]
    count, begin = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - begin) < seconds:
        for _ in range(100):
            call()
        count += 100
    return count / elapsed


def transactions(seconds: float) -> None:
    import smbus2

    with emulated("mpu6050", 100) as url:
        path = re.sub(r"^i2c://(.*)/0x68.*", r"\1", url)
        with smbus2.SMBus(path) as bus:
            write = smbus2.i2c_msg.write(0x68, [0x3B])
            read = smbus2.i2c_msg.read(0x68, 14)
            long = smbus2.i2c_msg.read(0x68, 1022)
            rows = {
                "read_byte_data": lambda: bus.read_byte_data(0x68, 0x75),
                "i2c_rdwr, 14 bytes": lambda: bus.i2c_rdwr(write, read),
                "i2c_rdwr, 1022 bytes": lambda: bus.i2c_rdwr(write, long),
            }
            print("| call of smbus2 | transactions/s |\n|---|---|")
            for name, call in rows.items():
                print(f"| {name} | {per_second(call, seconds):.0f} |")


def fifo(chips: list[str], seconds: float) -> int:
    lost = 0
    print("\n| FIFO of | asked, Hz | samples/s | lost | overflows | CPU of the reader |")
    print("|---|---|---|---|---|---|")
    for chip in chips:
        rate = min(rate for rate in get_chip(chip).rates() if rate > 999)
        with emulated(chip, rate) as url, open_driver(url) as driver:
            while driver.read(1.0) is None:
                pass
            got, missing, begin, used = 0, 0, time.monotonic(), cpu()
            while (elapsed := time.monotonic() - begin) < seconds:
                batch = driver.read(1.0)
                if batch is not None:
                    got += len(batch)
                    missing += batch.samples_lost
            share = (cpu() - used) / elapsed
            overflows = driver.counters["fifo_overflows"]
        print(f"| {chip} | {rate} | {got / elapsed:.1f} | {missing} | {overflows} | {share:.1%} |")
        lost += missing
    return lost


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", help="not used: the chips are emulated")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument(
        "--chips",
        default="mpu6050,mpu6500,icm20948,icm42688p,lsm6ds3,lsm6dso,bmi160",
        help="a bmi270 on a bus needs its maker's configuration file",
    )
    arguments = parser.parse_args()
    reason = unavailable()
    if reason:
        print(f"no emulated bus here: {reason}")
        return 0
    transactions(min(arguments.seconds, 3.0))
    return 1 if fifo(arguments.chips.split(","), arguments.seconds) else 0


if __name__ == "__main__":
    sys.exit(main())
