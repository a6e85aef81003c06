"""Calibrate an IMU from a recording of static poses and turns."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_cli.options import (
    DropInvalidOption,
    GravityOption,
    HeightOption,
    ImuOption,
    LatitudeOption,
    ProfileOption,
    choose_gravity,
    refuse_overwriting,
    refuse_source,
)

if TYPE_CHECKING:
    from calib.calibration import Calibration

ACCEL_METHODS = "maximum_likelihood, exact, published"
GYRO_METHODS = "rotation_segment_3x3, rotation_segment, euler, quaternion, rate_table"
PARTIAL = 5


def calibrate(
    log: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Recordings of one device.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Calibration to write  [default: LOG.cal.json]"),
    ] = None,
    profile: ProfileOption = None,
    imu: ImuOption = None,
    accel_method: Annotated[str, typer.Option(help=ACCEL_METHODS)] = "maximum_likelihood",
    gyro_method: Annotated[str, typer.Option(help=GYRO_METHODS)] = "rotation_segment_3x3",
    table_rate: Annotated[
        str | None,
        typer.Option(
            help="Rate of the table, °/s, signed; with commas one for each turn; or a CSV file "
            "start,stop,rate in s and °/s."
        ),
    ] = None,
    gravity: GravityOption = None,
    latitude: LatitudeOption = None,
    height: HeightOption = None,
    housing_faces: Annotated[
        Path | None,
        typer.Option(help="CSV `time,up` or `pose,up`: which face (+X ... -Z) was up in a pose."),
    ] = None,
    note: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE", help="Kept in the file; repeatable.")
    ] = None,
    drop_invalid: DropInvalidOption = False,
    json: Annotated[bool, typer.Option("--json", help="Print the calibration as JSON.")] = False,
) -> None:
    """Calibrate an IMU from a recording of static poses and turns.

    The recording holds ten or more static poses, 3 s each, in all directions, and turns of 90° or
    more between them. What it does not determine is marked in the file, and the exit code is 5.
    """
    from imu_cli import output

    destination = _destination(log, out)
    refuse_overwriting(
        {"--output": destination},
        [("file of --housing-faces", housing_faces), ("file of --table-rate", _file(table_rate))],
    )
    notes = _notes(note or [])
    local_gravity = choose_gravity(gravity, latitude, height)
    options = {} if table_rate is None else {"table_rate": _table_rate(table_rate)}
    accel_method, gyro_method = (name.replace("-", "_") for name in (accel_method, gyro_method))
    _check_methods(accel_method, gyro_method, options)

    from datetime import UTC, datetime
    from importlib.metadata import version

    from calib.audit import audit
    from calib.calibrate import calibrate as solve
    from calib.calibration import Provenance
    from calib.document import to_document
    from drivers.apply_file import CORRECTED
    from drivers.calibration_file import describe_input, save_calibration
    from drivers.formats import read_recording

    recording = read_recording(log, profile=profile, imu=imu, drop_invalid=drop_invalid)
    if CORRECTED in recording.notes:
        output.warn(
            f"this recording was corrected by {recording.notes[CORRECTED]}: the result is what "
            "that calibration left, and is of use on corrected streams only"
        )
    audited = audit(recording)
    for finding in audited.findings:
        if finding.kind != "unit":
            output.warn(finding.message)
    if imu is not None:
        notes.setdefault("imu", str(imu))
    with _bad_option("--table-rate") if options else nullcontext():
        calibration = solve(
            recording,
            gravity=local_gravity,
            accel_method=accel_method,
            gyro_method=gyro_method,
            options=options,
            poses=audited.poses,
            provenance=Provenance(
                tuple(describe_input(path) for path in log),
                version("imu-cal"),
                datetime.now(UTC).isoformat(timespec="seconds"),
                notes=notes,
            ),
        )
    if housing_faces is not None:
        calibration = _align(calibration, housing_faces)
    save_calibration(calibration, destination)
    if json:
        output.print_json(to_document(calibration))
    else:
        from imu_cli import calibration_view as view

        output.print_lines(
            *view.summary_lines(calibration),
            "",
            view.parameter_table(calibration),
            "",
            *view.undetermined_lines(calibration),
            f"written      {destination}",
        )
    if not calibration.complete:
        raise typer.Exit(PARTIAL)


def _destination(log: list[Path], out: Path | None) -> Path:
    destination = out or log[0].with_suffix(".cal.json")
    refuse_source(destination, log)
    if destination.is_dir() or not destination.parent.is_dir():
        raise typer.BadParameter(
            f"{destination}: expected a file in a folder that is there", param_hint="--output"
        )
    return destination


def _notes(pairs: list[str]) -> dict[str, str]:
    notes = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.strip():
            raise typer.BadParameter(f"expected KEY=VALUE, got {pair!r}", param_hint="--note")
        notes[key.strip()] = value.strip()
    return notes


def _file(text: str | None) -> Path | None:
    return None if text is None or not Path(text).is_file() else Path(text)


def _table_rate(text: str) -> object:
    import math

    path = Path(text)
    try:
        if path.is_file():
            lines = path.read_text(encoding="utf-8").splitlines()
            rows = [line.split(",") for line in lines if line.strip() and line[0] not in "#s"]
            return [[float(a), float(b), math.radians(float(rate))] for a, b, rate in rows]
        rates = [math.radians(float(part)) for part in text.split(",")]
    except (ValueError, OSError) as error:
        raise typer.BadParameter(
            f"expected °/s, several with commas, or a CSV file start,stop,rate; got {text!r}: "
            f"{error}",
            param_hint="--table-rate",
        ) from error
    return rates[0] if len(rates) == 1 else rates


def _check_methods(accel: str, gyro: str, options: dict[str, object]) -> None:
    from calib.solvers import accel_solvers, gyro_solvers

    for name, known, hint in (
        (accel, accel_solvers(), "--accel-method"),
        (gyro, gyro_solvers(), "--gyro-method"),
    ):
        if name not in known:
            lines = "\n".join(f"  {key:<22} {item.summary}" for key, item in known.items())
            raise typer.BadParameter(f"{name!r} is none of\n{lines}", param_hint=hint)
    if gyro == "rate_table" and "table_rate" not in options:
        raise typer.BadParameter("rate_table needs it", param_hint="--table-rate")
    if options and gyro != "rate_table":
        raise typer.BadParameter("is for --gyro-method rate_table", param_hint="--table-rate")


def _align(calibration: Calibration, path: Path) -> Calibration:
    from calib.housing import align_to_housing
    from drivers.faces_file import read_faces

    faces = read_faces(path)
    with _bad_option("--housing-faces"):
        return align_to_housing(calibration, faces)


@contextmanager
def _bad_option(hint: str) -> Iterator[None]:
    """Turn what the library says of a bad argument into wrong usage of the option it came from."""
    try:
        yield
    except ValueError as error:
        if type(error) is not ValueError:
            raise
        raise typer.BadParameter(str(error), param_hint=hint) from error
