"""Calibrations as commands take them: loaded, with a word on what a newer imu-cal has put in."""

from __future__ import annotations

from pathlib import Path

from calib.calibration import VERSION, Calibration
from drivers.calibration_file import load_calibration
from imu_cli import output


def load(path: Path) -> Calibration:
    """Load a calibration; say so if it is of a newer minor version."""
    calibration = load_calibration(path)
    if calibration.version != VERSION:
        unknown = ", ".join(calibration.extra) or "none at the top level"
        output.warn(
            f"{path} has version {calibration.version}, this imu-cal knows {VERSION}: keys that it "
            f"does not know are passed over ({unknown})"
        )
    return calibration
