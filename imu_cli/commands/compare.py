"""Compare two calibrations of one device, in standard errors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

DIFFERENT = 6


def compare(
    first: Annotated[Path, typer.Argument(metavar="A.JSON", help="A calibration file.")],
    second: Annotated[Path, typer.Argument(metavar="B.JSON", help="Another one.")],
    json: Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")] = False,
) -> None:
    """Compare two calibrations of one device, in standard errors.

    Exit code 6 means that they differ by more than their standard errors allow.
    """
    from calib.compare import compare as judge
    from imu_cli import comparison_view as view
    from imu_cli import output
    from imu_cli.calibration_input import load

    answer = judge(load(first), load(second))
    if answer.identity:
        output.warn(f"two devices? {answer.identity}")
    if json:
        output.print_json(
            {"format": "imu-cal/comparison", "version": 1, **view.comparison_document(answer)}
        )
    else:
        output.print_lines(view.difference_table(answer.differences, answer.changed))
        for names, path in ((answer.only_first, first), (answer.only_second, second)):
            if names:
                output.print_lines(f"only {path} determines {', '.join(names)}")
        output.print_lines(view.comparison_line(answer))
    if not answer.same:
        raise typer.Exit(DIFFERENT)
