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

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from rich.console import Console

from calib.calibrate import calibrate
from calib.calibration import Gravity
from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.model import SensorModel
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from drivers.formats import read_recording
from imu_cli.bench.run import slices
from imu_cli.bench.screen import Header, render
from imu_cli.bench.session import Session
from imu_cli.bench.targets import make_targets
from imu_cli.report.contents import calibration_report
from imu_cli.report.diagnosis import diagnosis_report
from imu_cli.report.page import render_page

mpl.use("Agg")

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


def diagnosis_page() -> str:
    """Return the report of a recording in which a gyroscope feels specific force."""
    motion = bench_protocol(np.random.default_rng(5), poses=24)
    term = Term("gyro_g_sensitivity", {"gxz": 4e-5})
    recording = simulate(
        motion, SensorModel(terms=(term,)), CONSUMER, rng=np.random.default_rng(6), rate=100.0
    )
    found = diagnose_recording(recording, gravity=GRAVITY.value)
    return render_page(diagnosis_report(found.to_json()))


def draw_concealed(picture: Path) -> None:
    """Draw the README's table of the concealed effects."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    part = text[text.index("| non-centrality | found |") :].split("\n\n")[0]
    rows = [
        [float(x) if (x := cell.strip(" %")) else np.nan for cell in line.split("|")[1:-1]]
        for line in part.splitlines()[2:]
    ]
    power, found, first, among, false, known, goal = np.array(rows).T
    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    for values, label, style in (
        (found, "something found", "o--"),
        (known, "right name, if the noise were known", "s:"),
        (among, "right name, alone or a stated rival", "o-"),
        (first, "right name first", "o:"),
        (false, "a false name", "x-"),
        (goal, "goal for the name", "k_"),
    ):
        axes.plot(power, values, style, label=label, ms=16 if style == "k_" else 6)
    axes.set(
        xscale="log",
        xticks=power,
        xticklabels=[f"{p:.0f}" for p in power],
        ylim=(-3, 103),
        xlabel="non-centrality of the concealed effect for one who knows it",
        ylabel="share of recordings, %",
    )
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(picture, dpi=130)


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
    shoot(diagnosis_page(), IMAGES / "diagnosis.png", (1100, 1350))
    draw_concealed(IMAGES / "concealed.png")


if __name__ == "__main__":
    main()
