"""Show a calibration: every parameter with its unit and standard error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def show(
    calibration: Annotated[
        Path | None, typer.Argument(metavar="CAL.JSON", help="A calibration file.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the document itself.")] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of calibration files.")
    ] = False,
) -> None:
    """Show a calibration: every parameter with its unit and standard error.

    Beside SI stand milli-g, degrees and per cent. Parameters that the recording did not determine
    are marked; those that are zero by the definition of the frame or the method are left away.
    """
    from imu_cli import output
    from imu_cli.calibration_input import load

    if schema:
        from calib.document import schema as published

        output.print_json(published())
        return
    if calibration is None:
        raise typer.BadParameter("name a calibration file", param_hint="CAL.JSON")
    from calib.document import to_document

    found = load(calibration)
    if json:
        output.print_json(to_document(found))
        return
    from imu_cli import calibration_view as view

    output.print_lines(
        *view.summary_lines(found),
        "",
        view.parameter_table(found),
        *view.undetermined_lines(found),
    )
