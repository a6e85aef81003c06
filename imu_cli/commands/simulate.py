"""Simulate a recording: a motion, a sensor with its errors, and noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imu_cli.options import FixedPointOption, parse_duration, refuse_overwriting

MOTION_HELP = (
    "bench, hand-held, vibrating, paper, rate-table, record-player, pendulum or thermal. "
    "[default: bench]"
)
EFFECT_HELP = (
    "Add an effect of the catalogue, in SI: slug:name=value,... (repeatable). The slug alone gives "
    "its typical size on every axis."
)


def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", help="Recording to write.")],
    motion: Annotated[str | None, typer.Option(help=MOTION_HELP)] = None,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="REF",
            help="Move as motion capture or a table's profile says. With --like: at the times and "
            "in the frame of that recording.",
        ),
    ] = None,
    fixed_point: FixedPointOption = False,
    bandwidth: Annotated[
        float | None,
        typer.Option(
            help="Low-pass of REF against its noise, Hz. [default: where its motion ends; none if "
            "it is exact]"
        ),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="Digital twin of this recording: its motion and times."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="CAL.JSON", help="With --like: the sensor that recorded it."),
    ] = None,
    sensor: Annotated[
        Path | None,
        typer.Option(metavar="CAL.JSON", help="The sensor to simulate; ideal if not given."),
    ] = None,
    effect: Annotated[
        list[str] | None, typer.Option("--effect", metavar="SLUG[:...]", help=EFFECT_HELP)
    ] = None,
    rate: Annotated[float | None, typer.Option(help="Samples per second. [default: 100]")] = None,
    duration: Annotated[
        str | None, typer.Option(help="Such as 90s or 10min. [default: 3min, or all of REF]")
    ] = None,
    noise: Annotated[
        float, typer.Option(help="Multiple of the sensor's noise; 0 is without.")
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is random.")] = 0,
    gravity: Annotated[
        float | None, typer.Option(help="m/s². [default: 9.80665, or the calibration's]")
    ] = None,
    accel_range: Annotated[
        float | None, typer.Option(help="Full scale, g; without it nothing clips or rounds.")
    ] = None,
    gyro_range: Annotated[float | None, typer.Option(help="Full scale, deg/s.")] = None,
    bits: Annotated[int, typer.Option(help="Of one sample, over the full scale.")] = 16,
    jitter: Annotated[float | None, typer.Option(help="Of the time stamps, s.")] = None,
    lost: Annotated[float | None, typer.Option(help="Probability of a lost sample.")] = None,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the true signals as a recording, too."),
    ] = None,
    profile: Annotated[
        str | None, typer.Option(help="Import profile of the --like recording.")
    ] = None,
    imu: Annotated[int | None, typer.Option(help="Sensor of the --like board, from 1.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Describe what was simulated.")] = False,
) -> None:
    """Simulate a recording: a motion, a sensor with its errors, and noise.

    Without --sensor the sensor has no errors but a consumer part's noise. With --like and
    --calibration the result is the digital twin of a recording: what that calibration says the
    sensor should have read on the same motion. With --reference the motion is what something else
    saw, and --like needs no calibration.
    """
    import numpy as np

    from calib.simulate import Sampling
    from calib.simulation.library import MOTIONS
    from drivers.formats import open_writer
    from drivers.reference_file import read_motion
    from imu_cli import output as out
    from imu_cli.simulation import Plan, describe, run

    if motion is not None and motion not in MOTIONS:
        raise typer.BadParameter(
            f"{motion!r} is no motion: {', '.join(MOTIONS)}", param_hint="--motion"
        )
    if like is not None and calibration is None and reference is None:
        raise typer.BadParameter(
            "the motion of a recording is known only through its calibration: give --calibration "
            "(imu-cal calibrate makes one), or --reference",
            param_hint="--like",
        )
    if like is None and calibration is not None:
        raise typer.BadParameter(
            "goes with --like; to simulate this sensor give --sensor", param_hint="--calibration"
        )
    own = {
        "--motion": motion,
        "--rate": rate,
        "--duration": duration,
        "--accel-range": accel_range,
        "--gyro-range": gyro_range,
        "--jitter": jitter,
        "--lost": lost,
    }
    given = [name for name, value in own.items() if value is not None]
    if like is not None and given:
        raise typer.BadParameter(
            "a twin has the motion, times and ranges of its recording: leave out "
            + ", ".join(given),
            param_hint="--like",
        )
    if reference is not None and motion is not None:
        raise typer.BadParameter(
            "expected --motion or --reference, got both", param_hint="--motion"
        )
    for name, wanted in (("--fixed-point", fixed_point), ("--bandwidth", bandwidth is not None)):
        if wanted and reference is None:
            raise typer.BadParameter("it needs --reference", param_hint=name)
    for name, wanted in (("--profile", profile is not None), ("--imu", imu is not None)):
        if wanted and like is None:
            raise typer.BadParameter("it needs --like", param_hint=name)
    outputs = {"--output": output, "--truth": truth}
    refuse_overwriting(
        outputs,
        (
            ("recording", like),
            ("calibration", calibration),
            ("sensor", sensor),
            ("reference", reference),
        ),
    )
    moved = None if reference is None else read_motion(reference, fixed=fixed_point)
    try:
        seconds = parse_duration(duration or "3min")
        longer = moved is not None and duration is not None and seconds > moved.duration
        if moved is not None:
            seconds = min(seconds if duration else np.inf, moved.duration)
        plan = Plan(
            motion=motion or "bench",
            duration=seconds,
            rate=100.0 if rate is None else rate,
            gravity=gravity,
            noise=noise,
            sampling=Sampling(jitter=jitter or 0.0, lost=lost or 0.0),
            sensor=sensor,
            effects=tuple(effect or ()),
            reference=moved,
            bandwidth=bandwidth,
            like=like,
            calibration=calibration,
            profile=profile,
            imu=imu,
            truth=truth is not None,
            accel_range=accel_range,
            gyro_range=gyro_range,
            bits=bits,
        )
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    # The suffixes are checked before the work is done.
    writers = [open_writer(path, atomic=True) for path in outputs.values() if path is not None]
    result = run(plan, rng=np.random.default_rng(seed))
    for writer, recording in zip(writers, (result.recording, result.truth), strict=False):
        if recording is not None:
            with writer:
                writer.append(recording)
    if moved is not None and not moved.placed:
        out.warn(
            f"{reference} has no positions: its point counts as fixed (--fixed-point, if it was)"
        )
    if longer:
        out.warn(
            f"{reference} lasts {seconds:.6g} s, less than --duration {duration}: the simulation "
            "ends with it"
        )
    for warning in result.warnings():
        out.warn(warning)
    document = describe(result, output, seed=seed)
    if json:
        out.print_json(document)
    else:
        out.print_lines(*result.summary(output))
