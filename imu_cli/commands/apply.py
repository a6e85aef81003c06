"""Correct a recording, or a stream, with a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_cli.options import DropInvalidOption, ImuOption, ProfileOption, refuse_source

if TYPE_CHECKING:
    from collections.abc import Collection

    from calib.apply import Coverage
    from calib.calibration import Calibration

DAMAGED = 5
SAID = 10
"""So many damaged lines of a stream are named; the others are counted."""


def apply(
    calibration: Annotated[Path, typer.Argument(metavar="CAL.JSON", help="A calibration file.")],
    log: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", help="Recording, or - for CSV on standard input."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Recording to write; its suffix names the format."),
    ] = None,
    profile: ProfileOption = None,
    imu: ImuOption = None,
    drop_invalid: DropInvalidOption = False,
    json: Annotated[bool, typer.Option("--json", help="Print what was done as JSON.")] = False,
) -> None:
    """Correct a recording, or a stream, with a calibration.

    From file to file in bounded memory. As a filter (LOG is -), every line of CSV in SI units comes
    out corrected as soon as it has come in; other columns, comments and blank lines stay as they
    are, damaged lines are named on standard error and left out, and the exit code is then 5.
    """
    from imu_cli import output
    from imu_cli.calibration_input import load

    known = load(calibration)
    _say_what_is_undetermined(known)
    if [str(path) for path in log] == ["-"]:
        if json or profile is not None or imu is not None or str(out or "-") != "-":
            raise typer.BadParameter(
                "a stream is CSV in SI units on standard input and output; use `imu-cal convert` "
                "on files for profiles and other formats",
                param_hint="LOG",
            )
        _filter(known)
        return
    if out is None:
        raise typer.BadParameter("name the recording to write", param_hint="--output")
    refuse_source(out, log)
    refuse_source(out, [calibration], what="calibration")
    from dataclasses import asdict

    from calib.apply import from_power_on, not_applied
    from drivers.apply_file import apply_file
    from drivers.calibration_file import name_of

    coverage = apply_file(
        known,
        list(log),
        out,
        name=name_of(calibration),
        profile=profile,
        imu=imu,
        drop_invalid=drop_invalid,
        check_device=lambda text: output.warn(f"another device? {text}"),
    )
    _say_what_is_not_applied(known, coverage)
    _say_coverage(known, coverage)
    if json:
        output.print_json(
            {
                "format": "imu-cal/apply",
                "version": 1,
                "out": str(out),
                "samples": coverage.samples,
                "outside_temperature_range": coverage.outside,
                "without_temperature": coverage.without_temperature,
                "not_applied": [asdict(item) for item in not_applied(known, coverage)],
                "warm_up_from": coverage.start if from_power_on(known) else None,
            }
        )
    else:
        output.print_lines(f"{coverage.samples} samples corrected, written to {out}")
        if from_power_on(known) and coverage.start is not None:
            output.print_lines(f"note: {_warm_up(known, f', at {coverage.start:.2f} s')}")


def _filter(known: Calibration) -> None:
    import sys

    from calib.apply import Coverage, from_power_on
    from drivers.text_filter import CsvFilter
    from imu_cli import output

    if from_power_on(known):
        output.warn(_warm_up(known, ""))
    told = _say_what_is_not_applied(known, Coverage())
    said = 0

    def complain(text: str) -> None:
        nonlocal said
        said += 1
        if said <= SAID:
            output.warn(text)

    stream = CsvFilter(known, complain)
    source: Any = sys.stdin.buffer
    while data := source.read1(1 << 20):
        output.write_bytes(stream.feed(data))
        if stream.corrector is not None:
            told |= _say_what_is_not_applied(known, stream.corrector.coverage, told)
    output.write_bytes(stream.finish())
    if stream.corrector is not None:
        _say_what_is_not_applied(known, stream.corrector.coverage, told)
        _say_coverage(known, stream.corrector.coverage)
    if stream.damaged:
        output.warn(f"{stream.damaged} damaged lines were left out of {stream.lines} good ones")
        raise typer.Exit(DAMAGED)


def _say_what_is_undetermined(known: Calibration) -> None:
    from imu_cli import output

    if known.undetermined:
        output.warn(
            f"{len(known.undetermined)} parameters are undetermined and taken as 0; "
            "`imu-cal show` names them"
        )


def _say_what_is_not_applied(
    known: Calibration, coverage: Coverage, told: Collection[str] = ()
) -> set[str]:
    """Say it, but not again of what was told; return the effects that were said now."""
    from calib.apply import not_applied
    from imu_cli import output

    found = [item for item in not_applied(known, coverage) if item.effect not in told]
    for item in found:
        output.warn(f"{item.effect} is not applied: {item.reason}")
    return {item.effect for item in found}


def _warm_up(known: Calibration, at: str) -> str:
    from calib.apply import from_power_on

    names = from_power_on(known)
    return (
        f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} counted from the first "
        f"sample{at}, as if the sensor had been switched on then; if it was warm already, set the "
        "values of k in a copy of the calibration to 0"
    )


def _say_coverage(known: Calibration, coverage: Coverage) -> None:
    from imu_cli import output

    span = known.temperature
    if span is None or not coverage.outside:
        return
    # As many digits as tell the ends apart.
    ends = (span.low, span.high, coverage.low, coverage.high)
    beyond = [(a, b) for a, b in ((span.low, coverage.low), (coverage.high, span.high)) if a > b]
    apart = (k for k in range(1, 6) if all(round(a, k) != round(b, k) for a, b in beyond))
    digits = next(apart, 6)
    low, high, lowest, highest = (f"{end:.{digits}f}" for end in ends)
    output.warn(
        f"{coverage.outside} of {coverage.samples} samples are outside the calibrated temperature "
        f"range {low} to {high} °C (they go from {lowest} to {highest} °C)"
    )
