"""Find the physics that a simulation of this recording leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_cli.options import HeightOption, ImuOption, LatitudeOption, ProfileOption, choose_gravity

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calib.calibration import Calibration, Quantity
    from calib.mismatch import Diagnosis, Finding
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
    fixed_point: Annotated[
        bool,
        typer.Option(
            "--fixed-point",
            help="REF has orientations only, and the body turned about a fixed point: a table of "
            "several axes. (One axis, angles and rates are known to.)",
        ),
    ] = False,
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
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Find the physics that a simulation of this recording leaves out.

    The simulation is the recording's own twin: its rests and turns, under the paper's sensor model
    (or the one given) fitted to it. With --against it is your own simulation, whose motion is taken
    as the truth; with --reference what moved with the sensor. Every verdict ends with exit code 0.
    """
    import os

    # Matrices of a few hundred rows: more threads only cost CPU.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from calib.mismatch import diagnose_against, diagnose_reference
    from drivers.calibration_file import load_calibration, save_calibration
    from drivers.formats import read_recording
    from drivers.reference_file import read_reference
    from imu_cli.output import print_json

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
    known = None if calibration is None else load_calibration(calibration)
    if known is not None and gravity is None and latitude is None:
        local = known.gravity
    model = None if known is None else known.model
    if against is not None:
        real = read_recording(recording, profile=profile, imu=imu)
        simulated = read_recording(against, profile=other_profile)
        found = diagnose_against(real, simulated, gravity=local.value, model=model)
    elif reference is not None:
        real = read_recording(recording, profile=profile, imu=imu)
        other = read_reference(
            reference, imu=reference_imu, profile=other_profile, fixed=fixed_point
        )
        found = diagnose_reference(real, other, gravity=local.value, model=model)
    else:
        found, real = _by_itself(recording, profile, imu, gravity=local.value, model=model)
    if output is not None and found.names:
        save_calibration(_signed(found.calibration(real, gravity=local), recording), output)
    if report is not None:
        from drivers.calibration_file import write_atomic
        from imu_cli.report.diagnosis import diagnosis_report
        from imu_cli.report.page import render_page

        write_atomic(report, render_page(diagnosis_report(found.to_json())))
    if json:
        print_json(found.to_json())
    else:
        _show(found)
    if output is not None and not found.names:
        # The verdict is said before what it leaves nothing to write for.
        found.calibration(real, gravity=local)


def _by_itself(
    path: Path, profile: str | None, imu: int | None, *, gravity: float, model: SensorModel | None
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
            thinned = thin(lambda: open_batches(path, profile=profile, imu=imu), progress=told)
        else:
            # A pipe can be read only once.
            real = read_recording(path, profile=profile, imu=imu)
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


def _show(found: Diagnosis) -> None:
    from imu_cli.output import console, warn
    from imu_cli.report.diagnosis import alias_sentence

    out = console()
    out.print(f"[bold]{_VERDICTS[found.verdict]}[/]", soft_wrap=True)
    for number, item in enumerate(found.findings, 1):
        _show_finding(number, item)
    for left in found.unexplained:
        where = ", ".join(left.channels)
        when = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in left.intervals)
        out.print(
            f"\n[bold]Unexplained[/]: {where}, {when}; follows {left.follows} "
            f"({_chance(left.p_value)}).",
            soft_wrap=True,
        )
        for rival in left.rivals:
            out.print(f"  or: {rival.effect} (odds {rival.odds:.2g})")
    for alias in found.aliases:
        if alias.alike:
            sentence = alias_sentence(alias.to_json())
            out.print(f"\n[bold]Cannot be known[/]: {sentence}", soft_wrap=True)
    if found.findings or found.unexplained:
        from rich.table import Table

        from imu_cli.report.units import people_unit

        table = Table("residual", "unit", "before", "after", "noise floor", box=None)
        for c in found.changes:
            unit, factor = people_unit(c.unit)
            values = (c.before, c.after, c.noise_floor)
            table.add_row(c.rows, unit, *(f"{value * factor:.4g}" for value in values))
        out.print()
        out.print(table)
    known, used = found.summary.get("poses", 0), found.summary.get("poses_used", 0)
    if used < known:
        out.print(f"\n{used} of {known} poses were looked at.", soft_wrap=True)
    if "stamps" in found.summary:
        out.print(
            f"\nTime stamps scatter by {found.summary['stamps']}, but samples were taken evenly: "
            "even times were used.",
            soft_wrap=True,
        )
    _show_notes(found.summary)
    for text in found.missing:
        warn(f"the recording lacks {text}")


def _show_notes(summary: Mapping[str, Any]) -> None:
    from imu_cli.output import console

    out = console()
    if "swapped_markers" in summary:
        left = summary["swapped_markers"]
        when = ", ".join(f"{a:.2f} to {b:.2f} s" for a, b in left["intervals"])
        out.print(
            f"\n{left['samples']} samples of the reference were left out: one marker was taken for "
            f"another at {when}.",
            soft_wrap=True,
        )
    if "silent" in summary:
        out.print(
            f"\nWithout noise: {summary['silent']}; they count as noisy as the quietest sensor is.",
            soft_wrap=True,
        )


_VERDICTS = {
    "consistent": "Consistent: nothing beyond noise.",
    "explained": "Explained: what the simulation leaves out has a name.",
    "partly_explained": "Partly explained: some of what differs has a name, some has none.",
    "unexplained": "Unexplained: it differs from its simulation, and no known physics fits.",
    "undetermined": "Undetermined: this recording cannot tell.",
}


def _show_finding(number: int, item: Finding) -> None:
    from calib.effects.base import PRESENCE
    from imu_cli.output import console

    out = console()
    out.print(f"\n[bold]{number}. {item.title}[/] ({item.effect})", soft_wrap=True)
    out.print(f"   {item.sentence}", soft_wrap=True)
    when = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in item.intervals)
    out.print(
        f"   Where: {', '.join(item.channels)}; {when}; follows {item.regime}.", soft_wrap=True
    )
    out.print(f"   How sure: {_chance(item.p_value)}, all looks counted.", soft_wrap=True)
    for name, q in item.parameters.items():
        if q.unit != PRESENCE:  # the channels say it
            out.print(f"   {name} = {_quantity(q)}")
    for a in item.absorbed_by[:4]:
        out.print(
            f"   {a.parameter} had absorbed {_in_unit(a.unit, a.shift)} of it "
            f"({a.standard_errors:.1f} standard errors).",
            soft_wrap=True,
        )
    if item.held_out is not None:
        h = item.held_out
        out.print(
            f"   On held-out blocks, {h.rows}: {_in_unit(h.unit, h.before, h.after)} "
            f"(noise floor {_in_unit(h.unit, h.noise_floor)}).",
            soft_wrap=True,
        )
    elif item.held_out_reason:
        out.print(f"   Not checked on held-out data: {item.held_out_reason}.", soft_wrap=True)
    for rival in item.rivals:
        out.print(f"   Or: {rival.effect}, odds {rival.odds:.2g} to 1.", soft_wrap=True)
    if item.to_separate:
        out.print(f"   {item.to_separate}", soft_wrap=True)


def _chance(p_value: float) -> str:
    if p_value < 1e-6:
        return "p < 1e-6"
    return f"p = {p_value:.2g}"


def _in_unit(unit: str, *values: float) -> str:
    """Return values in the unit that people use, one after the other."""
    from imu_cli.report.units import people_unit

    name, factor = people_unit(unit)
    return " -> ".join(f"{value * factor:.3g}" for value in values) + f" {name}"


def _quantity(q: Quantity) -> str:
    from imu_cli.report.units import said

    return said(q.value, q.sigma, q.unit)
