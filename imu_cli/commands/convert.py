"""Convert a recording to another format: Arrow, Parquet, CSV in SI."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imu_cli.options import DropInvalidOption, ImuOption, ProfileOption, refuse_source


def convert(
    log: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Recordings of one device.")],
    out: Annotated[
        Path, typer.Option("-o", "--output", help="Recording to write; its suffix is the format.")
    ],
    profile: ProfileOption = None,
    imu: ImuOption = None,
    drop_invalid: DropInvalidOption = False,
    json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Convert a recording to another format: Arrow, Parquet, CSV in SI.

    Suffixes: .arrow (the native stream), .feather, .parquet, .csv. Several logs become one
    recording. Memory stays bounded, and the output appears whole or not at all.
    """
    from drivers.formats import open_batches, open_writer
    from imu_cli import output

    refuse_source(out, log)
    samples = lost = dropped = 0
    cut = ""
    with open_writer(out, atomic=True) as writer:
        for batch in open_batches(log, profile=profile, imu=imu, drop_invalid=drop_invalid):
            writer.append(batch)
            samples += len(batch)
            lost += batch.samples_lost
            dropped = int(batch.notes.get("dropped_rows", 0))
            cut = cut or ("" if batch.complete else batch.notes.get("cut", "no clean end"))
    if cut:
        output.warn(f"the recording was cut: {cut}")
    if dropped:
        output.warn(f"{dropped} invalid rows were left out and count as lost")
    if json:
        output.print_json(
            {"written": str(out), "samples": samples, "lost": lost, "complete": not cut}
        )
    else:
        output.print_lines(f"{out}: {samples} samples, {lost} lost")
