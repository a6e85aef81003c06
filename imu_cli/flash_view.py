"""What `imu-cal flash` shows: the plan, what was measured, and what is left to do."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imu_cli import output

if TYPE_CHECKING:
    from rich.table import Table

    from calib.calibration import Calibration
    from drivers.flash.procedure import Check, Result
    from drivers.flash.target import Native, Plan, Row, Target


def report(text: str) -> None:
    """Say what is being done, on standard error, if anyone is still there."""
    # A terminal that was closed must not keep the old values from being put back. Rich exits.
    with suppress(OSError, SystemExit):
        output.messages().print(text, markup=False, soft_wrap=True)


def show_plan(plan: Plan, target: Target, calibration: Calibration, *, as_json: bool) -> None:
    """Print what a flash would write; nothing was written."""
    if as_json:
        document = {"format": "imu-cal/flash-plan", "version": 1, "written": False}
        output.print_json(document | _device(target) | _plan(plan))
        return
    output.print_lines(f"{target.info.chip} at {target.address}: {target.name}", _table(plan.rows))
    if not calibration.provenance.device.chip:
        output.warn("the calibration does not say which device it is of: make sure it is this one")
    _say_rest(plan)
    if not plan.changes:
        output.print_lines("nothing would change")
    if target.always_stored:
        output.warn("this device stores values as soon as they are set: it takes --yes --persist")
    output.print_lines("dry run: nothing was written; add --yes to write")


def show_result(result: Result, target: Target, left: Path | None, *, as_json: bool) -> None:
    """Print what was written, what the still device showed, and what an application must do.

    `left` is None if what is left could not be saved.
    """
    if as_json:
        document: dict[str, Any] = {"format": "imu-cal/flash", "version": 1, "written": True}
        document |= _device(target) | _plan(result.plan)
        document |= {
            "persisted": result.persisted,
            "backup": str(result.backup),
            "left": None if left is None else str(left),
            "checks": [_check(check) for check in result.checks],
            "start_up": result.snippet,
        }
        output.print_json(document)
        return
    output.print_lines(
        f"{target.info.chip} at {target.address}: {target.name} written and read back",
        _table(result.plan.rows),
        _checks(result.checks),
    )
    _say_rest(result.plan)
    output.print_lines(f"old values: {result.backup}")
    if left is not None:
        output.print_lines(f"what is left for `imu-cal apply`: {left}")
    if result.persisted:
        output.print_lines("stored in non-volatile memory, and read back after a restart")
    elif target.volatile:
        output.warn("these values are lost at power-off")
    if result.snippet:
        output.print_lines("")
        output.console().print(result.snippet, markup=False, soft_wrap=True, end="")


def show_restored(values: Native, target: Target, *, as_json: bool) -> None:
    """Print what a backup put back."""
    if as_json:
        document = {"format": "imu-cal/flash-restore", "version": 1, "values": values}
        output.print_json(document | _device(target))
        return
    held = ", ".join(f"{name} {value:g}" for name, value in values.items())
    output.print_lines(f"{target.info.chip} at {target.address}: restored and read back: {held}")


def _table(rows: tuple[Row, ...]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("parameter", "in the device", "old", "new", "unit", ""):
        table.add_column(heading, justify="right" if heading in ("old", "new") else "left")
    for row in rows:
        notes = [row.note] if row.note else []
        if row.clipped:
            notes.append(f"clipped: {row.wanted:.6g} was wanted")
        table.add_row(
            row.parameter, row.name, f"{row.old:.9g}", f"{row.new:.9g}", row.unit, "; ".join(notes)
        )
    return table


def _checks(checks: tuple[Check, ...]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("at rest", "before", "after", "expected", "+-", ""):
        table.add_column(heading, justify="left" if heading in ("at rest", "") else "right")
    for check in checks:
        unit = "m/s²" if check.channel.startswith("accel") else "rad/s"
        table.add_row(
            check.channel,
            f"{check.before:.5f}",
            f"{check.after:.5f}",
            f"{check.expected:.5f}",
            f"{check.tolerance:.2g}",
            unit if check.visible else f"{unit} (too small a change to see)",
        )
    return table


def _say_rest(plan: Plan) -> None:
    if plan.cannot_hold:
        names = ", ".join(_groups(plan.cannot_hold))
        output.print_lines(f"the device cannot hold {names}: left for `imu-cal apply`")


def _groups(names: tuple[str, ...]) -> list[str]:
    return list(dict.fromkeys(name.rsplit(".", 1)[0] for name in names))


def _device(target: Target) -> dict[str, Any]:
    info = target.info
    return {
        "address": target.address,
        "chip": info.chip,
        "serial_number": info.serial_number,
        "target": target.name,
    }


def _plan(plan: Plan) -> dict[str, Any]:
    return {
        "rows": [
            {
                "parameter": row.parameter,
                "name": row.name,
                "old": row.old,
                "new": row.new,
                "wanted": row.wanted,
                "unit": row.unit,
                "clipped": row.clipped,
            }
            for row in plan.rows
        ],
        "cannot_hold": list(plan.cannot_hold),
    }


def _check(check: Check) -> dict[str, Any]:
    return {
        "channel": check.channel,
        "before": check.before,
        "after": check.after,
        "expected": check.expected,
        "tolerance": check.tolerance,
    }
