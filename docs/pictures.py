"""Make the pictures of the documentation, from this project's own recording. Needs Chromium.

python docs/pictures.py
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console

from calib.calibrate import calibrate
from calib.calibration import Gravity
from drivers.formats import read_recording
from imu_cli.bench.run import slices
from imu_cli.bench.screen import Header, render
from imu_cli.bench.session import Session
from imu_cli.bench.targets import make_targets
from imu_cli.report.contents import calibration_report
from imu_cli.report.page import render_page

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs/pages/images"
GRAVITY = Gravity(9.80665)


def bench_page() -> str:
    """Return the bench screen in the middle of a session, as a page."""
    recording = read_recording(ROOT / "fixtures/bench.csv")
    session = Session(targets=make_targets(()), gravity=GRAVITY)
    status = session.status()
    for part in slices(recording, width=2.0):
        session.add(part)
        status = session.status()
        if status.poses is not None and len(status.poses) >= 9 and not status.moving:
            break
    elapsed = float(part.time[-1] - recording.time[0])
    with tempfile.TemporaryFile("w") as nowhere:
        console = Console(width=100, height=24, record=True, file=nowhere)
        console.print(render(status, Header("i2c://1/0x68", "MPU-6050", 100.0, 0, elapsed)))
        svg = console.export_svg(title="imu-cal bench i2c://1/0x68?chip=mpu6050")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)  # fonts from a network
    svg = svg.replace("Fira Code", "DejaVu Sans Mono")
    return f"<body style='margin:0'>{svg}</body>"


def report_page() -> str:
    """Return the report of the same recording."""
    calibration = calibrate(read_recording(ROOT / "fixtures/bench.csv"), gravity=GRAVITY)
    return render_page(calibration_report(calibration))


def shoot(page: str, picture: Path, size: tuple[int, int]) -> None:
    """Let a browser draw a page."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("needs Chromium (Debian package chromium)")
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "page.html"
        source.write_text(page, encoding="utf-8")
        subprocess.run(
            [
                chromium,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--hide-scrollbars",
                "--disable-background-networking",
                f"--user-data-dir={folder}/profile",
                f"--window-size={size[0]},{size[1]}",
                "--virtual-time-budget=8000",
                f"--screenshot={picture}",
                source.as_uri(),
            ],
            check=True,
            capture_output=True,
        )


def main() -> None:
    """Write every picture."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    shoot(bench_page(), IMAGES / "bench.png", (1240, 690))
    shoot(report_page(), IMAGES / "report.png", (1100, 1500))


if __name__ == "__main__":
    main()
