"""Write a calibration into a device, with backup, read-back, a measurement and roll-back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def flash(
    arguments: Annotated[
        list[str],
        typer.Argument(metavar="[CAL.json] URL", help="With --restore only the device's URL."),
    ],
    yes: Annotated[
        bool, typer.Option("--yes", help="Really write; without it, a dry run.")
    ] = False,
    persist: Annotated[
        bool,
        typer.Option(
            "--persist", help="Also store in non-volatile memory, which bears few writes."
        ),
    ] = False,
    restore: Annotated[
        Path | None,
        typer.Option("--restore", metavar="BACKUP", help="Write a backup's values back."),
    ] = None,
    backup: Annotated[
        Path | None,
        typer.Option("--backup", help="Where the old values go; default: beside CAL.json."),
    ] = None,
    left: Annotated[
        Path | None,
        typer.Option("--left", help="What is left for `apply`; default: CAL.left.json."),
    ] = None,
    template: Annotated[
        Path | None,
        typer.Option("--template", help="Commands of a device that prints text lines (TOML)."),
    ] = None,
    measure: Annotated[
        float, typer.Option("--measure", min=0.5, help="Seconds to measure the still device.")
    ] = 3.0,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Write a calibration into a device, with backup, read-back, a measurement and roll-back.

    A dry run unless --yes is given. The device must lie still. On any failure, or interrupted by
    Ctrl-C or SIGTERM, the old values are written back (exit 8); if that fails too, the message says
    what the device holds (exit 9).
    """
    from drivers.flash import make_target
    from drivers.flash.procedure import make_plan, restore_backup
    from imu_cli import flash_view as view
    from imu_cli.recording_view import interrupt_on_signals

    if len(arguments) != (1 if restore else 2):
        usage = "--restore BACKUP URL" if restore else "CAL.json URL"
        raise typer.BadParameter(f"expected {usage}, got {' '.join(arguments)}")
    target = make_target(arguments[-1], template=template)
    if persist and not target.can_persist:
        raise typer.BadParameter(f"--persist: the {target.name} of this device are not stored")
    if restore is not None:
        with interrupt_on_signals(), target:
            values = restore_backup(target, restore, persist=persist, report=view.report)
            view.show_restored(values, target, as_json=json)
        return
    from calib.errors import CalibrationFileError, FlashStateError
    from drivers.calibration_file import check_can_save, load_calibration, save_calibration

    path = Path(arguments[0])
    calibration = load_calibration(path)
    with interrupt_on_signals(), target:
        if not yes:
            _, plan = make_plan(target, calibration)
            view.show_plan(plan, target, calibration, as_json=json)
            return
        from datetime import UTC, datetime

        rest = left or path.with_name(
            path.name.removesuffix(".json").removesuffix(".cal") + ".left.json"
        )
        _check_left(rest, path, backup)
        check_can_save(calibration, rest)
        from drivers.flash.backup import backup_path
        from drivers.flash.procedure import flash_device

        result = flash_device(
            target,
            calibration,
            backup=backup or backup_path(path.parent, target.info.chip, datetime.now(UTC)),
            persist=persist,
            duration=measure,
            report=view.report,
        )
        try:
            save_calibration(result.left, rest)
        except (CalibrationFileError, OSError) as error:
            view.show_result(result, target, None, as_json=json)
            stored = " --persist" if persist else ""
            undo = f"imu-cal flash --restore {result.backup}{stored} '{target.address}'"
            raise FlashStateError(
                "the device is flashed, but what is left for `imu-cal apply` is not saved: "
                f"{error}. To have it, run `{undo}`, and flash again with another --left"
            ) from error
        view.show_result(result, target, rest, as_json=json)


def _check_left(left: Path, calibration: Path, backup: Path | None) -> None:
    """Refuse a --left that is no file in a folder, or is another file of this flash."""
    import os

    for other in filter(None, (calibration, backup)):
        if left.resolve() == other.resolve():
            raise typer.BadParameter(f"--left: {left} is {other}, which would be written over")
    if left.is_dir():
        raise typer.BadParameter(f"--left: {left} is a folder")
    if not os.access(left.parent, os.W_OK):
        raise typer.BadParameter(f"--left: {left.parent} is no folder that can be written to")
