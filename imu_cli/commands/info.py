"""Audit a recording before anything is fitted: rate, gaps, clipping, poses, units."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imu_cli.options import DropInvalidOption, ImuOption, ProfileOption

CHECK_SAID_NO = 6


def info(
    log: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Recordings of one device.")],
    profile: ProfileOption = None,
    imu: ImuOption = None,
    drop_invalid: DropInvalidOption = False,
    strict: Annotated[bool, typer.Option(help="Exit with 6 if anything was found.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the audit as JSON.")] = False,
) -> None:
    """Audit a recording before anything is fitted: rate, gaps, clipping, poses, units.

    Findings are output: the exit code is 0 whenever the recording can be read, unless --strict.
    """
    from calib.audit import audit
    from drivers.formats import read_recording
    from imu_cli import audit_view as view
    from imu_cli import output

    recording = read_recording(log, profile=profile, imu=imu, drop_invalid=drop_invalid)
    result = audit(recording)
    if json:
        output.print_json(view.document(recording, result, [str(path) for path in log]))
    else:
        found = [view.findings_table(result)] if result.findings else ["nothing found to be wrong"]
        output.print_lines(
            *view.summary_lines(recording, result, ", ".join(map(str, log))),
            *view.remark_lines(result),
            "",
            *found,
        )
    if strict and result.findings:
        raise typer.Exit(CHECK_SAID_NO)
