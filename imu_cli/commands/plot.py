"""Draw a calibration, a diagnosis or a recording as PNG or SVG."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imu_cli.options import ImuOption, ProfileOption


def plot(
    source: Annotated[Path, typer.Argument(help="Calibration, diagnosis (JSON), or a recording.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="PNG or SVG; by default the source's name with .png."),
    ] = None,
    profile: ProfileOption = None,
    imu: ImuOption = None,
) -> None:
    """Draw the charts of a report, one below the other, for terminals without a browser."""
    from imu_cli import output
    from imu_cli.report.picture import SUFFIXES, write_picture
    from imu_cli.report.source import load_report

    picture = out or source.with_suffix(".png")
    if picture.suffix.lower() not in SUFFIXES:
        raise typer.BadParameter(f"{picture} must end in .png or .svg", param_hint="--output")
    content = load_report(source, profile=profile, imu=imu)
    try:
        write_picture(content, picture)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    except OSError as error:
        raise typer.BadParameter(
            f"{picture}: cannot write it: {error.strerror}", param_hint="--output"
        ) from error
    output.messages().print(f"wrote {picture}", soft_wrap=True)
