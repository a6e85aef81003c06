"""Find the physics that a simulation of this recording leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_cli.options import (
    DropInvalidOption,
    FixedPointOption,
    HeightOption,
    ImuOption,
    LatitudeOption,
    ProfileOption,
    choose_gravity,
    refuse_overwriting,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calib.calibration import Calibration
    from calib.mismatch import Diagnosis
    from calib.model import SensorModel
    from calib.recording import Recording


def diagnose(
    recording: Annotated[Path, typer.Argument(metavar="REAL", help="The recording.")],
    calibration: Annotated[
        Path | None,
        typer.Option(help="Compare with the twin under this calibration, not the paper's model."),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="SIM", help="Compare with this simulation; rate and start time may differ."
        ),
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="REF",
            help="Compare with motion capture, a table's profile, or another IMU on the same body.",
        ),
    ] = None,
    reference_imu: Annotated[
        int | None, typer.Option(help="Which sensor of the reference's board, from 1.")
    ] = None,
    fixed_point: FixedPointOption = False,
    other_profile: Annotated[
        str | None,
        typer.Option(help="Import profile of SIM or REF, where that is a foreign log."),
    ] = None,
    profile: ProfileOption = None,
    imu: ImuOption = None,
    gravity: Annotated[
        float | None,
        typer.Option(help="Local gravity, m/s²  [default: the calibration's, or 9.80665]"),
    ] = None,
    latitude: LatitudeOption = None,
    height: HeightOption = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the sensor model that was found."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Write a page with the plots that convinced (HTML)."),
    ] = None,
    drop_invalid: DropInvalidOption = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Find the physics that a simulation of this recording leaves out.

    The simulation is the recording's own twin: its rests and turns, under the paper's sensor model
    (or the one given) fitted to it. With --against it is your own simulation, whose motion is taken
    as the truth; with --reference what moved with the sensor. Every verdict ends with exit code 0.
    """
    from calib.mismatch import diagnose_against, diagnose_reference
    from drivers.calibration_file import (
        check_can_write,
        load_calibration,
        name_of,
        save_calibration,
    )
    from drivers.formats import read_recording
    from drivers.reference_file import read_reference, refuse_reference
    from imu_cli.diagnosis_view import diagnosis_lines
    from imu_cli.output import print_json, print_lines, warn

    files = (
        ("recording", recording),
        ("calibration", calibration),
        ("simulation", against),
        ("reference", reference),
    )
    refuse_overwriting({"--output": output, "--report": report}, files)
    for made in filter(None, (output, report)):
        check_can_write(made)
    local = choose_gravity(gravity, latitude, height)
    if against is not None and reference is not None:
        raise typer.BadParameter(
            "expected --against or --reference, got both", param_hint="--reference"
        )
    if reference_imu is not None and reference is None:
        raise typer.BadParameter("it needs --reference", param_hint="--reference-imu")
    if fixed_point and reference is None:
        raise typer.BadParameter("it needs --reference", param_hint="--fixed-point")
    if other_profile is not None and against is None and reference is None:
        raise typer.BadParameter("it needs --against or --reference", param_hint="--other-profile")
    for path in (recording, against):
        if path is not None:
            refuse_reference(path)
    known = None if calibration is None else load_calibration(calibration)
    if known is not None and gravity is None and latitude is None:
        local = known.gravity
    model = None if known is None else known.model
    if against is not None:
        real = read_recording(recording, profile=profile, imu=imu, drop_invalid=drop_invalid)
        simulated = read_recording(against, profile=other_profile, drop_invalid=drop_invalid)
        found = diagnose_against(real, simulated, gravity=local.value, model=model)
    elif reference is not None:
        real = read_recording(recording, profile=profile, imu=imu, drop_invalid=drop_invalid)
        other = read_reference(
            reference,
            imu=reference_imu,
            profile=other_profile,
            fixed=fixed_point,
            drop_invalid=drop_invalid,
        )
        found = diagnose_reference(real, other, gravity=local.value, model=model)
    else:
        read = {"profile": profile, "imu": imu, "drop_invalid": drop_invalid}
        found, real = _by_itself(recording, read, gravity=local.value, model=model)
    if known is not None:
        found = found.beside(known, real)
    if output is not None and found.names:
        save_calibration(_signed(found.calibration(real, gravity=local), recording), output)
    document = {
        **found.to_json(),
        "files": {what: name_of(path) for what, path in files if path is not None},
    }
    if report is not None:
        from drivers.calibration_file import write_atomic
        from imu_cli.report.diagnosis import diagnosis_report
        from imu_cli.report.page import render_page

        write_atomic(report, render_page(diagnosis_report(document)))
    if json:
        print_json(document)
    else:
        print_lines(*diagnosis_lines(document))
        alone = against is None and reference is None
        for text in found.missing:
            warn(f"the {'recording' if alone else 'comparison'} lacks {text}")
    if output is not None and not found.names:
        # The verdict is said before what it leaves nothing to write for.
        found.calibration(real, gravity=local)


def _by_itself(
    path: Path, read: Mapping[str, Any], *, gravity: float, model: SensorModel | None
) -> tuple[Diagnosis, Recording]:
    """Read a recording, thinned where it is long, and compare it with its twin."""
    from calib.mismatch import diagnose_thinned, thin
    from drivers.formats import open_batches, read_recording
    from imu_cli.output import working

    with working("reading") as say:
        count = 0

        def told(samples: int) -> None:
            nonlocal count
            count += samples
            say(f"reading: {count:,} samples")

        if path.is_file():
            thinned = thin(lambda: open_batches(path, **read), progress=told)
        else:
            # A pipe can be read only once.
            real = read_recording(path, **read)
            thinned = thin(lambda: (real,), progress=told)
        say("comparing with its twin")
        return diagnose_thinned(thinned, gravity=gravity, model=model), thinned.recording


def _signed(made: Calibration, recording: Path) -> Calibration:
    from dataclasses import replace
    from datetime import UTC, datetime
    from importlib.metadata import version

    from drivers.calibration_file import describe_input

    return made.with_provenance(
        replace(
            made.provenance,
            inputs=(describe_input(recording),),
            tool_version=version("imu-cal"),
            date=datetime.now(UTC).isoformat(timespec="seconds"),
        )
    )
