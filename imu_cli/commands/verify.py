"""Say whether a calibration is still right for a device, from a new recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imu_cli.options import DropInvalidOption, ImuOption, ProfileOption

NOT_RIGHT = 6


def verify(
    calibration: Annotated[Path, typer.Argument(metavar="CAL.JSON", help="A calibration file.")],
    log: Annotated[list[Path], typer.Argument(metavar="LOG...", help="New recording.")],
    profile: ProfileOption = None,
    imu: ImuOption = None,
    significance: Annotated[
        float, typer.Option(help="Chance of calling the calibration of an unchanged device wrong.")
    ] = 0.001,
    drop_invalid: DropInvalidOption = False,
    json: Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")] = False,
) -> None:
    """Say whether a calibration is still right for a device, from a new recording.

    One static pose is enough to begin; more poses, and turns between them, test more. Exit code 6
    means that it is not right, and the table says what has changed.
    """
    from calib.verify import verify as judge
    from drivers.apply_file import refuse_corrected
    from drivers.formats import read_recording
    from imu_cli import comparison_view as view
    from imu_cli import output
    from imu_cli.calibration_input import load

    if not 0 < significance < 1:
        raise typer.BadParameter(
            f"expected between 0 and 1, got {significance:g}", param_hint="--significance"
        )
    known = load(calibration)
    recording = read_recording(log, profile=profile, imu=imu, drop_invalid=drop_invalid)
    refuse_corrected(recording)
    answer = judge(known, recording, significance=significance)
    if answer.identity:
        output.warn(f"another device? {answer.identity}")
    if json:
        output.print_json(view.verification_document(answer))
    else:
        output.print_lines(*view.check_lines(answer))
        comparison = answer.comparison
        if not answer.right and comparison is not None and comparison.changed:
            output.print_lines(
                "",
                "changed since it was calibrated:",
                view.difference_table(comparison.changed, comparison.changed),
            )
        output.print_lines(*(f"note: {remark}" for remark in answer.remarks))
        output.print_lines(view.answer_line(answer))
    if not answer.right:
        raise typer.Exit(NOT_RIGHT)
