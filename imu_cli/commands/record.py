"""Record a device, a replay or an emulator to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def record(
    url: Annotated[
        str,
        typer.Argument(
            metavar="URL",
            help="The device: serial:///dev/ttyUSB0?dialect=auto, i2c://1/0x68?chip=mpu6050, "
            "replay://FILE or emulator://NAME.",
        ),
    ],
    output_file: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="log.arrow or log.csv.")
    ],
    duration: Annotated[
        str | None, typer.Option(metavar="TIME", help="Stop after this long: 90s, 10min, 1h.")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Stop after this many samples.")
    ] = None,
    raw: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Save the device's bytes as well.")
    ] = None,
    reconnect: Annotated[
        bool, typer.Option("--reconnect", help="Await a device that vanishes; mark the gap.")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit 6 if anything was lost or damaged.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that exist.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Record a device, a replay or an emulator to a file.

    Ctrl-C ends a recording cleanly. Whatever else happens, the file can be read up to the last
    half second. Lost and damaged samples are counted in the file and on the screen.
    """
    from drivers.record import RecordLimits
    from drivers.record import record as run
    from drivers.stream import StreamDriver
    from drivers.transports import make_driver
    from imu_cli import recording_view as view
    from imu_cli.options import parse_duration, refuse_overwriting, replayed

    if duration is not None and samples is not None:
        raise typer.BadParameter("give --duration or --samples, not both")
    try:
        seconds = None if duration is None else parse_duration(duration)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--duration") from error
    limits = RecordLimits(seconds, samples)
    for path in (output_file, raw):
        if path is not None and path.exists() and not overwrite:
            raise typer.BadParameter(f"{path} exists; name another file, or use --overwrite")
    driver = make_driver(url)
    refuse_overwriting(
        {"--output": output_file, "--raw": raw}, [("recording", path) for path in replayed(url)]
    )
    if raw is not None and not isinstance(driver, StreamDriver):
        raise typer.BadParameter(
            f"{url} has no stream of bytes to save: only serial devices have one",
            param_hint="--raw",
        )
    with view.stop_on_signals() as stop, view.Progress() as progress:
        state = run(
            driver,
            output_file,
            limits=limits,
            raw=raw,
            reconnect=reconnect,
            stop=stop,
            progress=progress.update,
        )
    view.show_result(state, output_file, as_json=json)
    if strict and state.any_loss:
        raise typer.Exit(6)
