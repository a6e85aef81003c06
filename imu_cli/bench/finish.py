"""What a session leaves behind: calibration, report, and the offer to go on."""

from __future__ import annotations

import shlex
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import typer
from rich.text import Text

from calib.calibrate import calibrate
from calib.calibration import Calibration, Provenance
from drivers.calibration_file import describe_input, save_calibration, write_atomic
from imu_cli import output
from imu_cli.bench.run import Outcome
from imu_cli.bench.session import Session

PARTIAL, INTERRUPTED = 5, 130


def finish(
    session: Session, outcome: Outcome, path: Path, *, url: str, ask: bool, as_json: bool
) -> int:
    """Write calibration and report beside the recording, say how it went, return the exit code."""
    recording = session.recording
    if outcome.ended == "interrupted" or recording is None:
        output.messages().print(
            f"paused after {outcome.elapsed:.0f} s; the same command goes on from {path}"
            if recording is not None
            else "ended before the first sample",
            soft_wrap=True,
        )
        return INTERRUPTED
    calibration = calibrate(recording, gravity=session.gravity)
    provenance = Provenance(
        (describe_input(path),), version("imu-cal"), datetime.now(UTC).isoformat(timespec="seconds")
    )
    calibration = calibration.with_provenance(replace(provenance, device=recording.device))
    files = {"recording": path, "calibration": path.with_suffix(".cal.json")}
    save_calibration(calibration, files["calibration"])
    report = _write_report(calibration, path.with_suffix(".html"))
    if report is not None:
        files["report"] = report
    routine = session.fixed_routine_time()
    if as_json:
        output.print_json(_summary(outcome, calibration, files, routine))
    else:
        _say(outcome, files, routine)
        _offer(files, url, ask=ask)
    return 0 if outcome.ended == "done" else PARTIAL


def _write_report(calibration: Calibration, page: Path) -> Path | None:
    try:
        from imu_cli.report.contents import calibration_report
        from imu_cli.report.page import render_page
    except ModuleNotFoundError as error:
        output.warn(f"no report: {error.name} is not installed; pip install 'imu-cal[report]'")
        return None
    write_atomic(page, render_page(calibration_report(calibration)))
    return page


def _summary(
    outcome: Outcome, calibration: Calibration, files: dict[str, Path], routine: float | None
) -> dict[str, Any]:
    status = outcome.status
    return {
        "format": "imu-cal/bench",
        "version": 1,
        "targets_met": status.done,
        "ended": outcome.ended,
        "seconds": outcome.elapsed,
        "six_face_routine_seconds": routine,
        "poses": 0 if status.poses is None else len(status.poses),
        "turns": status.turns,
        "standard_errors": dict(status.errors),
        "targets": dict(status.targets),
        "undetermined": list(calibration.undetermined),
        "files": {name: str(path) for name, path in files.items()},
    }


def _say(outcome: Outcome, files: dict[str, Path], routine: float | None) -> None:
    status = outcome.status
    poses = 0 if status.poses is None else len(status.poses)
    lines: list[str | Text] = []
    if status.done:
        lines.append(
            output.styled(
                ("done", "bold green"),
                f" in {outcome.elapsed:.0f} s: {poses} poses, {status.turns} turns, "
                "every target met",
            )
        )
    else:
        missing = [
            name
            for name, error in status.errors.items()
            if error is None or error > status.targets[name]
        ]
        lines.append(
            output.styled(
                ("the source ended", "bold yellow"),
                f" after {outcome.elapsed:.0f} s: {poses} poses, "
                f"{status.turns} turns; not yet on target: {', '.join(missing)}",
            )
        )
    lines.append(
        "six faces with quarter turns would never have got there: some parameters they do not show"
        if routine is None
        else f"six faces with quarter turns would have taken {routine:.0f} s"
    )
    lines += [f"{name:<12} {path}" for name, path in files.items()]
    output.print_lines(*lines)


def _offer(files: dict[str, Path], url: str, *, ask: bool) -> None:
    """Offer what comes next: ask at a terminal, else say the commands."""
    commands = [
        ("look for physics that was left out", ["diagnose", str(files["recording"])]),
        ("write it to the device (a dry run)", ["flash", str(files["calibration"]), url]),
    ]
    for what, arguments in commands:
        if ask and output.messages().is_terminal and typer.confirm(f"{what}?", err=True):
            _run(arguments)
        else:
            output.print_lines(f"to {what}: imu-cal {shlex.join(arguments)}")


def _run(arguments: list[str]) -> None:
    from imu_cli.app import app

    app(arguments, standalone_mode=False)
