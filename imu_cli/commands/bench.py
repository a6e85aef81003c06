"""Guide a calibration at the bench: one instruction at a time, until it is good enough."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imu_cli.options import (
    GravityOption,
    HeightOption,
    LatitudeOption,
    choose_gravity,
    refuse_source,
    replayed,
)


def bench(
    url: Annotated[
        str,
        typer.Argument(
            metavar="URL",
            help="The device: serial:///dev/ttyUSB0, i2c://1/0x68?chip=mpu6050, "
            "replay://FILE?speed=0 or emulator://witmotion?motion=bench.",
        ),
    ],
    output_file: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FILE", help="The recording; others are beside it."),
    ] = Path("bench.arrow"),
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=QUANTITY", help='Standard error to reach, such as accel.bias="1 mg".'
        ),
    ] = None,
    gravity: GravityOption = None,
    latitude: LatitudeOption = None,
    height: HeightOption = None,
    auto: Annotated[
        bool, typer.Option("--auto", help="Ask nothing: for a replay or an emulator.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that exist.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Guide a calibration at the bench, until every standard error meets its target.

    Each instruction is the turn that lowers the worst standard error most. Ctrl-C pauses: the same
    command takes the session up again from its recording.
    """
    from imu_cli.bench.finish import finish
    from imu_cli.bench.run import load_earlier, run_session
    from imu_cli.bench.session import Session
    from imu_cli.bench.targets import make_targets
    from imu_cli.bench.view import Screen
    from imu_cli.recording_view import stop_on_signals

    try:
        targets = make_targets(target or ())
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--target") from error
    from drivers.transports import make_driver

    driver = make_driver(url)
    refuse_source(output_file, replayed(url))
    session = Session(targets=targets, gravity=choose_gravity(gravity, latitude, height))
    earlier = None if overwrite else load_earlier(output_file)
    with stop_on_signals() as stop, Screen(enabled=not json) as screen:
        outcome = run_session(
            session, driver, output_file, earlier=earlier, stop=stop, show=screen.show
        )
    raise typer.Exit(finish(session, outcome, output_file, url=url, ask=not auto, as_json=json))
