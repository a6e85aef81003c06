"""Tell the whole story on emulated hardware, in under a minute."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where files go.")] = Path(),
) -> None:
    """Record, calibrate, diagnose, flash, verify and report an emulated sensor.

    The sensor has an effect that the usual model leaves out; the diagnosis names it. Files go to
    DIR as demo.arrow, demo.cal.json, demo.diagnosis.json and demo.html; a rerun overwrites them.
    """
    from calib.errors import DriverError
    from imu_cli import output
    from imu_cli.calibration_view import parameter_table

    if os.name == "nt":
        raise DriverError(
            "the demo needs a pty, which Windows has not: try `imu-cal bench` on "
            "emulator://vectornav?motion=bench&speed=0 --auto"
        )
    from imu_cli.recording_view import interrupt_on_signals
    from imu_cli.story import tell

    with interrupt_on_signals():  # an end of the demo must be one of its emulator too
        story = tell(out, lambda text: output.print_lines(text))
    output.print_lines("", parameter_table(story.calibration), "")
    output.print_lines(
        *(
            f"{name:<12} {getattr(story.files, name)}"
            for name in ("recording", "calibration", "diagnosis", "report")
        )
    )
    if not story.verification.right:
        raise typer.Exit(6)
