"""Sustained recording from a pty: is anything lost, and what share of a core does it take?

`imu-cal emulate` runs the device in real time, `imu-cal record` records it to Arrow with a raw
capture beside it. The device's own clock shows every missing sample.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

IMU_CAL = [sys.executable, "-m", "imu_cli"]
CASES = (("text", "arduino", 5_000), ("binary", "vectornav", 20_000))


def children_cpu() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run(name: str, rate: int, seconds: float, folder: Path) -> dict[str, float]:
    device = subprocess.Popen(
        [*IMU_CAL, "emulate", name, "--rate", str(rate)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert device.stdout is not None
        address = device.stdout.readline().strip()
        cpu = children_cpu()
        result = subprocess.run(
            [
                *[*IMU_CAL, "record", address, "-o", str(folder / f"{name}.arrow"), "--json"],
                *["--raw", str(folder / f"{name}.bin"), "--duration", f"{seconds}s"],
            ],
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        report: dict[str, float] = json.loads(result.stdout)
        report["cores"] = (children_cpu() - cpu) / seconds
        return report
    finally:
        device.send_signal(signal.SIGINT)
        device.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--data", help="not used: the device is emulated")
    seconds = parser.parse_args().seconds
    print(f"{seconds:g} s each, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    print("| stream | rate, Hz | samples | lost | share of a core |\n|---|---:|---:|---:|---:|")
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        for kind, name, rate in CASES:
            report = run(name, rate, seconds, Path(folder))
            print(
                f"| {kind} | {report['rate_hz']:.0f} | {report['samples']} | {report['lost']} "
                f"| {report['cores']:.3f} |",
                flush=True,
            )
            failed |= report["lost"] != 0
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
