"""The whole story on emulated hardware: what ``imu-cal demo`` tells.

A sensor with a concealed effect is recorded, calibrated and diagnosed; the effect is named,
modelled and removed; what the device can hold is flashed into it, verified on a new recording, and
reported.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from calib.apply import correct_recording
from calib.calibrate import calibrate
from calib.calibration import Calibration, Gravity, InputFile, Provenance
from calib.errors import DeviceLostError
from calib.mismatch import Diagnosis, diagnose_recording
from calib.recording import Recording
from calib.statics import find_poses
from calib.verify import Verification, verify
from drivers.calibration_file import describe_input, save_calibration, write_atomic
from drivers.flash import make_target
from drivers.flash.procedure import Result, flash_device
from drivers.formats import read_recording
from drivers.record import RecordLimits, record
from drivers.transports import make_driver

DEVICE = "vectornav"
"""It has its own clock, so it may run faster than real time, and it holds a whole 3x3 matrix."""
EFFECT = "gyro_g_sensitivity:gxz=2.5e-4,gyx=-1.5e-4,gzy=2e-4"
"""(rad/s)/(m/s²): 0.14, 0.08 and 0.11 dps/g, the typical size for a consumer part."""
SEED, SPEED = 11, 12.0
MOTION_TIME = 185.0
"""s of device time in which the emulated hand has finished."""
STILL_TIME = 20.0
GRAVITY = Gravity(9.80665, "standard gravity")

Say = Callable[[str], None]


@dataclass(frozen=True)
class Files:
    """What the demo leaves behind."""

    recording: Path
    calibration: Path
    diagnosis: Path
    report: Path
    left: Path
    backup: Path
    verify: Path

    @classmethod
    def within(cls, folder: Path) -> Files:
        """Return the files in a folder, by their fixed names."""
        return cls(
            folder / "demo.arrow",
            folder / "demo.cal.json",
            folder / "demo.diagnosis.json",
            folder / "demo.html",
            folder / "demo.left.json",
            folder / "demo.backup.json",
            folder / "demo.verify.arrow",
        )


@dataclass(frozen=True, eq=False)
class Story:
    """What the demo found."""

    files: Files
    calibration: Calibration
    diagnosis: Diagnosis
    flashed: Result
    verification: Verification


def tell(folder: Path, say: Say) -> Story:
    """Run the whole story; `say` is told each step before it begins, and what came of it."""
    folder.mkdir(parents=True, exist_ok=True)
    files = Files.within(folder)
    say(f"1. An emulated {DEVICE} with errors drawn by seed, and one effect that is concealed.")
    with emulated() as url:
        say(f"   It is on a pty: {url}")
        say(f"2. Record {MOTION_TIME:.0f} s of it being turned by hand, {SPEED:g} times as fast.")
        recording = record_for(url, files.recording, MOTION_TIME)
        say(f"   {len(recording)} samples, {recording.samples_lost} lost.")
        say("3. Calibrate.")
        calibration = calibrate(recording, gravity=GRAVITY, provenance=provenance(files.recording))
        say(f"   {len(calibration.names)} parameters with standard errors.")
        say("4. Diagnose: does a simulation with this calibration differ from the recording?")
        diagnosis = diagnose_recording(recording, gravity=GRAVITY.value, model=calibration.model)
        write_atomic(
            files.diagnosis, json.dumps(diagnosis.to_json(), indent=2, allow_nan=False) + "\n"
        )
        for finding in diagnosis.findings:
            say(f"   Found {finding.effect}: {finding.sentence}")
        better = with_findings(calibration, diagnosis, recording)
        save_calibration(better, files.calibration)
        before, after = (rest_spread(recording, item) for item in (calibration, better))
        say(
            f"   Resting gyroscope, pose to pose: {np.degrees(before):.4f} dps before, "
            f"{np.degrees(after):.4f} dps with the term."
        )
        say("5. Flash what the device can hold: backup, write, read back, measure.")
        files.backup.unlink(missing_ok=True)
        with make_target(url) as target:
            flashed = flash_device(
                target,
                better,
                backup=files.backup,
                persist=False,
                duration=STILL_TIME,
                report=lambda text: say(f"   {text}"),
            )
        save_calibration(flashed.left, files.left)
        say("6. Verify: record the still device again, apply what is left, compare.")
        still = record_for(url, files.verify, STILL_TIME)
        verification = verify(flashed.left, still)
        say(f"   {'right' if verification.right else 'not right'} within its standard errors.")
    say("7. Report.")
    write_report(better, diagnosis, files.report)
    return Story(files, better, diagnosis, flashed, verification)


@contextmanager
def emulated() -> Iterator[str]:
    """Run the emulator in a process of its own and give its address."""
    command = [sys.executable, "-m", "imu_cli", "emulate", DEVICE, "--motion", "bench"]
    command += ["--seed", str(SEED), "--speed", str(SPEED), "--effect", EFFECT]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            if not address:
                raise DeviceLostError("the emulator ended before it began")
            yield address
        finally:
            process.terminate()


def record_for(url: str, path: Path, duration: float) -> Recording:
    """Record some seconds of device time over the port."""
    record(
        make_driver(url),
        path,
        limits=RecordLimits(duration, None),
        raw=None,
        reconnect=False,
        stop=threading.Event(),
        progress=lambda state: None,
    )
    return read_recording(path)


def provenance(path: Path) -> Provenance:
    """Return where a calibration of this file comes from, now."""
    item: InputFile = describe_input(path)
    return Provenance((item,), version("imu-cal"), datetime.now(UTC).isoformat(timespec="seconds"))


def with_findings(
    calibration: Calibration, diagnosis: Diagnosis, recording: Recording
) -> Calibration:
    """Return the calibration with the terms that were found, refitted together with it."""
    found = diagnosis.calibration(recording, gravity=calibration.gravity)
    return replace(
        calibration,
        model=found.model,
        names=found.names,
        covariance=found.covariance,
        undetermined=found.undetermined,
        events=found.events,
    )


def rest_spread(recording: Recording, calibration: Calibration) -> float:
    """Return the rms of the corrected gyroscope over the poses, rad/s."""
    poses = find_poses(correct_recording(calibration, recording))
    return float(np.sqrt(np.mean(poses.gyro**2)))


def write_report(calibration: Calibration, diagnosis: Diagnosis, path: Path) -> None:
    """Write one page with the calibration and what the diagnosis found."""
    from imu_cli.report.contents import calibration_report
    from imu_cli.report.diagnosis import diagnosis_report
    from imu_cli.report.page import render_page

    first = calibration_report(calibration)
    second = diagnosis_report(diagnosis.to_json())
    blocks = (*second.blocks, *first.blocks)
    write_atomic(
        path,
        render_page(replace(first, verdict=f"{first.verdict} {second.verdict}", blocks=blocks)),
    )
