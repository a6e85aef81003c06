"""Write a report of a calibration, a diagnosis or a recording, as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imu_cli.options import ImuOption, ProfileOption, refuse_source


def report(
    source: Annotated[Path, typer.Argument(help="Calibration, diagnosis (JSON), or a recording.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="The page; by default the source's name with .html."),
    ] = None,
    profile: ProfileOption = None,
    imu: ImuOption = None,
) -> None:
    """Write one self-contained page: opens without a network, prints to an A4 certificate."""
    from drivers.calibration_file import write_atomic
    from imu_cli import output
    from imu_cli.report.page import render_page
    from imu_cli.report.source import load_report

    page = out or source.with_suffix(".html")
    refuse_source(page, [source], what="source")
    write_atomic(page, render_page(load_report(source, profile=profile, imu=imu)))
    output.messages().print(f"wrote {page}", soft_wrap=True)
