"""Show what the line has measured: units, yield, Cpk, outliers, wandering stations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def history(
    station_file: Annotated[Path, typer.Argument(help="The station's TOML file.")],
    serial: Annotated[
        str, typer.Option("--serial", help="Show every attempt of one unit.", metavar="SN")
    ] = "",
    station: Annotated[
        str, typer.Option("--station", help="Only this station's runs.", metavar="NAME")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document.")] = False,
) -> None:
    """Show the history of a unit, or of the whole line.

    Yield is over the last attempt of each unit. Cpk is against the station file's limits, with its
    95 % interval; outliers and drifts are said at a family-wise error of 1 %.
    """
    from imu_cli import output
    from imu_cli.line.station import load_station
    from imu_cli.line.store import History
    from imu_cli.line.summary import summarise, unit_record

    limits = load_station(station_file)
    book = History(limits.history)
    try:
        runs = book.runs(serial_number=serial or None, station=station or None)
    finally:
        book.close()
    if serial:
        output.show_unit(serial, [unit_record(run) for run in runs], as_json=as_json)
    else:
        output.show_line(summarise(runs, limits.limits), as_json=as_json)
