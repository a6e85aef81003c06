"""Run an emulated chip or serial device that any program can use."""

from __future__ import annotations

from typing import Annotated

import typer


def emulate(
    name: Annotated[
        str | None, typer.Argument(metavar="CHIP|DIALECT", help="None lists what there is.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", min=0.001, help="Sample rate.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of its errors, noise and motion.")] = 0,
    motion: Annotated[str, typer.Option(help="still or bench.")] = "still",
    speed: Annotated[
        float, typer.Option(min=0.0, help="Emulated over real time; 0 is as fast as it is read.")
    ] = 1.0,
    effect: Annotated[
        list[str] | None,
        typer.Option(metavar="SLUG[:...]", help="A concealed effect of the sensor; repeatable."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="List as JSON.")] = False,
) -> None:
    """Run an emulated chip or serial device that any program can use.

    A serial device appears on a pty, a chip on an I2C bus file. The first line printed is the
    address to record from; Ctrl-C ends it.
    """
    from drivers.emulators import emulators
    from drivers.emulators.base import MOTIONS, EmulatorOptions
    from imu_cli import output
    from imu_cli.recording_view import stop_on_signals

    known = emulators()
    if name is None:
        if json:
            output.print_json([{"name": n, "summary": e.summary} for n, e in known.items()])
        else:
            output.print_lines(*(f"{n:14} {e.summary}" for n, e in known.items()))
        return
    if name not in known:
        raise typer.BadParameter(f"no emulator {name!r}; there are {', '.join(known)}")
    if motion not in MOTIONS:
        raise typer.BadParameter(f"no motion {motion!r}; there are {', '.join(MOTIONS)}")
    options = EmulatorOptions(
        rate=rate, seed=seed, motion=motion, speed=speed, effects=tuple(effect or ())
    )
    try:
        with stop_on_signals() as stop:
            known[name].serve(options, output.print_now, stop)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--effect") from error
