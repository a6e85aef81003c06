"""Run one unit through a production station, unattended: PASS, FAIL, ERROR or ABORTED."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def run(
    station_file: Annotated[
        Path, typer.Argument(metavar="STATION.toml", help="The station's TOML file.")
    ],
    serial: Annotated[str, typer.Option("--serial", metavar="SN", help="The unit.")],
    operator: Annotated[str, typer.Option(help="Who runs it; the station file's if empty.")] = "",
    address: Annotated[
        str, typer.Option(help="Device address, instead of the station file's.")
    ] = "",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON record.")] = False,
) -> None:
    """Record, audit, calibrate, diagnose, hold limits, flash, verify and report one unit.

    Exit codes: 0 PASS, 6 FAIL, 11 ERROR, 130 ABORTED. Nothing is ever asked. Everything goes into
    the station's history; `imu-cal history` shows it.
    """
    import re
    from dataclasses import replace

    from imu_cli import output
    from imu_cli.flash_view import report
    from imu_cli.line.run import run_unit
    from imu_cli.line.station import load_station
    from imu_cli.line.store import History
    from imu_cli.recording_view import stop_on_signals

    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", serial):
        raise typer.BadParameter(
            f"{serial!r} is no serial number: letters, digits, '.', '_' and '-', 64 at most",
            param_hint="--serial",
        )
    station = load_station(station_file)
    if address:
        station = replace(station, address=address)
    history = History(station.history)
    try:
        with stop_on_signals() as stop:
            document = run_unit(
                station,
                history,
                serial_number=serial,
                operator=operator,
                stop=stop,
                report=lambda text: report(f"{serial}: {text}"),
            )
    finally:
        history.close()
    if json:
        output.print_json(document)
    else:
        output.show_unit(serial, [document], as_json=False)
    raise typer.Exit(document["exit_code"])
